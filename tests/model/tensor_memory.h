#pragma once

#include <c10/core/CPUAllocator.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <mutex>
#include <unordered_map>

namespace tt3d::testing {

/// Counts the bytes of all CPU tensors exactly, from the first use on. The kernel's figure for a
/// process would depend on the allocator's arenas and on earlier work.
class TensorMemory final : public c10::Allocator {
 public:
  static TensorMemory& instance() {
    static TensorMemory* const memory = [] {
      // Never freed: tensors of static lifetime may use it until the process ends.
      auto* allocator = new TensorMemory(c10::GetCPUAllocator());
      c10::SetCPUAllocator(allocator, std::numeric_limits<uint8_t>::max());
      return allocator;
    }();
    return *memory;
  }

  /// Peak number of bytes during `work`, minus the bytes in use before it.
  template <typename Work>
  int64_t peak_growth(const Work& work) {
    const int64_t before = restart();
    work();
    const std::scoped_lock lock(mutex_);
    return peak_ - before;
  }

  c10::DataPtr allocate(size_t bytes) override {
    c10::DataPtr data = inner_->allocate(bytes);
    const std::scoped_lock lock(mutex_);
    if (data.get() != nullptr) sizes_[data.get()] = static_cast<int64_t>(bytes);
    peak_ = std::max(peak_, held_ += static_cast<int64_t>(bytes));
    return {data.get(), data.release_context(), &TensorMemory::release, data.device()};
  }
  c10::DeleterFnPtr raw_deleter() const override { return &TensorMemory::release; }
  void copy_data(void* target, const void* source, std::size_t bytes) const override {
    inner_->copy_data(target, source, bytes);
  }

 private:
  explicit TensorMemory(c10::Allocator* inner) : inner_(inner) {}

  int64_t restart() {
    const std::scoped_lock lock(mutex_);
    return peak_ = held_;
  }

  static void release(void* data) {
    TensorMemory& memory = instance();
    {
      const std::scoped_lock lock(memory.mutex_);
      const auto found = memory.sizes_.find(data);
      if (found != memory.sizes_.end()) {
        memory.held_ -= found->second;
        memory.sizes_.erase(found);
      }
    }
    memory.inner_->raw_deleter()(data);
  }

  c10::Allocator* inner_;
  std::mutex mutex_;
  std::unordered_map<void*, int64_t> sizes_;
  int64_t held_ = 0, peak_ = 0;
};

}  // namespace tt3d::testing
