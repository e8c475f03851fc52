#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <csignal>
#include <iostream>

#include "commands.h"

namespace tt3d::cli {
namespace {

std::atomic<bool> interrupted{false};

/// The first signal stops the work at its next step; the second ends the program at once.
void on_signal(int) {
  if (interrupted.exchange(true)) std::_Exit(130);
}

std::string duration(double seconds) {
  const auto s = std::lround(seconds);
  return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
                   : fmt::format("{}:{:02}", s / 60, s % 60);
}

class TerminalProgress : public Progress {
 public:
  explicit TerminalProgress(int verbosity)
      : live_(::isatty(2) == 1 && verbosity >= 0), quiet_(verbosity < 0), lines_(verbosity > 0) {
    std::signal(SIGINT, on_signal);
    std::signal(SIGTERM, on_signal);
  }

  void begin(std::string_view stage, int64_t total, int64_t done) override {
    stage_ = stage;
    total_ = total;
    first_ = done;
    start_ = last_drawn_ = now_seconds();
  }

  void update(int64_t done, const Metrics& metrics) override {
    const double now = now_seconds();
    const double pause = live_ ? 0.2 : 5.0;
    if ((!live_ && !lines_) || (now - last_drawn_ < pause && done < total_)) return;
    last_drawn_ = now;
    const double rate = static_cast<double>(done - first_) / std::max(1e-9, now - start_);
    std::string line =
        fmt::format("{:<12} {:>6}/{} {:>8.3g}/s  left {}", stage_, done, total_, rate,
                    duration(static_cast<double>(total_ - done) / std::max(1e-9, rate)));
    for (const auto& [name, value] : metrics) line += fmt::format("  {} {:.4g}", name, value);
    if (live_)
      std::cerr << "\r\x1b[K" << line << std::flush;
    else
      std::cerr << line << "\n";
    drawn_ = live_;
  }

  void end() override {
    if (drawn_) std::cerr << "\n";
    drawn_ = false;
  }

  void note(const std::string& line) override {
    if (quiet_) return;
    end();
    std::cerr << "note: " << line << "\n";
  }

  [[nodiscard]] bool cancelled() const override { return interrupted.load(); }

 private:
  bool live_, quiet_, lines_, drawn_ = false;
  std::string stage_;
  int64_t total_ = 0, first_ = 0;
  double start_ = 0, last_drawn_ = 0;
};

}  // namespace

std::unique_ptr<Progress> make_progress(const Common& common) {
  return std::make_unique<TerminalProgress>(common.verbosity);
}

}  // namespace tt3d::cli
