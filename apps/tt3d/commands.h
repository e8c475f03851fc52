#pragma once

#include <c10/core/Device.h>

#include <CLI/CLI.hpp>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/gpu_options.h"
#include "tt3d/record.h"

/// The subcommands of the program. Each function registers subcommands with a callback that does
/// the work. Errors are thrown as tt3d::Error; main() prints them as one line and returns the exit
/// code.
namespace tt3d::cli {

/// Options of every subcommand.
struct Common {
  std::string device = "auto";  ///< auto, cpu or cuda
  int threads = 0;              ///< 0: all cores
  GpuOptions gpu;
  uint64_t seed = 0;
  bool json = false;  ///< print results as JSON on stdout
  int verbosity = 0;
};

/// Adds --device, --threads, --seed, --json, -v and -q to a subcommand.
void add_common_options(CLI::App& command, Common& common);

/// Adds --half-mlp and --cuda-graphs to a subcommand that fits or attacks.
void add_gpu_options(CLI::App& command, Common& common);

/// Applies threads and GPU options and returns the device. Throws InputError if the device does not
/// exist, or for GPU options on a CPU.
at::Device apply_common(const Common& common);

/// `tt3d model check|classify|list`.
void add_model_command(CLI::App& app, Common& common);
/// `tt3d run`, and the single stages `fit`, `mesh`, `attack`, `bake`, `report`.
void add_run_commands(CLI::App& app, Common& common);
/// `tt3d evaluate` and `tt3d render`.
void add_evaluate_commands(CLI::App& app, Common& common);
/// `tt3d export`, `print-check`, `judge` and `video-score`.
void add_tool_commands(CLI::App& app, Common& common);
/// `tt3d photos`.
void add_photos_command(CLI::App& app, Common& common);
/// `tt3d info` and `tt3d config`.
void add_info_commands(CLI::App& app, Common& common);

/// The judgement of a capture, as `tt3d info` and the page of `tt3d photos` show it.
[[nodiscard]] nlohmann::json quality_json(const capture::CaptureQuality& quality);

/// A progress display on stderr. On a terminal it updates one line; elsewhere it prints notes only.
/// Ctrl-C stops long work.
[[nodiscard]] std::unique_ptr<Progress> make_progress(const Common& common);

/// Writes the reconstructed object of a run, before any attack, and returns its file.
[[nodiscard]] std::filesystem::path clean_asset(const std::filesystem::path& run,
                                                const Common& common);

/// Prints an evaluation on stdout, as a table or, with --json, as JSON.
void print_record(const record::EvaluationRecord& record, const Common& common);

}  // namespace tt3d::cli
