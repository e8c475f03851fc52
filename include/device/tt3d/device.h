#pragma once

#include <ATen/Parallel.h>
#include <ATen/core/Tensor.h>
#include <c10/core/DeviceGuard.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <initializer_list>
#include <string>

#include "tt3d/kernel.h"

/// One maths body for CPU and CUDA (docs/architecture.md): tt3d/kernel.h has the parts of a body,
/// this header the CPU's loops and the choice of the device, tt3d/cuda.h the GPU's loop.
namespace tt3d {

/// Calls `body(task, workspace)` for every task in [0, n), in parallel. For independent tasks of
/// uneven cost, or if other programs use the cores too: a thread takes the next task when it has
/// finished its last. Tasks start in order, so put the costliest first. `make()` gives each thread
/// its workspace.
template <typename Make, typename Body>
void for_each_task(int64_t n, const Make& make, const Body& body) {
  std::atomic<int64_t> next = 0;
  at::parallel_for(0, std::min<int64_t>(n, at::get_num_threads()), 1, [&](int64_t, int64_t) {
    auto workspace = make();
    for (int64_t task = next++; task < n; task = next++) body(task, workspace);
  });
}

/// The same without a workspace: calls `body(task)`.
template <typename Body>
void for_each_task(int64_t n, const Body& body) {
  const auto nothing = [] { return 0; };
  for_each_task(n, nothing, [&](int64_t task, int) { body(task); });
}

/// Calls `body(begin, end)` over [0, n) in chunks of exactly `chunk` items (the last may be
/// shorter). The chunks do not depend on the number of threads: results per chunk that are combined
/// in chunk order give the same bytes with 1 or N threads.
template <typename Body>
void for_each_chunk(int64_t n, int64_t chunk, const Body& body) {
  for_each_task((n + chunk - 1) / chunk,
                [&](int64_t c) { body(c * chunk, std::min(n, (c + 1) * chunk)); });
}

/// Calls `body(i)` for every i in [0, n), in parallel; for independent items.
template <typename Body>
void for_each_index(int64_t n, const Body& body) {
  at::parallel_for(0, n, 1024, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) body(i);
  });
}

template <typename Body>
void for_each_index(const Cpu&, int64_t n, const Body& body) {
  for_each_index(n, body);
}

// ---- Choice of the device -----------------------------------------------------------------

/// The device for "auto", "cpu" or "cuda"; auto is the GPU if there is one. Throws InputError for
/// "cuda" in a build without CUDA executors, or if no GPU is visible.
[[nodiscard]] at::Device device_named(const std::string& name);

/// The GPU's executor on torch's current stream. Throws InputError in a build without CUDA.
[[nodiscard]] Cuda current_cuda();

/// Throws c10::Error unless all tensors (undefined ones aside) are on the first one's device.
void check_same_device(const char* name, std::initializer_list<at::Tensor> tensors);

/// Calls `body` with the executor of the tensor's device. Kernels choose the device only here.
template <typename Body>
void on_device_of(const at::Tensor& tensor, const Body& body) {
  if (tensor.is_cpu()) {
    body(Cpu{});
    return;
  }
#ifdef TT3D_CUDA
  const c10::DeviceGuard guard(tensor.device());
  body(current_cuda());
#else
  (void)current_cuda();  // throws
#endif
}

/// Calls `body(i)` for every i in [0, n) on the tensor's device; for independent items, and for
/// sums in any order (accumulate).
template <typename Body>
void for_each_index_on(const at::Tensor& tensor, int64_t n, const Body& body) {
  on_device_of(tensor, [&](const auto& on) { for_each_index(on, n, body); });
}

/// Turns counts [n + 1] int64 (element 0 is 0) into the first index of each item's list, in place;
/// returns the total length of the lists.
int64_t counts_to_begins(at::Tensor& counts);

}  // namespace tt3d
