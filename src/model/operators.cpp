#include "operators.h"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <unordered_set>

#include "malformed.h"

namespace tt3d::model {
namespace {

/// Every overload of these operators that accepted_schema accepts may run. Left out on purpose:
/// factories of random numbers, as_strided / set_ / resize_ (memory layout), _unsafe_index (no
/// bounds check), quantised and sparse operators, out= variants.
// clang-format off
const std::unordered_set<std::string_view>& allowed() {
  static const std::unordered_set<std::string_view> names = {
      // Convolutions, pooling, resampling
      "conv1d", "conv2d", "conv3d", "convolution", "_convolution", "conv_transpose1d",
      "conv_transpose2d", "avg_pool1d", "avg_pool2d", "avg_pool3d", "max_pool1d", "max_pool2d",
      "max_pool2d_with_indices", "max_pool3d", "adaptive_avg_pool1d", "adaptive_avg_pool2d",
      "_adaptive_avg_pool2d", "adaptive_avg_pool3d", "adaptive_max_pool1d", "adaptive_max_pool2d",
      "upsample_nearest1d", "upsample_nearest2d", "upsample_bilinear2d", "upsample_bicubic2d",
      "upsample_linear1d", "_upsample_bilinear2d_aa", "_upsample_bicubic2d_aa", "grid_sampler_2d",
      "grid_sampler", "affine_grid_generator", "pixel_shuffle", "pixel_unshuffle",
      "channel_shuffle", "im2col", "col2im", "unfold",
      "pad", "constant_pad_nd", "reflection_pad1d", "reflection_pad2d", "replication_pad1d",
      "replication_pad2d",
      // Linear algebra, attention
      "linear", "matmul", "mm", "bmm", "addmm", "baddbmm", "addbmm", "mv", "dot", "einsum",
      "bilinear", "outer", "cross", "linalg_cross", "linalg_vector_norm", "norm",
      "linalg_norm", "scaled_dot_product_attention", "tril", "triu", "diagonal", "diag",
      "cosine_similarity", "embedding", "one_hot", "cdist",
      // Normalisation (evaluation mode is checked)
      "batch_norm", "_native_batch_norm_legit_no_training", "group_norm", "native_group_norm",
      "instance_norm", "layer_norm", "native_layer_norm", "rms_norm", "local_response_norm",
      "dropout", "dropout_", "feature_dropout", "feature_dropout_", "alpha_dropout",
      "native_dropout",
      // Activations
      "relu", "relu_", "relu6", "relu6_", "leaky_relu", "leaky_relu_", "prelu", "elu", "elu_",
      "selu", "selu_", "celu", "celu_", "gelu", "gelu_", "silu", "silu_", "mish", "mish_",
      "hardtanh", "hardtanh_", "hardswish", "hardswish_", "hardsigmoid", "hardsigmoid_",
      "sigmoid", "sigmoid_", "tanh", "tanh_", "softplus", "softsign", "hardshrink", "softshrink",
      "threshold", "threshold_", "glu", "softmax", "_softmax", "log_softmax", "_log_softmax",
      "log_sigmoid", "logsumexp",
      // Elementwise
      "add", "add_", "sub", "sub_", "rsub", "mul", "mul_", "div", "div_", "true_divide",
      "floor_divide", "floor_divide_", "remainder", "fmod", "pow", "pow_", "square", "sqrt",
      "sqrt_", "rsqrt", "exp", "exp_", "exp2", "expm1", "log", "log2", "log10", "log1p", "abs",
      "abs_", "neg", "neg_", "sign", "floor", "floor_", "ceil", "round", "trunc", "frac",
      "reciprocal", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "erf",
      "clamp", "clamp_", "clamp_min", "clamp_min_", "clamp_max", "clamp_max_", "minimum",
      "maximum", "addcmul", "addcmul_", "addcdiv", "addcdiv_", "lerp", "where", "masked_fill",
      "masked_fill_", "nan_to_num", "isnan", "isinf", "isfinite", "eq", "ne", "lt", "le", "gt",
      "ge", "logical_and", "logical_or", "logical_not", "logical_xor", "bitwise_and",
      "bitwise_or", "bitwise_not", "bitwise_xor", "__and__", "__or__",
      // Reductions
      "sum", "mean", "var", "std", "var_mean", "std_mean", "amax", "amin", "max", "min", "argmax",
      "argmin", "prod", "cumsum", "cumprod", "any", "all", "topk", "sort", "argsort", "aminmax",
      // Shapes and indices
      "view", "_unsafe_view", "view_as", "reshape", "reshape_as", "flatten", "unflatten",
      "permute", "transpose", "transpose_", "t", "numpy_T", "swapaxes", "swapdims", "movedim",
      "moveaxis", "squeeze", "squeeze_", "unsqueeze", "unsqueeze_", "expand", "expand_as",
      "repeat", "repeat_interleave", "tile", "cat", "concat", "concatenate", "stack", "hstack",
      "vstack", "split", "split_with_sizes", "chunk", "tensor_split", "unbind", "narrow",
      "select", "slice", "index", "index_select", "index_put", "index_put_", "index_add",
      "gather", "scatter", "scatter_add", "take_along_dim", "masked_select", "roll", "flip",
      "rot90", "broadcast_to", "meshgrid", "copy", "copy_", "slice_scatter", "select_scatter",
      "tril_indices", "triu_indices", "constant_pad_nd", "unsafe_split", "unsafe_chunk",
      // Making and converting tensors
      "zeros", "zeros_like", "ones", "ones_like", "full", "full_like", "empty_like", "new_zeros",
      "new_ones", "new_full", "arange", "linspace", "eye", "scalar_tensor", "fill", "fill_",
      "zero_", "clone", "contiguous", "alias", "detach", "detach_", "lift_fresh_copy",
      "lift_fresh", "lift", "to", "_to_copy", "type_as", "float", "double", "half",
      "sym_size", "sym_numel", "sym_stride"};
  return names;
}
// clang-format on

constexpr std::string_view kPrefix = "torch.ops.aten.";

bool accepted_type(const c10::TypePtr& type) {
  switch (type->kind()) {
    case c10::TypeKind::TensorType:
    case c10::TypeKind::IntType:
    case c10::TypeKind::SymIntType:
    case c10::TypeKind::FloatType:
    case c10::TypeKind::SymFloatType:
    case c10::TypeKind::BoolType:
    case c10::TypeKind::SymBoolType:
    case c10::TypeKind::NumberType:
    case c10::TypeKind::StringType:
    case c10::TypeKind::DeviceObjType:
    case c10::TypeKind::ScalarTypeType:
    case c10::TypeKind::MemoryFormatType:
    case c10::TypeKind::LayoutType:
      return true;
    case c10::TypeKind::OptionalType:
      return accepted_type(type->castRaw<c10::OptionalType>()->getElementType());
    case c10::TypeKind::ListType:
      return accepted_type(type->castRaw<c10::ListType>()->getElementType());
    default:
      return false;
  }
}

/// Arguments and results must be tensors, numbers, strings or lists of them; no out= variants.
bool accepted_schema(const c10::FunctionSchema& schema) {
  const auto fine = [](const c10::Argument& argument) {
    return !argument.is_out() && accepted_type(argument.type());
  };
  return !schema.is_vararg() && !schema.is_varret() &&
         std::all_of(schema.arguments().begin(), schema.arguments().end(), fine) &&
         std::all_of(schema.returns().begin(), schema.returns().end(),
                     [](const c10::Argument& result) { return accepted_type(result.type()); });
}

[[noreturn]] void throw_refused(const std::string& target) {
  throw Malformed(
      fmt::format("operator '{}' is not on the list of operators that a model may use; "
                  "see docs/model.md",
                  target));
}

bool is_false(const Input& input) {
  return input.kind == Input::Kind::kConstant && input.constant.isBool() &&
         !input.constant.toBool();
}

bool is_zero(const Input& input) {
  return input.kind == Input::Kind::kConstant && input.constant.isDouble() &&
         input.constant.toDouble() == 0;
}

/// Batch normalisation without running statistics stores nothing and draws no random numbers.
/// Weight standardisation (NFNets) is exported in this form.
bool is_stateless_norm(const Step& step) {
  if (step.target != "aten::batch_norm" && step.target != "aten::instance_norm") return false;
  const auto& arguments = step.op->schema().arguments();
  for (size_t i = 0; i < arguments.size(); ++i) {
    const std::string& name = arguments[i].name();
    if (name != "running_mean" && name != "running_var") continue;
    const Input& input = step.inputs[i];
    if (input.kind != Input::Kind::kConstant || !input.constant.isNone()) return false;
  }
  return true;
}

}  // namespace

c10::OperatorHandle find_operator(const std::string& target) {
  if (!target.starts_with(kPrefix)) throw_refused(target);
  const std::string rest = target.substr(kPrefix.size());
  const size_t dot = rest.find('.');
  const std::string name = rest.substr(0, dot);
  std::string overload = dot == std::string::npos ? "" : rest.substr(dot + 1);
  if (overload == "default") overload.clear();
  // view.dtype reinterprets bytes, e.g. makes a bool of a 2.
  if (allowed().count(name) == 0 || (name == "view" && overload == "dtype")) throw_refused(target);
  const auto op = c10::Dispatcher::singleton().findSchema({"aten::" + name, overload});
  if (!op) {
    throw Malformed(fmt::format("operator '{}' does not exist in this version of torch", target));
  }
  if (!accepted_schema(op->schema())) throw_refused(target);
  return *op;
}

bool is_assertion(const std::string& target) {
  return target == "torch.ops.aten._assert_tensor_metadata.default" ||
         target == "torch.ops.aten._assert_scalar.default" ||
         target == "torch.ops.aten.sym_constrain_range_for_size.default" ||
         target == "torch.ops.aten.sym_constrain_range.default";
}

void check_evaluation_mode(const Step& step) {
  if (is_stateless_norm(step)) return;
  const auto& arguments = step.op->schema().arguments();
  for (size_t i = 0; i < arguments.size(); ++i) {
    const std::string& name = arguments[i].name();
    const bool flag = name == "training" || name == "train";
    if ((flag && !is_false(step.inputs[i])) || (name == "dropout_p" && !is_zero(step.inputs[i]))) {
      throw Malformed(
          fmt::format("node '{}' ({}) runs in training mode; export the network after "
                      "model.eval()",
                      step.name, step.target));
    }
  }
}

}  // namespace tt3d::model
