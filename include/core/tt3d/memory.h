#pragma once

#include <cstdint>

/// The memory of this process and of the machine. The programs allocate with jemalloc, which keeps
/// what a step frees for the next step (decision 15).
namespace tt3d {

/// Peak resident memory of this process in bytes. reset_peak_memory starts a new interval if the
/// kernel allows it (Linux, /proc/self/clear_refs).
[[nodiscard]] int64_t peak_memory_bytes() noexcept;
void reset_peak_memory() noexcept;
/// Resident memory of this process now, in bytes; 0 if the system does not tell.
[[nodiscard]] int64_t memory_bytes() noexcept;
/// Memory that this process may still take, in bytes: what is free on the machine, or in its
/// control group (container) if that is less.
[[nodiscard]] int64_t free_memory_bytes() noexcept;

/// Returns memory that is freed but still resident to the system.
void release_freed_memory() noexcept;

/// Keeps the freed memory of a loop within bounds. Steps of equal size reuse the memory of the step
/// before, so nothing is returned and no time is lost. If the sizes change from step to step, the
/// free pieces never fit, and resident memory grows; then the freed memory is returned.
class MemoryTrimmer {
 public:
  /// Call after each step.
  void after_step() noexcept;

 private:
  int64_t steps_ = 0;    ///< since the start or the last return
  int64_t largest_ = 0;  ///< resident bytes of the first kSettling of these steps
};

}  // namespace tt3d
