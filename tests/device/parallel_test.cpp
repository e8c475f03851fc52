#include <ATen/Parallel.h>
#include <gtest/gtest.h>

#include <atomic>

#include "tt3d/device.h"

namespace tt3d {
namespace {

TEST(ForEachIndex, RunsOnAsManyThreadsAsAskedFor) {
  const int before = at::get_num_threads();
  at::set_num_threads(2);
  std::atomic<int> seen = 0;  // a bit a thread
  std::atomic<int64_t> items = 0;
  for_each_index(int64_t{1} << 16, [&](int64_t) {
    seen |= 1 << at::get_thread_num();
    ++items;
  });
  at::set_num_threads(before);
  EXPECT_EQ(seen, 3);
  EXPECT_EQ(items, int64_t{1} << 16);
}

}  // namespace
}  // namespace tt3d
