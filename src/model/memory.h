#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <stdexcept>

namespace tt3d::model {

/// A run needs more memory than it may take; a smaller batch may fit.
class MemoryLimit : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Memory that a run's results may hold: `limit`, or most of what the machine (or its control
/// group) has left if that is less.
[[nodiscard]] int64_t memory_budget(int64_t limit);

/// Counts the memory that the results of a run hold. With autograd on, what backward needs stays
/// after the result itself is released, so nothing is given back.
class MemoryMeter {
 public:
  MemoryMeter(int64_t limit, bool keeps_all) : limit_(limit), keeps_all_(keeps_all) {}
  /// Throws MemoryLimit past the limit.
  void add(const at::Tensor& tensor);
  void release(const at::Tensor& tensor);
  /// Throws MemoryLimit for a view that stands for more memory than there may be: a copy of it,
  /// which many operators make inside, would not fit.
  void check_size(const at::Tensor& tensor) const;

 private:
  int64_t limit_;
  bool keeps_all_;
  int64_t held_ = 0;
};

/// In its scope and thread, a single allocation of CPU memory beyond `bytes` throws MemoryLimit
/// before it is made: an operator cannot take more than a run may hold, not even inside.
class AllocationLimit {
 public:
  explicit AllocationLimit(int64_t bytes);
  ~AllocationLimit();
  AllocationLimit(const AllocationLimit&) = delete;
  AllocationLimit& operator=(const AllocationLimit&) = delete;

 private:
  int64_t outer_;
};

/// True if torch failed for want of memory.
[[nodiscard]] bool is_out_of_memory(const c10::Error& error);

}  // namespace tt3d::model
