#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tt3d/error.h"
#include "tt3d/philox.h"

/// What every room shares: progress and cancel, seeded random streams, atomic files, hashes,
/// child processes. The library never prints; it reports through Progress.
namespace tt3d {

// ---- Progress and cancel ------------------------------------------------------------------

/// Named figures shown next to a progress bar, e.g. {"psnr", 31.2}.
using Metrics = std::vector<std::pair<std::string, double>>;

/// Where long work reports to, and where it learns that it should stop. The default does nothing.
class Progress {
 public:
  virtual ~Progress() = default;
  /// A stage of `total` steps begins, the first `done` of which are already there (resume).
  virtual void begin(std::string_view stage, int64_t total, int64_t done) {
    (void)stage, (void)total, (void)done;
  }
  /// `done` of the steps are complete; `metrics` are the latest figures that matter.
  virtual void update(int64_t done, const Metrics& metrics) { (void)done, (void)metrics; }
  /// The stage ended.
  virtual void end() {}
  /// One line for the user: a warning or a note.
  virtual void note(const std::string& line) { (void)line; }
  /// True once the user asked to stop (Ctrl-C).
  [[nodiscard]] virtual bool cancelled() const { return false; }
  /// Throws Interrupted if the user asked to stop. Call between steps.
  void check() const {
    if (cancelled()) throw Interrupted();
  }
};

/// What is done about a loss that is not finite: back to the last good state, on with half the
/// learning rates, three times at most.
struct Recovery {
  int rollbacks = 0;
  double rate_scale = 1;  ///< of the learning rates

  /// The state of things after one more divergence, of `stage` at `step`. Notes it in `progress`;
  /// throws NumericError with `advice` where three roll-backs did not help.
  [[nodiscard]] Recovery after_divergence(std::string_view stage, int64_t step,
                                          std::string_view advice, Progress& progress) const;
};

// ---- Randomness ---------------------------------------------------------------------------

/// Counter-based random numbers (Philox4x32-10; Salmon et al., "Parallel random numbers: as easy
/// as 1, 2, 3", SC 2011), keyed by (seed, stream, step): no global state, the same numbers on
/// any machine, and any step can be drawn without the ones before it.
class Random {
 public:
  Random(uint64_t seed, std::string_view stream, uint64_t step = 0);

  /// Uniform 32 bits.
  uint32_t next();
  /// Uniform in [0,1), 24 bits.
  float uniform();
  /// Uniform in [low, high).
  double uniform(double low, double high);
  /// Standard normal (Box-Muller).
  double normal();
  /// Uniform integer in [0, n); n > 0.
  int64_t index(int64_t n);
  /// The stream from its beginning, for kernels.
  [[nodiscard]] RandomKey key() const { return key_; }

 private:
  RandomKey key_;
  uint64_t counter_ = 0;
  RandomBlock block_{};
  int used_ = 4;
};

/// FNV-1a hash of a text, to key streams by name.
[[nodiscard]] uint64_t hash_name(std::string_view text) noexcept;

// ---- Files --------------------------------------------------------------------------------

/// Whole file as bytes. Throws InputError if it cannot be read.
[[nodiscard]] std::string read_file(const std::filesystem::path& path);

/// Writes through a temporary file in the same folder, fsync and rename, so that the path holds
/// either the old or the new content, never half. Creates the parent folder. Throws
/// ResourceError (full disk, read-only folder).
void write_file_atomic(const std::filesystem::path& path, std::string_view bytes);

/// The same for writers that want a path: `write` fills the temporary file it is given.
void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(const std::filesystem::path& temporary)>& write);

/// Creates a folder and its parents; throws ResourceError where that fails.
void make_folder(const std::filesystem::path& path);

/// SHA-256 as 64 lower-case hex digits.
[[nodiscard]] std::string sha256(std::string_view bytes);
[[nodiscard]] std::string sha256_file(const std::filesystem::path& path);

// ---- Texts --------------------------------------------------------------------------------

/// The candidate with the smallest edit distance to `word`, or "" when none is near (distance
/// over a third of the longer word).
[[nodiscard]] std::string nearest_name(std::string_view word,
                                       std::span<const std::string> candidates);

/// Standard base64 (RFC 4648), for data inside JSON and HTML.
[[nodiscard]] std::string base64(std::string_view bytes);

// ---- Child processes ----------------------------------------------------------------------

/// What a finished child process left.
struct ProcessResult {
  int exit_code = 0;       ///< 128+signal when it was killed
  bool timed_out = false;  ///< ended by us at the time limit
  std::string output;      ///< stdout and stderr, together
};

/// Runs `command` (argv, no shell) with a time limit in seconds and ends it beyond that.
/// Throws MissingToolError if the program does not exist.
[[nodiscard]] ProcessResult run_process(const std::vector<std::string>& command,
                                        double time_limit_seconds);

/// Seconds on a monotonic clock.
[[nodiscard]] double now_seconds() noexcept;

/// Peak resident memory of this process in bytes; reset_peak_memory starts a new interval
/// where the kernel allows it (Linux, /proc/self/clear_refs).
[[nodiscard]] int64_t peak_memory_bytes() noexcept;
void reset_peak_memory() noexcept;

}  // namespace tt3d
