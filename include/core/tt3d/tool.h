#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "tt3d/core.h"

/// The Python tools (python/tt3d_tools), which the program runs as child processes.
namespace tt3d {

/// A temporary folder, removed with its contents at the end of the scope.
class ExchangeFolder {
 public:
  /// Throws ResourceError if it cannot be made.
  ExchangeFolder();
  ~ExchangeFolder();
  ExchangeFolder(const ExchangeFolder&) = delete;
  ExchangeFolder& operator=(const ExchangeFolder&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const {
    return path_ / name;
  }

 private:
  std::filesystem::path path_;
};

/// Callbacks while a child runs; both may be empty.
struct ProcessWatch {
  std::function<void(const std::string&)> on_line;  ///< called with each line of output
  std::function<bool()> stop;  ///< called once a second; true ends the child, like the time limit
};

/// run_process with callbacks. The child gets a process group, so that its own children end with
/// it.
[[nodiscard]] ProcessResult watch_process(const std::vector<std::string>& command,
                                          double time_limit_seconds, const ProcessWatch& watch);

/// The Python interpreter of the tools: $TT3D_PYTHON, else the one in the source tree's .venv, else
/// python3.
[[nodiscard]] std::string find_python();

/// A file of python/tt3d_tools: in the source tree, or in the place next to the running program
/// where 'cmake --install' puts it. Throws MissingToolError.
[[nodiscard]] std::filesystem::path find_tool(const std::string& name);

/// The last non-empty line of a text, or "no message".
[[nodiscard]] std::string last_line(const std::string& text);

/// Runs `name` of tt3d_tools with arguments. Its lines "@progress DONE TOTAL" go to `progress` as
/// `stage`, or as the stage that a line "@stage NAME" begins; "@note TEXT" goes there as a note.
/// All other lines are returned. If the tool fails, its last line is the message: status 2 throws
/// InputError, 3 MissingToolError, anything else ResourceError. The time limit (seconds) throws
/// ResourceError too. Ctrl-C ends the tool and throws Interrupted.
std::string run_tool(const std::string& name, const std::vector<std::string>& arguments,
                     const std::string& stage, double time_limit_seconds, Progress& progress);

}  // namespace tt3d
