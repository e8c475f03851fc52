#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cmath>

#include "support/temporary_folder.h"
#include "tt3d/core.h"

namespace tt3d {
namespace {

TEST(Random, SameKeySameNumbers) {
  Random a(7, "views", 3);
  Random b(7, "views", 3);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(a.next(), b.next());
}

TEST(Random, StreamsStepsAndSeedsDiffer) {
  const uint32_t base = Random(7, "views", 3).next();
  EXPECT_NE(base, Random(8, "views", 3).next());
  EXPECT_NE(base, Random(7, "eot", 3).next());
  EXPECT_NE(base, Random(7, "views", 4).next());
}

TEST(Random, MomentsOfUniformAndNormal) {
  Random random(1, "moments");
  double sum = 0;
  double normal_sum = 0;
  double normal_squares = 0;
  constexpr int kCount = 100000;
  for (int i = 0; i < kCount; ++i) {
    sum += random.uniform();
    const double n = random.normal();
    normal_sum += n;
    normal_squares += n * n;
  }
  EXPECT_NEAR(sum / kCount, 0.5, 0.005);
  EXPECT_NEAR(normal_sum / kCount, 0.0, 0.02);
  EXPECT_NEAR(normal_squares / kCount, 1.0, 0.02);
}

TEST(Files, AtomicWriteReplacesWholeContent) {
  testing::TemporaryFolder folder;
  const auto path = folder / "sub/file.txt";
  write_file_atomic(path, "first");
  write_file_atomic(path, "second");
  EXPECT_EQ(read_file(path), "second");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(path.parent_path()), {}), 1);
}

TEST(Files, FailedWriterLeavesOldContentAndNoTemporary) {
  testing::TemporaryFolder folder;
  const auto path = folder / "file.txt";
  write_file_atomic(path, "old");
  EXPECT_THROW(
      write_file_atomic(
          path, [](const std::filesystem::path&) -> void { throw ResourceError("disk full"); }),
      ResourceError);
  EXPECT_EQ(read_file(path), "old");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
}

TEST(Files, FolderThatCannotBeMadeIsAResourceError) {
  EXPECT_THROW(write_file_atomic("/proc/tt3d/file", "x"), ResourceError);
}

TEST(Files, FullDiskIsAResourceError) {
  EXPECT_THROW(write_file_atomic("/dev/full/x", "x"), ResourceError);
}

TEST(Files, MissingFileNamesThePath) {
  try {
    (void)read_file("/nonexistent/x.png");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("/nonexistent/x.png"), std::string::npos);
    EXPECT_EQ(error.exit_code(), 2);
  }
}

TEST(Files, Sha256OfKnownText) {
  EXPECT_EQ(sha256("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Text, NearestName) {
  const std::vector<std::string> keys = {"attack.beta", "attack.steps", "field.steps"};
  EXPECT_EQ(nearest_name("attack.betta", keys), "attack.beta");
  EXPECT_EQ(nearest_name("something else", keys), "");
}

TEST(Text, Base64) { EXPECT_EQ(base64("hello"), "aGVsbG8="); }

TEST(Process, OutputAndExitCode) {
  const ProcessResult result = run_process({"sh", "-c", "echo hi; exit 3"}, 10);
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_EQ(result.output, "hi\n");
  EXPECT_FALSE(result.timed_out);
}

TEST(Process, TimeLimitEndsIt) {
  const ProcessResult result = run_process({"sleep", "30"}, 0.2);
  EXPECT_TRUE(result.timed_out);
}

TEST(Process, MissingProgram) {
  EXPECT_THROW((void)run_process({"no-such-program-tt3d"}, 1), MissingToolError);
}

}  // namespace
}  // namespace tt3d
