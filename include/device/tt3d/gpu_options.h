#pragma once

namespace tt3d {

/// How the GPU computes, for the whole process, as torch's own switches for TF32 are. Both off
/// unless asked for; the CPU takes no notice of them.
struct GpuOptions {
  /// The fields' networks fused on tensor cores: factors in float16, sums in float32.
  bool half_mlp = false;
  /// A classifier's passes with gradient are recorded once a batch size as CUDA graphs and played
  /// again from then on.
  bool graphs = false;
};

/// Sets them; call it before the work starts.
void use_gpu_options(const GpuOptions& options);
[[nodiscard]] const GpuOptions& gpu_options();

}  // namespace tt3d
