// ATen's default generator starts with random bits of the machine. Each test therefore sets the
// same seed, so that at::rand gives the same numbers in every run and any test order.

#include <ATen/Context.h>
#include <gtest/gtest.h>

namespace tt3d::model {
namespace {

class SeedEveryTest : public ::testing::EmptyTestEventListener {
 public:
  void OnTestStart(const ::testing::TestInfo& /*test*/) override { at::manual_seed(0); }
};

[[maybe_unused]] const bool registered = [] {
  ::testing::UnitTest::GetInstance()->listeners().Append(new SeedEveryTest);  // gtest owns it
  return true;
}();

}  // namespace
}  // namespace tt3d::model
