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

/// What all rooms share: progress and cancel, seeded random streams, atomic files, hashes, child
/// processes. The library never prints; it reports through Progress.
namespace tt3d {

// ---- Progress and cancel ------------------------------------------------------------------

/// Named figures next to a progress bar, e.g. {"psnr", 31.2}.
using Metrics = std::vector<std::pair<std::string, double>>;

/// Long work reports to this, and asks it whether to stop. The default does nothing.
class Progress {
 public:
  virtual ~Progress() = default;
  /// A stage of `total` steps begins; the first `done` steps are complete already (resume).
  virtual void begin(std::string_view stage, int64_t total, int64_t done) {
    (void)stage, (void)total, (void)done;
  }
  /// `done` of the steps are complete; `metrics` are the latest figures.
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

// ---- Randomness ---------------------------------------------------------------------------

/// Counter-based random numbers (Philox4x32-10; Salmon et al., "Parallel random numbers: as easy as
/// 1, 2, 3", SC 2011), keyed by (seed, stream, step). There is no global state, every machine draws
/// the same numbers, and any step can be drawn without the earlier ones.
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
  /// The key of the stream, for kernels; it counts from the beginning.
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

/// Writes a temporary file in the same folder, then fsync and rename. The path holds either the old
/// or the new content, never a part. Creates the parent folder. Throws ResourceError (full disk,
/// read-only folder).
void write_file_atomic(const std::filesystem::path& path, std::string_view bytes);

/// The same for writers that need a path: `write` fills the temporary file.
void write_file_atomic(const std::filesystem::path& path,
                       const std::function<void(const std::filesystem::path& temporary)>& write);

/// Creates a folder and its parents; throws ResourceError if that fails.
void make_folder(const std::filesystem::path& path);

/// SHA-256 as 64 lower-case hex digits.
[[nodiscard]] std::string sha256(std::string_view bytes);
[[nodiscard]] std::string sha256_file(const std::filesystem::path& path);

// ---- Texts --------------------------------------------------------------------------------

/// The candidate with the smallest edit distance to `word`, or "" if that distance exceeds a third
/// of the longer word.
[[nodiscard]] std::string nearest_name(std::string_view word,
                                       std::span<const std::string> candidates);

/// Standard base64 (RFC 4648), for data inside JSON and HTML.
[[nodiscard]] std::string base64(std::string_view bytes);

// ---- Child processes ----------------------------------------------------------------------

/// The result of a finished child process.
struct ProcessResult {
  int exit_code = 0;       ///< 128 + signal if it was killed
  bool timed_out = false;  ///< ended at the time limit
  std::string output;      ///< stdout and stderr, together
};

/// Runs `command` (argv, no shell) and ends it at the time limit (seconds). Throws MissingToolError
/// if the program does not exist.
[[nodiscard]] ProcessResult run_process(const std::vector<std::string>& command,
                                        double time_limit_seconds);

/// Seconds on a monotonic clock.
[[nodiscard]] double now_seconds() noexcept;

}  // namespace tt3d
