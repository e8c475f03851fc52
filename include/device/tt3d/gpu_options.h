#pragma once

namespace tt3d {

/// Modes of the GPU for the whole process, like torch's own switches for TF32. Both are off by
/// default; the CPU ignores them.
struct GpuOptions {
  /// Runs the fields' MLPs fused on tensor cores: factors in float16, sums in float32.
  bool half_mlp = false;
  /// Records a classifier's passes with gradient as CUDA graphs, one per batch size, and replays
  /// them.
  bool graphs = false;
};

/// Sets them. Call it before the work starts.
void use_gpu_options(const GpuOptions& options);
[[nodiscard]] const GpuOptions& gpu_options();

}  // namespace tt3d
