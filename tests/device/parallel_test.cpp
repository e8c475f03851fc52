#include <ATen/Parallel.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "tt3d/device.h"

namespace tt3d {
namespace {

TEST(ForEachIndex, RunsOnAsManyThreadsAsAskedFor) {
  const int before = at::get_num_threads();
  at::set_num_threads(2);
  std::atomic<int> seen = 0;  // one bit per thread
  std::atomic<int64_t> items = 0;
  for_each_index(int64_t{1} << 16, [&](int64_t) {
    seen |= 1 << at::get_thread_num();
    ++items;
  });
  at::set_num_threads(before);
  EXPECT_EQ(seen, 3);
  EXPECT_EQ(items, int64_t{1} << 16);
}

TEST(ForEachTask, TakesEachTaskOnce) {
  const int before = at::get_num_threads();
  for (const int threads : {1, 2, 5}) {
    at::set_num_threads(threads);
    for (const int64_t tasks : {0, 1, 3, 1000}) {
      std::vector<std::atomic<int>> taken(tasks);
      for_each_task(tasks, [&](int64_t task) { ++taken[task]; });
      for (const auto& times : taken) EXPECT_EQ(times, 1) << threads << " threads";
    }
  }
  at::set_num_threads(before);
}

TEST(ForEachTask, AThreadThatWaitsLeavesTheRestToTheOther) {
  const int before = at::get_num_threads();
  at::set_num_threads(2);
  std::atomic<int> done = 0;
  // A fixed split would give half of the tasks to the first task's thread, which would then wait
  // for ever.
  for_each_task(8, [&](int64_t task) {
    while (task == 0 && done < 7) std::this_thread::yield();
    ++done;
  });
  at::set_num_threads(before);
  EXPECT_EQ(done, 8);
}

}  // namespace
}  // namespace tt3d
