#pragma once

#include <c10/core/Device.h>

#include <CLI/CLI.hpp>
#include <cstdint>
#include <memory>
#include <string>

#include "tt3d/core.h"
#include "tt3d/gpu_options.h"

/// The subcommands of the program. Each function registers one with a callback that does the
/// work; errors leave as tt3d::Error and main() turns them into a line and an exit code.
namespace tt3d::cli {

/// Options that every subcommand takes.
struct Common {
  std::string device = "auto";  ///< auto, cpu or cuda
  int threads = 0;              ///< 0: all
  GpuOptions gpu;
  uint64_t seed = 0;
  bool json = false;  ///< print results as JSON on stdout
  int verbosity = 0;
};

/// Adds --device, --threads, --seed, --json, -v and -q to a subcommand.
void add_common_options(CLI::App& command, Common& common);

/// Adds --half-mlp and --cuda-graphs to a subcommand that fits or attacks.
void add_gpu_options(CLI::App& command, Common& common);

/// Applies threads and GPU options and returns the device; throws InputError for one that is not
/// there, and for options of a GPU on a CPU.
at::Device apply_common(const Common& common);

/// `tt3d model check|classify|list`.
void add_model_command(CLI::App& app, Common& common);
/// `tt3d run`, and the single stages `fit`, `mesh`, `attack`, `bake`, `report`.
void add_run_commands(CLI::App& app, Common& common);
/// `tt3d evaluate` and `tt3d render`.
void add_evaluate_commands(CLI::App& app, Common& common);
/// `tt3d export`, `print-check`, `judge` and `video-score`.
void add_tool_commands(CLI::App& app, Common& common);
/// `tt3d info` and `tt3d config`.
void add_info_commands(CLI::App& app, Common& common);

/// A progress display on stderr: one line that renews itself on a terminal, silent elsewhere but
/// for notes; stops long work on Ctrl-C.
[[nodiscard]] std::unique_ptr<Progress> make_progress(const Common& common);

/// Prints an evaluation record (its JSON text) as a table on stdout.
void print_record(const std::string& record_json);

}  // namespace tt3d::cli
