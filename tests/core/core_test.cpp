#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <fstream>
#include <thread>

#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/tool.h"

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

constexpr int kNoDisk = 77;

/// Mounts a disk of 64 KiB that only this process sees: as root, or in a namespace where it is
/// root.
bool mount_small_disk(const std::filesystem::path& folder) {
  const std::string user = "0 " + std::to_string(::getuid()) + " 1";
  const std::string group = "0 " + std::to_string(::getgid()) + " 1";
  if (::unshare(CLONE_NEWNS) != 0) {
    if (::unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) return false;
    std::ofstream("/proc/self/uid_map") << user;
    std::ofstream("/proc/self/setgroups") << "deny";
    std::ofstream("/proc/self/gid_map") << group;
  }
  return ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0 &&
         ::mount("tmpfs", folder.c_str(), "tmpfs", 0, "size=64k") == 0;
}

/// Runs `test` in a child process with a disk of 64 KiB at `folder`. Returns what `test` returns,
/// or kNoDisk if this machine lets nobody mount one.
int on_small_disk(const std::filesystem::path& folder, const std::function<int()>& test) {
  const pid_t child = ::fork();
  if (child == 0) ::_exit(mount_small_disk(folder) ? test() : kNoDisk);
  int status = 0;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(Files, FullDiskIsAResourceErrorAndKeepsTheOldFile) {
  testing::TemporaryFolder folder;
  const auto path = folder / "file.txt";
  const auto test = [&] {
    write_file_atomic(path, "old");
    try {
      write_file_atomic(path, std::string(100 << 10, 'x'));
      return 1;
    } catch (const ResourceError& error) {
      if (std::string(error.what()).find("No space left") == std::string::npos) return 2;
    }
    if (read_file(path) != "old") return 3;
    const std::filesystem::directory_iterator files(folder.path());
    return std::distance(files, {}) == 1 ? 0 : 4;
  };
  const int result = on_small_disk(folder.path(), test);
  if (result == kNoDisk) GTEST_SKIP() << "this machine lets nobody mount a small disk";
  EXPECT_EQ(result, 0) << "1: no error, 2: another message, 3: the old file is lost, 4: more files";
}

TEST(Files, PlaceThatIsNoFolderIsAResourceError) {
  EXPECT_THROW(write_file_atomic("/dev/null/x", "x"), ResourceError);
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
  const double start = now_seconds();
  const ProcessResult result = run_process({"sleep", "60"}, 0.2);
  EXPECT_TRUE(result.timed_out);
  EXPECT_LT(now_seconds() - start, 20);
}

/// Whether a process exists and is not a zombie.
bool runs(const std::string& pid) {
  std::ifstream stat("/proc/" + pid + "/stat");
  std::string text;
  std::getline(stat, text);
  const size_t name_end = text.rfind(") ");
  return name_end != text.npos && text[name_end + 2] != 'Z' && text[name_end + 2] != 'X';
}

bool runs_within(const std::string& pid, double seconds) {
  const double end = now_seconds() + seconds;
  while (runs(pid) && now_seconds() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  return runs(pid);
}

TEST(Process, WatchGetsEachLineAsItComes) {
  std::vector<std::string> lines;
  std::vector<double> times;
  ProcessWatch watch;
  watch.on_line = [&](const std::string& line) {
    lines.push_back(line);
    times.push_back(now_seconds());
  };
  const ProcessResult result =
      watch_process({"sh", "-c", "echo one; sleep 0.5; echo two >&2; printf three"}, 20, watch);
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_FALSE(result.timed_out);
  EXPECT_EQ(lines, (std::vector<std::string>{"one", "two", "three"}));
  ASSERT_EQ(times.size(), 3U);
  EXPECT_GT(times[1] - times[0], 0.3);
  EXPECT_EQ(result.output, "one\ntwo\nthree");
}

TEST(Process, TimeLimitEndsWhatTheChildStarted) {
  std::string grandchild;
  ProcessWatch watch;
  watch.on_line = [&](const std::string& line) { grandchild = line; };
  const double start = now_seconds();
  const ProcessResult result = watch_process({"sh", "-c", "sleep 60 & echo $!; wait"}, 0.5, watch);
  EXPECT_TRUE(result.timed_out);
  EXPECT_EQ(result.exit_code, 128 + SIGKILL);
  EXPECT_LT(now_seconds() - start, 20);
  ASSERT_FALSE(grandchild.empty());
  EXPECT_FALSE(runs_within(grandchild, 10));
}

TEST(Process, TimeLimitHoldsForAChildThatClosedItsOutput) {
  const double start = now_seconds();
  const ProcessResult result = watch_process({"sh", "-c", "exec >&- 2>&-; sleep 60"}, 0.5, {});
  EXPECT_TRUE(result.timed_out);
  EXPECT_LT(now_seconds() - start, 20);
}

TEST(Process, WatchStopsIt) {
  ProcessWatch watch;
  int asked = 0;
  watch.stop = [&] { return ++asked > 1; };
  const double start = now_seconds();
  const ProcessResult result = watch_process({"sleep", "60"}, 50, watch);
  EXPECT_TRUE(result.timed_out);
  EXPECT_EQ(asked, 2);
  EXPECT_LT(now_seconds() - start, 20);
}

TEST(Process, LastLine) {
  EXPECT_EQ(last_line("a\nb\n\n"), "b");
  EXPECT_EQ(last_line("\n"), "no message");
}

TEST(Process, MissingProgram) {
  EXPECT_THROW((void)run_process({"no-such-program-tt3d"}, 1), MissingToolError);
}

}  // namespace
}  // namespace tt3d
