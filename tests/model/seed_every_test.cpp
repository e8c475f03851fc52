// ATen's default generator starts from the machine's entropy, so that at::rand of an unseeded test
// would differ from run to run: each test starts from the same seed, whatever ran before it.

#include <ATen/Context.h>
#include <gtest/gtest.h>

namespace tt3d {
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
}  // namespace tt3d
