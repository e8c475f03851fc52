#include <ATen/Context.h>
#include <ATen/Parallel.h>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <new>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "commands.h"
#include "tt3d/core.h"
#include "tt3d/device.h"
#include "tt3d/version.h"

namespace tt3d::cli {

void add_common_options(CLI::App& command, Common& common) {
  command.add_option("--device", common.device, "auto, cpu or cuda")
      ->check(CLI::IsMember({"auto", "cpu", "cuda"}))
      ->capture_default_str();
  command.add_option("--threads", common.threads, "number of threads; 0: all cores")
      ->check(CLI::NonNegativeNumber);
  command.add_option("--seed", common.seed, "seed of all random streams")->capture_default_str();
  command.add_flag("--json", common.json, "print results as JSON on stdout");
  command.add_flag_callback(
      "-v", [&common] { ++common.verbosity; },
      "print progress lines also if stderr is not a terminal");
  command.add_flag_callback(
      "-q", [&common] { common.verbosity = -1; }, "print no progress and no notes");
}

void add_gpu_options(CLI::App& command, Common& common) {
  command.add_flag("--half-mlp", common.gpu.half_mlp,
                   "with CUDA: run the MLPs of the field on tensor cores, with float16 operands");
  command.add_flag(
      "--cuda-graphs", common.gpu.graphs,
      "with CUDA: record the passes of the classifiers once as CUDA graphs and replay them");
}

at::Device apply_common(const Common& common) {
  if (common.threads > 0) at::set_num_threads(common.threads);
  const at::Device device = device_named(common.device);
  for (const auto& [asked, name] : {std::pair{common.gpu.half_mlp, "--half-mlp"},
                                    std::pair{common.gpu.graphs, "--cuda-graphs"}}) {
    if (asked && !device.is_cuda()) {
      throw InputError(std::string(name) +
                       " needs a GPU, and this run is on the CPU; remove it or add --device cuda");
    }
  }
  use_gpu_options(common.gpu);
  return device;
}

namespace {

int run_program(int argc, char** argv) {
  CLI::App app{"Turns photographs of an object into an adversarial 3D object and measures it.",
               "tt3d"};
  app.set_version_flag("--version", kVersion);
  app.require_subcommand(1);
  app.fallthrough(false);
  Common common;
  add_photos_command(app, common);
  add_run_commands(app, common);
  add_evaluate_commands(app, common);
  add_tool_commands(app, common);
  add_model_command(app, common);
  add_info_commands(app, common);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const int code = app.exit(error);
    return code == 0 ? 0 : 2;
  }
  return 0;
}

/// Prints one line and returns the exit code.
int report_error(const std::string& line, int code) {
  std::cerr << "\ntt3d: " << line << "\n";
  return code;
}

/// Number of running threads of other processes: the minimum of a few samples, so that short-lived
/// daemons do not count. (The load average still includes a build that has ended.)
int running_elsewhere() {
  int fewest = std::numeric_limits<int>::max();
  for (int look = 0; look < 5; ++look) {
    std::ifstream file("/proc/loadavg");
    std::string load;
    int running = 1;
    file >> load >> load >> load >> running;
    fewest = std::min(fewest, running - 1);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return fewest;
}

/// Makes idle OpenMP threads sleep if the machine is busy. Spinning threads slow down other
/// programs; on an idle machine, sleeping threads make an attack step 1.8 times slower. libgomp
/// reads its environment before main, so the program starts itself again. A policy set by the user
/// is kept.
void sleep_when_busy(char** argv) {
  if (std::getenv("OMP_WAIT_POLICY") != nullptr) return;
  const auto cores = static_cast<int>(std::thread::hardware_concurrency());
  if (running_elsewhere() < std::max(1, cores / 2)) return;
  ::setenv("OMP_WAIT_POLICY", "PASSIVE", 1);
  std::error_code unknown;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", unknown);
  if (!unknown) ::execv(self.c_str(), argv);  // returns only on failure; then the threads spin
}

}  // namespace
}  // namespace tt3d::cli

int main(int argc, char** argv) {
  tt3d::cli::sleep_when_busy(argv);
  try {
    return tt3d::cli::run_program(argc, argv);
  } catch (const tt3d::Error& error) {
    return tt3d::cli::report_error(error.what(), error.exit_code());
  } catch (const std::bad_alloc&) {
    return tt3d::cli::report_error("out of memory; lower the batch or the resolution", 5);
  } catch (const c10::OutOfMemoryError&) {
    return tt3d::cli::report_error(
        "out of memory on the device; lower field.samples_per_step, mesh.views_per_step or "
        "attack.views_per_step",
        5);
  } catch (const std::exception& error) {
    // Print the first line only, because torch appends a stack trace.
    const std::string text = error.what();
    const bool memory = text.find("DefaultCPUAllocator") != std::string::npos;
    return tt3d::cli::report_error(text.substr(0, text.find('\n')), memory ? 5 : 1);
  }
}
