#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <string>

/// The subcommands of the program. Each function registers one with a callback that does the
/// work; errors leave as tt3d::Error and main() turns them into a line and an exit code.
namespace tt3d::cli {

/// Options that every subcommand takes.
struct Common {
  std::string device = "auto";  ///< auto, cpu or cuda
  int threads = 0;              ///< 0: all
  uint64_t seed = 0;
  bool json = false;  ///< print results as JSON on stdout
  int verbosity = 0;
};

/// `tt3d model check|classify|list`.
void add_model_command(CLI::App& app, Common& common);

}  // namespace tt3d::cli
