#include "argument_checks.h"

#include <ATen/ATen.h>
#include <fmt/format.h>

#include <unordered_map>

#include "malformed.h"

namespace tt3d::model {
namespace {

using c10::IValue;

/// Limit for the number of pieces when an operator splits a tensor: far above that of any network.
constexpr int64_t kMaxParts = 1 << 16;
/// Outside this range, the index of a source pixel overflows.
constexpr double kMinScale = 1e-4, kMaxScale = 1e4;

/// The arguments of a call, by name.
class Arguments {
 public:
  Arguments(const Step& step, const torch::jit::Stack& stack)
      : names_(step.op->schema().arguments()), stack_(stack) {}

  [[nodiscard]] IValue get(const std::string& name) const {
    for (size_t i = 0; i < names_.size(); ++i) {
      if (names_[i].name() == name) return stack_[i];
    }
    return {};
  }
  /// Undefined if the argument is absent or None.
  [[nodiscard]] at::Tensor tensor(const std::string& name) const {
    const IValue value = get(name);
    return value.isTensor() ? value.toTensor() : at::Tensor();
  }
  [[nodiscard]] size_t count() const { return names_.size(); }
  [[nodiscard]] const std::string& name(size_t i) const { return names_[i].name(); }
  [[nodiscard]] const IValue& at(size_t i) const { return stack_[i]; }

 private:
  const std::vector<c10::Argument>& names_;
  const torch::jit::Stack& stack_;
};

void require(bool holds, const char* problem) {
  if (!holds) throw Malformed(problem);
}

/// torch's fused kernel reads as many values as there are keys, unchecked.
void check_attention(const Arguments& a) {
  const at::Tensor q = a.tensor("query"), k = a.tensor("key"), v = a.tensor("value");
  const int64_t rank = q.dim();
  require(rank >= 2 && k.dim() == rank && v.dim() == rank, "query, key and value differ in rank");
  require(k.size(-1) == q.size(-1) && k.size(-2) == v.size(-2), "keys do not fit the values");
  require(k.sizes().slice(0, rank - 2).equals(v.sizes().slice(0, rank - 2)),
          "keys do not fit the values");
  const bool grouped = a.get("enable_gqa").isBool() && a.get("enable_gqa").toBool();
  const bool fits = !grouped || (rank >= 3 && k.size(-3) > 0 && q.size(-3) % k.size(-3) == 0);
  require(fits, "groups of heads do not fit");
}

/// The kernel reads statistics for every channel, even if there are fewer.
void check_statistics(const Arguments& a) {
  const at::Tensor input = a.tensor("input");
  require(input.dim() >= 2, "expects [N,C,...]");
  for (const char* name : {"weight", "bias", "running_mean", "running_var"}) {
    const at::Tensor values = a.tensor(name);
    require(!values.defined() || (values.dim() == 1 && values.size(0) == input.size(1)),
            "statistics do not fit the channels");
  }
  require(a.tensor("running_mean").defined() && a.tensor("running_var").defined(),
          "has no statistics");
}

void check_scale(double scale) {
  require(scale >= kMinScale && scale <= kMaxScale, "scale is out of range");
}

void check_resampling(const Arguments& a) {
  for (size_t i = 0; i < a.count(); ++i) {
    if (!a.name(i).starts_with("scale")) continue;
    if (a.at(i).isDouble()) check_scale(a.at(i).toDouble());
    if (!a.at(i).isDoubleList()) continue;
    for (const double scale : a.at(i).toDoubleVector()) check_scale(scale);
  }
}

/// Reflection padding with a negative width would read outside the picture.
void check_padding(const Arguments& a) {
  const IValue mode = a.get("mode");
  if (mode.isString() && mode.toStringRef() == "constant") return;
  for (const char* name : {"padding", "pad"}) {
    const IValue padding = a.get(name);
    if (!padding.isIntList()) continue;
    for (const int64_t width : padding.toIntVector()) require(width >= 0, "padding is negative");
  }
}

/// The smallest integer divided by -1 traps.
void check_division(const Arguments& a) {
  const IValue mode = a.get("rounding_mode");
  if (!mode.isString() || mode.toStringRef() != "trunc") return;
  require(a.tensor("self").is_floating_point(), "truncating division of integers");
}

void check_parts(const Arguments& a) {
  const IValue dim_value = a.get("dim");
  const int64_t dim = dim_value.isInt() ? dim_value.toInt() : 0;
  int64_t parts = 0;
  for (const char* name : {"chunks", "sections"}) {
    const IValue value = a.get(name);
    if (value.isInt()) parts = value.toInt();
  }
  const IValue& self = a.at(0);
  if (parts == 0 && self.isTensor()) {
    const at::Tensor& tensor = self.toTensor();
    if (dim < tensor.dim() && dim >= -tensor.dim()) parts = tensor.size(dim);
  }
  require(parts <= kMaxParts, "cuts a tensor into too many parts");
}

using Check = void (*)(const Arguments&);

Check find_check(const std::string& target) {
  static const std::unordered_map<std::string, Check> checks = {
      {"aten::scaled_dot_product_attention", check_attention},
      {"aten::_native_batch_norm_legit_no_training", check_statistics},
      {"aten::upsample_nearest1d", check_resampling},
      {"aten::upsample_nearest2d", check_resampling},
      {"aten::upsample_linear1d", check_resampling},
      {"aten::upsample_bilinear2d", check_resampling},
      {"aten::upsample_bicubic2d", check_resampling},
      {"aten::_upsample_bilinear2d_aa", check_resampling},
      {"aten::_upsample_bicubic2d_aa", check_resampling},
      {"aten::reflection_pad1d", check_padding},
      {"aten::reflection_pad2d", check_padding},
      {"aten::replication_pad1d", check_padding},
      {"aten::replication_pad2d", check_padding},
      {"aten::pad", check_padding},
      {"aten::div", check_division},
      {"aten::div_", check_division}};
  const auto found = checks.find(target);
  return found == checks.end() ? nullptr : found->second;
}

bool gives_list(const Step& step) {
  const auto& returns = step.op->schema().returns();
  return !returns.empty() && returns[0].type()->kind() == c10::TypeKind::ListType;
}

}  // namespace

void check_arguments(const Step& step, const torch::jit::Stack& stack) {
  const Check check = find_check(step.target);
  if (check != nullptr) check(Arguments(step, stack));
  if (gives_list(step)) check_parts(Arguments(step, stack));
}

}  // namespace tt3d::model
