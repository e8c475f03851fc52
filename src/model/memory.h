#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <stdexcept>
#include <string>

namespace tt3d::model {

/// A run needs more memory than its limit; a smaller batch may fit.
class MemoryLimit : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Memory limit for a run's results: `limit`, or most of the free memory of the machine (or its
/// control group) if that is less.
[[nodiscard]] int64_t memory_budget(int64_t limit);

/// The free memory, what this process holds, and what to do, for the error of a lack of memory.
[[nodiscard]] std::string memory_state();

/// Counts the memory of a run's results. With autograd on, the backward pass keeps what it needs
/// even after the result itself is released, so nothing is subtracted.
class MemoryMeter {
 public:
  MemoryMeter(int64_t limit, bool keeps_all) : limit_(limit), keeps_all_(keeps_all) {}
  /// Throws MemoryLimit if the sum exceeds the limit.
  void add(const at::Tensor& tensor);
  void release(const at::Tensor& tensor);
  /// Throws MemoryLimit for a view whose copy would exceed the limit: many operators make such a
  /// copy internally.
  void check_size(const at::Tensor& tensor) const;
  [[nodiscard]] int64_t limit() const { return limit_; }

 private:
  int64_t limit_;
  bool keeps_all_;
  int64_t held_ = 0;
};

/// In its scope and thread, a single allocation of CPU memory beyond `bytes` throws MemoryLimit
/// before it is made. Thus no operator can exceed a run's limit, not even internally.
class AllocationLimit {
 public:
  explicit AllocationLimit(int64_t bytes);
  ~AllocationLimit();
  AllocationLimit(const AllocationLimit&) = delete;
  AllocationLimit& operator=(const AllocationLimit&) = delete;

 private:
  int64_t outer_;
};

/// True if torch failed because memory ran out.
[[nodiscard]] bool is_out_of_memory(const c10::Error& error);

}  // namespace tt3d::model
