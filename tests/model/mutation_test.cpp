#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fstream>

#include "model/package_tools.h"
#include "support/temporary_folder.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

using testing::Entries;

constexpr rlim_t kMemoryCap = rlim_t{2} << 30;
constexpr int kByteMutants = 4000;
constexpr int kGraphMutants = 1000;

/// Address space in use, from /proc/self/statm.
rlim_t address_space() {
  rlim_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  return pages * 4096;
}

/// Damaged copies of the toy network, loaded under a memory limit. The card's checksum is that of
/// the damaged file, as if an attacker had written both.
class Mutation : public ::testing::Test {
 protected:
  void SetUp() override {
    // The first run starts threads and fills caches; the limit applies to what mutants add.
    expected = Classifier::load(testing::fixture("toy_cnn.pt2").string())->logits(images);
    const rlim_t cap = address_space() + kMemoryCap;
    const rlimit limit{cap, RLIM_INFINITY};
    ASSERT_EQ(::setrlimit(RLIMIT_AS, &limit), 0);
  }
  void TearDown() override {
    const rlimit limit{RLIM_INFINITY, RLIM_INFINITY};
    ::setrlimit(RLIMIT_AS, &limit);
  }

  /// Loads the package: either the logits are unchanged, or it throws a typed error of one line.
  void expect_answer_or_error(const std::string& mutant) {
    testing::write_card(path, "toy_cnn");
    ModelLimits limits;
    limits.intermediate_bytes = int64_t{64} << 20;
    try {
      const auto model = Classifier::load(path.string(), limits);
      EXPECT_TRUE(at::allclose(model->logits(images), expected, 1e-2, 1e-3)) << mutant;
      ++loaded;
    } catch (const Error& error) {
      const std::string line = error.what();
      EXPECT_EQ(line.find('\n'), std::string::npos) << mutant << ": " << line;
      EXPECT_NE(line.find(path.string()), std::string::npos) << mutant << ": " << line;
      ++refused;
    }
  }

  testing::TemporaryFolder folder;
  std::filesystem::path path = folder / "toy.pt2";
  at::Tensor images = at::linspace(0, 1, 2 * 3 * 16 * 16).view({2, 3, 16, 16});
  at::Tensor expected;
  int loaded = 0, refused = 0;
};

TEST_F(Mutation, FlippedBytesOfTheFile) {
  const std::string good = read_file(testing::fixture("toy_cnn.pt2"));
  Random random(1, "bytes");
  for (int i = 0; i < kByteMutants; ++i) {
    std::string bytes = good;
    const int64_t flips = 1 + random.index(3);
    for (int64_t k = 0; k < flips; ++k) {
      char& byte = bytes[static_cast<size_t>(random.index(static_cast<int64_t>(bytes.size())))];
      byte = static_cast<char>(byte ^ (1 + random.index(255)));
    }
    std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
    expect_answer_or_error("mutant " + std::to_string(i));
  }
  EXPECT_GT(loaded, 0) << "bytes that nothing reads";
  EXPECT_GT(refused, kByteMutants / 2);
}

TEST_F(Mutation, FlippedBytesOfTheGraphAndTheTables) {
  const std::string root = "toy_cnn/";
  const Entries good = testing::unpack(testing::fixture("toy_cnn.pt2"));
  Random random(1, "mutations");
  for (int i = 0; i < kGraphMutants; ++i) {
    Entries mutated = good;
    std::string& text = mutated[root + (i % 3 == 0 ? "data/weights/model_weights_config.json"
                                                   : "models/model.json")];
    for (int k = 0; k < 1 + i % 3; ++k) {
      text[static_cast<size_t>(random.index(static_cast<int64_t>(text.size())))] =
          static_cast<char>(random.index(96) + 32);
    }
    testing::pack(path, mutated);
    expect_answer_or_error("mutant " + std::to_string(i));
  }
  EXPECT_GT(loaded, 0);
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace tt3d::model
