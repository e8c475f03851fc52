#include <ATen/ATen.h>
#include <ATen/core/dispatch/Dispatcher.h>

#include <cmath>
#include <limits>

#include "plan_nodes.h"

namespace tt3d::model {
namespace {

using Sizes = std::vector<int64_t>;

/// An operator of libtorch that has no function of its own: oneDNN's convolutions with weights made
/// ready and an activation (registered in ATen/native/mkldnn).
c10::OperatorHandle operator_named(const char* name, const char* overload = "") {
  return c10::Dispatcher::singleton().findSchemaOrThrow(name, overload);
}

at::Tensor call(const c10::OperatorHandle& op, torch::jit::Stack stack) {
  op.callBoxed(stack);
  return stack.at(0).toTensor();
}

const char* unary_name(const Clamp& clamp) {
  if (!clamp.active) return "none";
  return std::isinf(clamp.high) ? "relu" : "hardtanh";
}

c10::List<std::optional<at::Scalar>> unary_numbers(const Clamp& clamp) {
  c10::List<std::optional<at::Scalar>> numbers;
  if (clamp.active && !std::isinf(clamp.high)) {
    numbers.push_back(at::Scalar(0.0));
    numbers.push_back(at::Scalar(clamp.high));
  }
  return numbers;
}

/// A dense or grouped convolution of oneDNN, for one layout of weights.
class Packed {
 public:
  Packed(at::Tensor weight, at::Tensor bias, Sizes stride, Sizes padding, Sizes dilation,
         int64_t groups)
      : bias_(std::move(bias)),
        stride_(std::move(stride)),
        padding_(std::move(padding)),
        dilation_(std::move(dilation)),
        groups_(groups),
        weight_(std::move(weight)) {}

  at::Tensor run(const at::Tensor& x, const Clamp& clamp) {
    make_ready(x);
    static const auto op = operator_named("mkldnn::_convolution_pointwise");
    return call(op, {x, ready_, optional(bias_), padding_, stride_, dilation_, groups_,
                     unary_name(clamp), unary_numbers(clamp), ""});
  }

  /// clamp(convolution + sum); the clamp must be a relu or none.
  at::Tensor run_and_add(const at::Tensor& x, const at::Tensor& sum, const Clamp& clamp) {
    make_ready(x);
    const c10::IValue unary = clamp.active ? c10::IValue("relu") : c10::IValue();
    static const auto op = operator_named("mkldnn::_convolution_pointwise", "binary");
    return call(op, {x, sum, ready_, optional(bias_), padding_, stride_, dilation_, groups_, "add",
                     c10::IValue(), unary, c10::List<std::optional<at::Scalar>>(), c10::IValue()});
  }

  bool holds(const at::Tensor& weight) const {
    return !ready_.defined() || ready_.to_dense().equal(weight);
  }

 private:
  static c10::IValue optional(const at::Tensor& tensor) {
    return tensor.defined() ? c10::IValue(tensor) : c10::IValue();
  }

  void make_ready(const at::Tensor& x) {
    if (ready_.defined()) return;
    static const auto op = operator_named("mkldnn::_reorder_convolution_weight");
    ready_ = call(op, {weight_, padding_, stride_, dilation_, groups_, x.sizes().vec()});
    weight_.reset();
  }

  at::Tensor bias_;
  Sizes stride_, padding_, dilation_;
  int64_t groups_;
  at::Tensor weight_, ready_;
};

/// Weights of the convolution that is the gradient of a convolution with stride 1: input and output
/// channels of each group exchanged, the window turned by 180 degrees.
at::Tensor turned(const ConvolutionSpec& spec) {
  const at::Tensor& weight = spec.weight;
  const int64_t groups = spec.groups;
  const int64_t out = weight.size(0) / groups, in = weight.size(1);
  const int64_t height = weight.size(2), width = weight.size(3);
  return weight.view({groups, out, in, height, width})
      .transpose(1, 2)
      .flip({3, 4})
      .reshape({groups * in, out, height, width})
      .to(spec.gradient_type)
      .contiguous(at::MemoryFormat::ChannelsLast);
}

/// The product of a gradient with the derivative of a convolution.
class ConvolutionGradient {
 public:
  virtual ~ConvolutionGradient() = default;
  /// gradient [N,Cout,...]; returns [N,Cin,height,width].
  virtual at::Tensor run(const at::Tensor& gradient, const Sizes& input) = 0;
  virtual bool holds(const ConvolutionSpec& spec) const = 0;
};

/// Stride 1: a convolution.
class UnitStrideGradient final : public ConvolutionGradient {
 public:
  explicit UnitStrideGradient(const ConvolutionSpec& spec)
      : packed_(turned(spec), {}, {1, 1}, outer(spec), spec.dilation, spec.groups) {}
  static Sizes outer(const ConvolutionSpec& spec) {
    Sizes padding;
    for (size_t i = 0; i < 2; ++i) {
      const int64_t reach = spec.dilation[i] * (spec.weight.size(2 + static_cast<int64_t>(i)) - 1);
      padding.push_back(reach - spec.padding[i]);
    }
    return padding;
  }
  static bool fits(const ConvolutionSpec& spec) {
    const Sizes padding = outer(spec);
    return spec.stride == Sizes{1, 1} && padding[0] >= 0 && padding[1] >= 0;
  }
  at::Tensor run(const at::Tensor& gradient, const Sizes& input) override {
    static_cast<void>(input);
    return packed_.run(gradient, {});
  }
  bool holds(const ConvolutionSpec& spec) const override { return packed_.holds(turned(spec)); }

 private:
  Packed packed_;
};

/// A 1 by 1 convolution that skips pixels: the skipped ones get zero.
class SkippingGradient final : public ConvolutionGradient {
 public:
  explicit SkippingGradient(const ConvolutionSpec& spec)
      : packed_(turned(spec), {}, {1, 1}, {0, 0}, {1, 1}, spec.groups), stride_(spec.stride) {}
  static bool fits(const ConvolutionSpec& spec) {
    return spec.weight.size(2) == 1 && spec.weight.size(3) == 1 && spec.padding == Sizes{0, 0};
  }
  at::Tensor run(const at::Tensor& gradient, const Sizes& input) override {
    const at::Tensor reached = packed_.run(gradient, {});
    at::Tensor result = at::empty(input, gradient.options(), at::MemoryFormat::ChannelsLast);
    result.zero_();
    result.slice(2, 0, at::nullopt, stride_[0]).slice(3, 0, at::nullopt, stride_[1]).copy_(reached);
    return result;
  }
  bool holds(const ConvolutionSpec& spec) const override { return packed_.holds(turned(spec)); }

 private:
  Packed packed_;
  Sizes stride_;
};

/// A strided convolution of few channels, as a network's first. Pixels of equal residue with
/// respect to the stride have the same taps, so one convolution with stride 1 gives all residues as
/// channels (Shi et al., "Is the deconvolution layer the same as a convolutional layer?", 2016).
class ResidueGradient final : public ConvolutionGradient {
 public:
  explicit ResidueGradient(const ConvolutionSpec& spec)
      : stride_(spec.stride[0]), padding_(spec.padding[0]), packed_(pack(spec)) {}
  static bool fits(const ConvolutionSpec& spec) {
    constexpr int64_t kFew = 4;
    return spec.groups == 1 && spec.weight.size(1) <= kFew && spec.stride[0] > 1 &&
           spec.stride[0] == spec.stride[1] && spec.padding[0] == spec.padding[1] &&
           spec.dilation == Sizes{1, 1} && spec.weight.size(2) == spec.weight.size(3) &&
           spec.weight.size(2) >= spec.stride[0];
  }
  at::Tensor run(const at::Tensor& gradient, const Sizes& input) override {
    const at::Tensor all = at::pixel_shuffle(packed_.run(gradient, {}), stride_);
    at::Tensor result = at::empty(input, gradient.options(), at::MemoryFormat::ChannelsLast);
    const int64_t height = std::min(input[2], all.size(2) - padding_);
    const int64_t width = std::min(input[3], all.size(3) - padding_);
    if (height < input[2] || width < input[3]) result.zero_();
    result.slice(2, 0, height)
        .slice(3, 0, width)
        .copy_(all.slice(2, padding_, padding_ + height).slice(3, padding_, padding_ + width));
    return result;
  }
  bool holds(const ConvolutionSpec& spec) const override { return packed_.holds(residues(spec)); }

 private:
  /// [Cin * s * s, Cout, m, m]: channel (c, qy, qx) has the taps (qy + s * i, qx + s * j), turned.
  static at::Tensor residues(const ConvolutionSpec& spec) {
    const int64_t s = spec.stride[0], k = spec.weight.size(2), taps = (k + s - 1) / s;
    const int64_t out = spec.weight.size(0), in = spec.weight.size(1);
    const at::Tensor filled = at::constant_pad_nd(spec.weight, {0, taps * s - k, 0, taps * s - k});
    return filled.reshape({out, in, taps, s, taps, s})
        .permute({1, 3, 5, 0, 2, 4})
        .flip({4, 5})
        .reshape({in * s * s, out, taps, taps})
        .to(spec.gradient_type)
        .contiguous(at::MemoryFormat::ChannelsLast);
  }
  static Packed pack(const ConvolutionSpec& spec) {
    const at::Tensor weight = residues(spec);
    const int64_t around = weight.size(2) - 1;
    return {weight, {}, {1, 1}, {around, around}, {1, 1}, 1};
  }

  int64_t stride_, padding_;
  Packed packed_;
};

/// Any other stride: oneDNN's transposed convolution.
class StridedGradient final : public ConvolutionGradient {
 public:
  explicit StridedGradient(const ConvolutionSpec& spec)
      : spec_(spec), weight_(spec.weight.to(spec.gradient_type)) {}
  at::Tensor run(const at::Tensor& gradient, const Sizes& input) override {
    return std::get<0>(at::convolution_backward(
        gradient, at::empty(input, gradient.options(), at::MemoryFormat::ChannelsLast), weight_,
        at::nullopt, spec_.stride, spec_.padding, spec_.dilation, false, {0, 0}, spec_.groups,
        {true, false, false}));
  }
  bool holds(const ConvolutionSpec& spec) const override {
    return weight_.equal(spec.weight.to(spec.gradient_type));
  }

 private:
  ConvolutionSpec spec_;
  at::Tensor weight_;
};

std::optional<DepthwiseShape> depthwise_shape(const ConvolutionSpec& spec) {
  const at::Tensor& weight = spec.weight;
  const bool fits = spec.groups > 1 && weight.size(1) == 1 && weight.size(0) == spec.groups &&
                    weight.size(2) == weight.size(3) && spec.stride[0] == spec.stride[1] &&
                    spec.padding[0] == spec.padding[1] && spec.dilation == Sizes{1, 1} &&
                    spec.around[0] == spec.around[2] && spec.around[1] == spec.around[3];
  const DepthwiseShape shape{weight.size(0), weight.size(2), spec.stride[0],
                             spec.padding[0] + spec.around[0], spec.padding[0] + spec.around[1]};
  return fits && has_depthwise_kernel(shape) ? std::optional(shape) : std::nullopt;
}

/// What convolution nodes share: mask, sum, and the order of the backward pass.
class ConvolutionNode : public PlanNode {
 public:
  explicit ConvolutionNode(ConvolutionSpec spec) : spec_(std::move(spec)) {}

  void forward(PlanPass& pass, size_t index) const final {
    const at::Tensor x = in_plan_layout(pass.value(spec_.input));
    try {
      pass.set(spec_.output, result(pass, x, pass.keeps() ? &pass.kept(index) : nullptr));
    } catch (const c10::Error& error) {
      throw_node_error(spec_.name, "aten::conv2d", error);
    }
    if (!pass.keeps()) return;
    Kept& kept = pass.kept(index);
    kept.sizes = x.sizes().vec();
    if (kept.mask.defined()) pass.count_kept(kept.mask);
  }

  void backward(PlanPass& pass, size_t index) const final {
    at::Tensor gradient = pass.take_gradient(spec_.output);
    if (!gradient.defined()) return;
    gradient = in_plan_layout(gradient.to(spec_.gradient_type));
    const Kept& kept = pass.kept(index);
    if (spec_.clamp.active && !spec_.masked_by_reader) {
      gradient = own(std::move(gradient));
      apply_bits(gradient, kept.mask);
    }
    if (spec_.input_has_gradient) {
      const at::Tensor mask = spec_.input_mask < 0
                                  ? at::Tensor()
                                  : pass.kept(static_cast<size_t>(spec_.input_mask)).mask;
      pass.add_gradient(spec_.input, input_gradient(gradient, kept.sizes, mask));
    }
    if (spec_.sum >= 0 && spec_.sum_has_gradient) pass.add_gradient(spec_.sum, std::move(gradient));
  }

 protected:
  /// The result of the node; stores the mask if `kept` is not null.
  virtual at::Tensor result(PlanPass& pass, const at::Tensor& x, Kept* kept) const = 0;
  virtual at::Tensor input_gradient(const at::Tensor& gradient, const Sizes& input,
                                    const at::Tensor& mask) const = 0;

  ConvolutionSpec spec_;
};

class DenseNode final : public ConvolutionNode {
 public:
  explicit DenseNode(ConvolutionSpec spec)
      : ConvolutionNode(std::move(spec)),
        forward_(spec_.weight, spec_.bias, spec_.stride, spec_.padding, spec_.dilation,
                 spec_.groups) {}

  bool weights_hold() const override {
    return forward_.holds(spec_.weight) && (!gradient_ || gradient_->holds(spec_));
  }

 protected:
  at::Tensor result(PlanPass& pass, const at::Tensor& x, Kept* kept) const override {
    const at::Tensor in = padded(x);
    at::Tensor y = spec_.sum < 0 ? forward_.run(in, spec_.clamp) : with_sum(pass, in);
    if (kept != nullptr && spec_.clamp.active) {
      y = in_plan_layout(y);
      kept->mask = slope_bits(y, spec_.clamp);
    }
    return y;
  }

  at::Tensor input_gradient(const at::Tensor& gradient, const Sizes& input,
                            const at::Tensor& mask) const override {
    static_cast<void>(mask);
    if (!gradient_) gradient_ = make_gradient();
    if (!pads()) return gradient_->run(gradient, input);
    const Sizes& around = spec_.around;
    const Sizes whole = {input[0], input[1], input[2] + around[2] + around[3],
                         input[3] + around[0] + around[1]};
    return gradient_->run(gradient, whole)
        .slice(2, around[2], around[2] + input[2])
        .slice(3, around[0], around[0] + input[3]);
  }

 private:
  bool pads() const { return spec_.around != Sizes{0, 0, 0, 0}; }
  at::Tensor padded(const at::Tensor& x) const {
    return pads() ? in_plan_layout(at::constant_pad_nd(x, spec_.around)) : x;
  }

  at::Tensor with_sum(PlanPass& pass, const at::Tensor& x) const {
    const at::Tensor sum = in_plan_layout(pass.value(spec_.sum));
    const bool relu = !spec_.clamp.active || std::isinf(spec_.clamp.high);
    if (relu && !sum.is_same(x)) return forward_.run_and_add(x, sum, spec_.clamp);
    at::Tensor y = forward_.run(x, {}).add_(sum);
    return spec_.clamp.active ? y.clamp_(0, spec_.clamp.high) : y;
  }

  std::unique_ptr<ConvolutionGradient> make_gradient() const {
    if (UnitStrideGradient::fits(spec_)) return std::make_unique<UnitStrideGradient>(spec_);
    if (SkippingGradient::fits(spec_)) return std::make_unique<SkippingGradient>(spec_);
    if (ResidueGradient::fits(spec_)) return std::make_unique<ResidueGradient>(spec_);
    return std::make_unique<StridedGradient>(spec_);
  }

  // Weights are made ready by the first pass that needs them: a victim never needs the gradient's.
  mutable Packed forward_;
  mutable std::unique_ptr<ConvolutionGradient> gradient_;
};

class DepthwiseNode final : public ConvolutionNode {
 public:
  DepthwiseNode(ConvolutionSpec spec, const DepthwiseShape& shape)
      : ConvolutionNode(std::move(spec)),
        convolution_(shape, spec_.weight, spec_.bias, at::kFloat) {}

  bool weights_hold() const override { return convolution_.holds(spec_.weight, spec_.bias); }

 protected:
  at::Tensor result(PlanPass& pass, const at::Tensor& x, Kept* kept) const override {
    const bool masks = kept != nullptr && spec_.clamp.active;
    if (spec_.sum < 0) return convolution_.forward(x, spec_.clamp, masks ? &kept->mask : nullptr);
    at::Tensor y = convolution_.forward(x, {}, nullptr);
    y.add_(pass.value(spec_.sum));
    if (spec_.clamp.active) y.clamp_(0, spec_.clamp.high);
    if (masks) kept->mask = slope_bits(y, spec_.clamp);
    return y;
  }

  at::Tensor input_gradient(const at::Tensor& gradient, const Sizes& input,
                            const at::Tensor& mask) const override {
    return convolution_.backward(gradient, input[2], input[3], mask);
  }

 private:
  Depthwise convolution_;
};

}  // namespace

bool applies_input_mask(const ConvolutionSpec& spec) { return depthwise_shape(spec).has_value(); }

std::unique_ptr<PlanNode> convolution_node(ConvolutionSpec spec) {
  const auto shape = depthwise_shape(spec);
  if (shape) return std::make_unique<DepthwiseNode>(std::move(spec), *shape);
  return std::make_unique<DenseNode>(std::move(spec));
}

}  // namespace tt3d::model
