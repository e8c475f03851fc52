#include "precision.h"

#include <ATen/Context.h>
#include <ATen/autocast_mode.h>
#include <ATen/cpu/Utils.h>

#include <unordered_map>
#include <unordered_set>

namespace tt3d::model {
namespace {

bool cpu_has_bfloat16() {
  const auto capabilities = at::cpu::get_cpu_capabilities();
  for (const char* name : {"avx512_bf16", "amx_bf16"}) {
    const auto found = capabilities.find(name);
    if (found != capabilities.end() && found->second.isBool() && found->second.toBool())
      return true;
  }
  return false;
}

bool is_product(const Step& step) {
  static const std::unordered_set<std::string> names = {"aten::conv1d", "aten::conv2d",
                                                        "aten::conv3d", "aten::linear"};
  return names.count(step.target) != 0;
}

/// Slots that only convolutions and linear layers read, as weight or bias.
std::unordered_set<Slot> slots_of_products(const Graph& graph) {
  std::unordered_set<Slot> found, elsewhere;
  for (const Step& step : graph.steps) {
    const bool product = is_product(step);
    for (size_t i = 0; i < step.inputs.size(); ++i) {
      const bool weight = product && (i == 1 || i == 2);
      for_each_read(step.inputs[i], [&](Slot slot) { (weight ? found : elsewhere).insert(slot); });
    }
  }
  std::erase_if(found, [&](Slot slot) { return elsewhere.count(slot) != 0; });
  return found;
}

}  // namespace

void check_precision(Precision precision) {
  if (precision == Precision::kFloat32 || at::hasCUDA()) return;
  if (precision == Precision::kTf32) {
    throw InputError("precision tf32 needs a CUDA device; leave it at float32");
  }
  if (!cpu_has_bfloat16()) {
    throw InputError(
        "precision bf16 would be slower here: this processor has neither AVX512-BF16 nor AMX; "
        "leave it at float32");
  }
}

void use_bfloat16_weights(Graph& graph) {
  for (const Slot slot : slots_of_products(graph)) {
    const auto found = graph.constants.find(slot);
    if (found == graph.constants.end() || found->second.scalar_type() != at::kFloat) continue;
    found->second = found->second.to(at::kBFloat16);
  }
}

PrecisionScope::PrecisionScope(Precision precision, at::Device device)
    : device_(device.type()), active_(precision == Precision::kBfloat16) {
  if (precision == Precision::kTf32) {
    // The backward pass runs after this scope, so the switch stays on for the process.
    at::globalContext().setAllowTF32CuBLAS(true);
    at::globalContext().setAllowTF32CuDNN(true);
  }
  if (!active_) return;
  enabled_ = at::autocast::is_autocast_enabled(device_);
  cached_ = at::autocast::is_autocast_cache_enabled();
  type_ = at::autocast::get_autocast_dtype(device_);
  at::autocast::set_autocast_enabled(device_, true);
  at::autocast::set_autocast_dtype(device_, at::kBFloat16);
  // The cache is meant for weights in training; here it would only keep images.
  at::autocast::set_autocast_cache_enabled(false);
}

PrecisionScope::~PrecisionScope() {
  if (!active_) return;
  at::autocast::set_autocast_enabled(device_, enabled_);
  at::autocast::set_autocast_dtype(device_, type_);
  at::autocast::set_autocast_cache_enabled(cached_);
}

}  // namespace tt3d::model
