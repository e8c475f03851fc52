#include "tt3d/tool.h"

#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace tt3d {
namespace fs = std::filesystem;

ExchangeFolder::ExchangeFolder() {
  std::string pattern = (fs::temp_directory_path() / "tt3d-XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr) {
    throw ResourceError(pattern +
                        ": cannot create a temporary folder; set TMPDIR to one that can be "
                        "written");
  }
  path_ = pattern;
}

ExchangeFolder::~ExchangeFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

std::string find_python() {
  const char* chosen = std::getenv("TT3D_PYTHON");
  if (chosen != nullptr && *chosen != '\0') return chosen;
  const fs::path own = fs::path(TT3D_SOURCE_TREE) / ".venv/bin/python";
  return fs::exists(own) ? own.string() : "python3";
}

fs::path find_tool(const std::string& name) {
  const fs::path script = fs::path("python/tt3d_tools") / name;
  const fs::path own = TT3D_SOURCE_TREE / script;
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  const fs::path installed = program.parent_path().parent_path() / "share/tt3d" / script;
  for (const fs::path& place : {own, installed}) {
    if (fs::exists(place, error)) return place;
  }
  throw MissingToolError("tt3d needs its tool " + name + ", expected as " + own.string() + " or " +
                         installed.string() + "; install tt3d with 'cmake --install'");
}

std::string last_line(const std::string& text) {
  const size_t end = text.find_last_not_of(" \n");
  if (end == std::string::npos) return "no message";
  const size_t start = text.find_last_of('\n', end);
  return text.substr(start + 1, end - start);
}

namespace {

/// Separates a tool's lines: progress and notes go to Progress, the others are its output.
class Listener {
 public:
  Listener(const std::string& stage, Progress& progress) : stage_(stage), progress_(progress) {}
  void line(const std::string& text) {
    long long done = 0, total = 0;
    if (std::sscanf(text.c_str(), "@progress %lld %lld", &done, &total) == 2) {
      if (!begun_) progress_.begin(stage_, total, 0);
      begun_ = true;
      progress_.update(done, {});
    } else if (text.starts_with("@stage ")) {
      end();
      stage_ = text.substr(7);
    } else if (text.starts_with("@note ")) {
      progress_.note(text.substr(6));
    } else {
      output += text + "\n";
    }
  }
  void end() {
    if (begun_) progress_.end();
    begun_ = false;
  }
  std::string output;

 private:
  std::string stage_;
  Progress& progress_;
  bool begun_ = false;
};

}  // namespace

std::string run_tool(const std::string& name, const std::vector<std::string>& arguments,
                     const std::string& stage, double time_limit_seconds, Progress& progress) {
  std::vector<std::string> command = {find_python(), find_tool(name).string()};
  command.insert(command.end(), arguments.begin(), arguments.end());
  Listener listener(stage, progress);
  ProcessWatch watch;
  watch.on_line = [&](const std::string& line) { listener.line(line); };
  watch.stop = [&] { return progress.cancelled(); };
  const ProcessResult result = watch_process(command, time_limit_seconds, watch);
  listener.end();
  progress.check();
  if (result.timed_out) {
    throw ResourceError(stage + " took longer than " +
                        std::to_string(std::lround(time_limit_seconds)) + " s and was ended");
  }
  const std::string message = last_line(listener.output);
  switch (result.exit_code) {
    case 0:
      return listener.output;
    case 2:
      throw InputError(message);
    case 3:
      throw MissingToolError(message);
    default:
      throw ResourceError(stage + " failed (exit code " + std::to_string(result.exit_code) +
                          "): " + message);
  }
}

}  // namespace tt3d
