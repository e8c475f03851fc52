#include "plan_nodes.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

namespace tt3d::model {
namespace {

at::Tensor clamped(at::Tensor tensor, const Clamp& clamp) {
  return clamp.active ? tensor.clamp_(0, clamp.high) : tensor;
}

/// A node that applies its clamp last, with the mask of it.
class ClampedNode : public PlanNode {
 public:
  ClampedNode(Slot output, const Clamp& clamp) : output_(output), clamp_(clamp) {}

  void forward(PlanPass& pass, size_t index) const final {
    const at::Tensor y = in_plan_layout(clamped(result(pass), clamp_));
    if (pass.keeps() && clamp_.active) {
      pass.kept(index).mask = slope_bits(y, clamp_);
      pass.count_kept(pass.kept(index).mask);
    }
    pass.set(output_, y);
  }

  void backward(PlanPass& pass, size_t index) const final {
    at::Tensor gradient = pass.take_gradient(output_);
    if (!gradient.defined()) return;
    if (clamp_.active) {
      gradient = own(in_plan_layout(gradient));
      apply_bits(gradient, pass.kept(index).mask);
    }
    spread(pass, gradient);
  }

 protected:
  /// A new tensor.
  virtual at::Tensor result(PlanPass& pass) const = 0;
  virtual void spread(PlanPass& pass, at::Tensor gradient) const = 0;

 private:
  Slot output_;
  Clamp clamp_;
};

class AffineNode final : public ClampedNode {
 public:
  explicit AffineNode(const AffineSpec& spec) : ClampedNode(spec.output, spec.clamp), spec_(spec) {}

 protected:
  at::Tensor result(PlanPass& pass) const override {
    const at::Tensor& x = pass.value(spec_.input);
    return spec_.scale.defined() ? at::addcmul(spec_.shift, x, spec_.scale) : x.clone();
  }
  void spread(PlanPass& pass, at::Tensor gradient) const override {
    if (spec_.scale.defined()) {
      gradient = own(std::move(gradient));
      gradient.mul_(spec_.scale.to(gradient.scalar_type()));
    }
    pass.add_gradient(spec_.input, std::move(gradient));
  }

 private:
  AffineSpec spec_;
};

class SumNode final : public ClampedNode {
 public:
  explicit SumNode(const SumSpec& spec) : ClampedNode(spec.output, spec.clamp), spec_(spec) {}

 protected:
  at::Tensor result(PlanPass& pass) const override {
    return at::add(pass.value(spec_.a), pass.value(spec_.b));
  }
  void spread(PlanPass& pass, at::Tensor gradient) const override {
    if (spec_.a_has_gradient) pass.add_gradient(spec_.a, gradient);
    if (spec_.b_has_gradient) pass.add_gradient(spec_.b, gradient);
  }

 private:
  SumSpec spec_;
};

class DispatchedNode final : public PlanNode {
 public:
  DispatchedNode(std::vector<Step> steps, std::vector<Slot> in, std::vector<Slot> out)
      : steps_(std::move(steps)) {
    reads = std::move(in);
    gives = std::move(out);
  }

  void forward(PlanPass& pass, size_t index) const override {
    std::vector<at::Tensor> inputs, before;
    for (const Slot slot : reads) {
      before.push_back(pass.is_tensor(slot) ? pass.value(slot) : at::Tensor());
      inputs.push_back(prepare(pass, slot));
    }
    {
      const at::AutoGradMode recording(pass.keeps());
      for (const Step& step : steps_) pass.run(step);
    }
    for (size_t i = 0; i < reads.size(); ++i) {
      if (before[i].defined()) pass.replace(reads[i], before[i]);
    }
    if (!pass.keeps()) return;
    Kept& kept = pass.kept(index);
    kept.inputs = std::move(inputs);
    for (const Slot slot : gives) {
      kept.outputs.emplace_back();
      if (!pass.is_tensor(slot)) continue;
      kept.outputs.back() = pass.value(slot);
      pass.replace(slot, kept.outputs.back().detach());
    }
  }

  void backward(PlanPass& pass, size_t index) const override {
    const Kept& kept = pass.kept(index);
    std::vector<at::Tensor> from, with, to;
    for (size_t i = 0; i < gives.size(); ++i) {
      const at::Tensor gradient = pass.take_gradient(gives[i]);
      const at::Tensor& output = kept.outputs[i];
      if (!gradient.defined() || !output.defined() || !output.requires_grad()) continue;
      from.push_back(output);
      with.push_back(gradient.to(output.scalar_type()));
    }
    std::vector<Slot> slots;
    for (size_t i = 0; i < reads.size(); ++i) {
      if (!kept.inputs[i].defined()) continue;
      to.push_back(kept.inputs[i]);
      slots.push_back(reads[i]);
    }
    if (from.empty() || to.empty()) return;
    const auto gradients = torch::autograd::grad(from, to, with, /*retain_graph=*/true,
                                                 /*create_graph=*/false, /*allow_unused=*/true);
    for (size_t i = 0; i < slots.size(); ++i) {
      if (gradients[i].defined()) pass.add_gradient(slots[i], gradients[i]);
    }
  }

 private:
  /// Makes a value a leaf of autograd's graph if a backward pass follows. Returns the leaf,
  /// undefined if there is none.
  static at::Tensor prepare(PlanPass& pass, Slot slot) {
    if (!pass.is_tensor(slot)) return {};
    if (!pass.keeps() || !pass.value(slot).is_floating_point()) return {};
    const at::Tensor leaf = pass.value(slot).detach().requires_grad_(true);
    pass.replace(slot, leaf);
    return leaf;
  }

  std::vector<Step> steps_;
};

}  // namespace

std::unique_ptr<PlanNode> affine_node(AffineSpec spec) {
  return std::make_unique<AffineNode>(std::move(spec));
}

std::unique_ptr<PlanNode> sum_node(SumSpec spec) {
  return std::make_unique<SumNode>(std::move(spec));
}

std::unique_ptr<PlanNode> dispatched_node(std::vector<Step> steps, std::vector<Slot> reads,
                                          std::vector<Slot> gives) {
  return std::make_unique<DispatchedNode>(std::move(steps), std::move(reads), std::move(gives));
}

}  // namespace tt3d::model
