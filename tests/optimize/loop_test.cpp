#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "support/count_notes.h"
#include "support/stop_after.h"
#include "support/temporary_folder.h"
#include "tt3d/optimize.h"

namespace tt3d::optimize {
namespace {

using at::Tensor;

/// Minimises a parabola; it can be told to fail.
class Parabola final : public Optimization {
 public:
  void restart() override {
    ++restarts;
    x = at::full({3}, 4.0);
    path = at::zeros({0, 1});
  }
  void visit_state(StateVisitor& visit) override {
    visit.tensor("x", x);
    visit.replace("path", path);
  }
  StepLoss compute(int64_t step) override {
    ++calls;
    if (calls >= out_of_memory_from && calls <= out_of_memory_to) {
      C10_THROW_ERROR(OutOfMemoryError, "no memory");
    }
    const double loss = bad_calls.contains(calls) ? bad_loss : x.square().sum().item<double>();
    static_cast<void>(step);
    return {loss, {{"loss", loss}}};
  }
  void apply(int64_t step, double rate_scale) override {
    rates.push_back(rate_scale);
    x.sub_(0.1 * rate_scale * x);
    path = at::cat({path, at::full({1, 1}, static_cast<double>(step), at::kFloat)});
  }
  void after_step(int64_t step) override { last = step; }
  [[nodiscard]] bool finished() const override { return last + 1 >= stop_at; }
  bool halve_batch() override { return (batch /= 2) > 0; }

  Tensor x, path;
  std::set<int> bad_calls;
  double bad_loss = std::nan("");
  int out_of_memory_from = 1, out_of_memory_to = 0;
  int calls = 0, restarts = 0, batch = 8;
  int64_t last = -1, stop_at = 1000;
  std::vector<double> rates;
};

LoopOptions options_with(const std::filesystem::path& checkpoint) {
  return {"parabola", 40, 6, checkpoint, "lower the rate", "lower the batch"};
}

TEST(Loop, RunsAllStepsInOrder) {
  Parabola p;
  Progress quiet;
  run_loop(p, options_with({}), quiet);
  ASSERT_EQ(p.path.size(0), 40);
  EXPECT_TRUE(at::equal(p.path.flatten(), at::arange(40).to(at::kFloat)));
  EXPECT_NEAR(p.x[0].item<double>(), 4 * std::pow(0.9, 40), 1e-5);
}

TEST(Loop, AStopAndAResumeGiveTheSameBytes) {
  testing::TemporaryFolder folder;
  Progress quiet;
  Parabola whole;
  run_loop(whole, options_with(folder / "whole"), quiet);
  for (const int steps : {5, 9, 13}) {
    Parabola part;
    testing::StopAfter stop(steps);
    EXPECT_THROW(run_loop(part, options_with(folder / "stopped"), stop), Interrupted);
  }
  Parabola rest;
  run_loop(rest, options_with(folder / "stopped"), quiet);
  EXPECT_LT(rest.calls, 40);
  EXPECT_TRUE(at::equal(whole.x, rest.x));
  EXPECT_TRUE(at::equal(whole.path, rest.path));
}

TEST(Loop, RollsBackAtHalfTheRateIfALossIsNotFiniteOrExplodes) {
  for (const double bad : std::vector<double>{std::nan(""), INFINITY, 1e9, -1e9}) {
    testing::TemporaryFolder folder;
    Parabola p;
    p.bad_loss = bad;
    p.bad_calls = {15, 16};
    testing::CountNotes notes;
    run_loop(p, options_with(folder / "c"), notes);
    EXPECT_EQ(notes.count, 2) << bad;
    EXPECT_EQ(p.restarts, 3);  // the start and each roll-back
    // After the roll-back to the checkpoint at step 12, each step occurs once.
    EXPECT_TRUE(at::equal(p.path.flatten(), at::arange(40).to(at::kFloat))) << bad;
    EXPECT_EQ(p.rates.front(), 1);
    EXPECT_EQ(p.rates.back(), 0.25);
  }
}

TEST(Loop, ALargeLossAtTheStartIsNotAnExplosion) {
  Parabola p;
  p.bad_loss = 1e9;
  p.bad_calls = {1};
  testing::CountNotes notes;
  run_loop(p, options_with({}), notes);
  EXPECT_EQ(notes.count, 0);
}

TEST(Loop, GivesUpAfterThreeRollBacksWithAdvice) {
  testing::TemporaryFolder folder;
  Parabola p;
  for (int i = 15; i < 1000; ++i) p.bad_calls.insert(i);
  testing::CountNotes notes;
  try {
    run_loop(p, options_with(folder / "c"), notes);
    FAIL();
  } catch (const NumericError& error) {
    EXPECT_NE(std::string(error.what()).find("lower the rate"), std::string::npos);
  }
  EXPECT_EQ(notes.count, 3);
}

TEST(Loop, TheHalvedRateSurvivesAResume) {
  testing::TemporaryFolder folder;
  Parabola p;
  p.bad_calls = {15};
  testing::StopAfter stop(25);
  EXPECT_THROW(run_loop(p, options_with(folder / "c"), stop), Interrupted);
  Parabola rest;
  Progress quiet;
  run_loop(rest, options_with(folder / "c"), quiet);
  EXPECT_EQ(rest.rates.front(), 0.5);
}

TEST(Loop, OutOfMemoryHalvesTheBatch) {
  Parabola p;
  p.out_of_memory_from = 10;
  p.out_of_memory_to = 11;
  testing::CountNotes notes;
  run_loop(p, options_with({}), notes);
  EXPECT_EQ(notes.count, 2);
  EXPECT_EQ(p.batch, 2);
  EXPECT_EQ(p.path.size(0), 40);
  Parabola hopeless;
  hopeless.out_of_memory_from = 1;
  hopeless.out_of_memory_to = 1000;
  try {
    run_loop(hopeless, options_with({}), notes);
    FAIL();
  } catch (const ResourceError& error) {
    EXPECT_NE(std::string(error.what()).find("lower the batch"), std::string::npos);
  }
}

TEST(Loop, EndsEarlyIfTheOptimizationIsFinished) {
  Parabola p;
  p.stop_at = 11;
  Progress quiet;
  run_loop(p, options_with({}), quiet);
  EXPECT_EQ(p.path.size(0), 11);
}

TEST(Loop, ACheckpointOfAnotherOptimizationIsAnInputError) {
  testing::TemporaryFolder folder;
  Progress quiet;
  Parabola p;
  run_loop(p, options_with(folder / "c"), quiet);
  class Other : public Optimization {
   public:
    void restart() override {}
    void visit_state(StateVisitor& visit) override { visit.tensor("y", y); }
    StepLoss compute(int64_t) override { return {}; }
    void apply(int64_t, double) override {}
    Tensor y = at::zeros({2});
  } other;
  EXPECT_THROW(run_loop(other, options_with(folder / "c"), quiet), InputError);
}

}  // namespace
}  // namespace tt3d::optimize
