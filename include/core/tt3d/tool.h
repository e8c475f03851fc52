#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "tt3d/core.h"

/// The tools in Python that the program runs as child processes (python/tt3d_tools).
namespace tt3d {

/// A folder under the system's temporary one, removed with all it holds at the end of the scope.
class ExchangeFolder {
 public:
  /// Throws ResourceError where none can be made.
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

/// What is done while a child runs; both may be empty.
struct ProcessWatch {
  std::function<void(const std::string&)> on_line;  ///< each line it prints, as it comes
  std::function<bool()> stop;  ///< asked once a second; true ends the child, as at the time limit
};

/// run_process with a watch. The child gets a process group, so that what it started ends with it.
[[nodiscard]] ProcessResult watch_process(const std::vector<std::string>& command,
                                          double time_limit_seconds, const ProcessWatch& watch);

/// The Python interpreter of the tools: $TT3D_PYTHON, else that of the source tree's .venv, else
/// python3.
[[nodiscard]] std::string find_python();

/// A file of python/tt3d_tools: in the source tree, or where 'cmake --install' put it beside the
/// running program. Throws MissingToolError.
[[nodiscard]] std::filesystem::path find_tool(const std::string& name);

/// The last line of a text that is not empty, or "no message".
[[nodiscard]] std::string last_line(const std::string& text);

/// Runs `name` of tt3d_tools with arguments. Its lines "@progress DONE TOTAL" go to `progress` as
/// `stage`, "@note TEXT" as notes; all other lines are returned. The tool's last line is the
/// message where it fails: status 2 throws InputError, 3 MissingToolError, anything else
/// ResourceError, as does the time limit in seconds. Ctrl-C ends the tool and throws Interrupted.
std::string run_tool(const std::string& name, const std::vector<std::string>& arguments,
                     const std::string& stage, double time_limit_seconds, Progress& progress);

}  // namespace tt3d
