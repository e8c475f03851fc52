#include "memory.h"

#include <c10/core/CPUAllocator.h>
#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <string>

#include "tt3d/free_memory.h"

namespace tt3d::model {
namespace {

constexpr int64_t kUnlimited = std::numeric_limits<int64_t>::max();
thread_local int64_t largest_allocation = kUnlimited;

/// Torch's own allocator with the limit of AllocationLimit.
class LimitedAllocator final : public c10::Allocator {
 public:
  explicit LimitedAllocator(c10::Allocator* inner) : inner_(inner) {}
  c10::DataPtr allocate(size_t bytes) override {
    if (bytes > static_cast<size_t>(largest_allocation)) {
      throw MemoryLimit(fmt::format("an intermediate result of {} bytes exceeds the limit of {}",
                                    bytes, largest_allocation));
    }
    return inner_->allocate(bytes);
  }
  c10::DeleterFnPtr raw_deleter() const override { return inner_->raw_deleter(); }
  void copy_data(void* target, const void* source, std::size_t bytes) const override {
    inner_->copy_data(target, source, bytes);
  }

 private:
  c10::Allocator* inner_;
};

/// Installs the limit in front of torch's allocator, once per process.
void install_limit() {
  static LimitedAllocator* const limited = [] {
    // Never freed: tensors of static lifetime may use it until the process ends.
    auto* allocator = new LimitedAllocator(c10::GetCPUAllocator());
    c10::SetCPUAllocator(allocator, std::numeric_limits<uint8_t>::max());
    return allocator;
  }();
  (void)limited;
}

}  // namespace

int64_t memory_budget(int64_t limit) {
  // The backward pass needs memory in addition to what the forward pass keeps.
  const int64_t left = free_memory_bytes() / 4 * 3;
  return std::min(limit, left);
}

void MemoryMeter::add(const at::Tensor& tensor) {
  held_ += static_cast<int64_t>(tensor.storage().nbytes());
  if (held_ <= limit_) return;
  throw MemoryLimit(fmt::format("intermediate results exceed the limit of {} bytes", limit_));
}

void MemoryMeter::release(const at::Tensor& tensor) {
  if (keeps_all_ || tensor.storage().use_count() != 1) return;
  held_ -= static_cast<int64_t>(tensor.storage().nbytes());
}

void MemoryMeter::check_size(const at::Tensor& tensor) const {
  if (static_cast<int64_t>(tensor.nbytes()) <= limit_) return;
  throw MemoryLimit(fmt::format("an intermediate result of {} bytes exceeds the limit of {}",
                                tensor.nbytes(), limit_));
}

AllocationLimit::AllocationLimit(int64_t bytes) : outer_(largest_allocation) {
  install_limit();
  largest_allocation = std::min(bytes, outer_);
}

AllocationLimit::~AllocationLimit() { largest_allocation = outer_; }

bool is_out_of_memory(const c10::Error& error) {
  if (dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr) return true;
  const std::string text = error.what_without_backtrace();
  return text.find("DefaultCPUAllocator") != std::string::npos;
}

}  // namespace tt3d::model
