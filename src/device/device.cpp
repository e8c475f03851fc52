#include "tt3d/device.h"

#include <ATen/ATen.h>

#include "tt3d/error.h"
#include "tt3d/gpu_options.h"

#ifdef TT3D_CUDA
#include <c10/cuda/CUDAFunctions.h>
#include <c10/cuda/CUDAStream.h>
#endif

namespace tt3d {
namespace {
GpuOptions chosen;
}  // namespace

void use_gpu_options(const GpuOptions& options) { chosen = options; }
const GpuOptions& gpu_options() { return chosen; }

#ifdef TT3D_CUDA

at::Device device_named(const std::string& name) {
  const bool visible = c10::cuda::device_count() > 0;
  if (name == "cpu" || (name == "auto" && !visible)) return at::kCPU;
  if (!visible) {
    throw InputError(
        "--device cuda: no CUDA device is visible (driver, CUDA_VISIBLE_DEVICES); "
        "use --device cpu");
  }
  return {at::kCUDA, c10::cuda::current_device()};
}

Cuda current_cuda() { return {c10::cuda::getCurrentCUDAStream().stream()}; }

#else

namespace {
constexpr const char* kNoCuda =
    "--device cuda: this build has no CUDA executors; build preset cuda (scripts/setup --cuda), "
    "or use --device cpu";
}  // namespace

at::Device device_named(const std::string& name) {
  if (name == "cuda") throw InputError(kNoCuda);
  return at::kCPU;
}

Cuda current_cuda() { throw InputError(kNoCuda); }

#endif

void check_same_device(const char* name, std::initializer_list<at::Tensor> tensors) {
  const at::Device device = tensors.begin()->device();
  for (const at::Tensor& t : tensors) {
    TORCH_CHECK(!t.defined() || t.device() == device, name, ": tensors on ", device, " and ",
                t.device());
  }
}

int64_t counts_to_begins(at::Tensor& counts) {
  if (counts.is_cpu()) {
    auto* p = counts.mutable_data_ptr<int64_t>();
    for (int64_t i = 1; i < counts.size(0); ++i) p[i] += p[i - 1];
    return p[counts.size(0) - 1];
  }
  counts = counts.cumsum(0);
  return counts[-1].item<int64_t>();
}

}  // namespace tt3d
