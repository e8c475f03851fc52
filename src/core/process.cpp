#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <thread>

#include "tt3d/core.h"
#include "tt3d/tool.h"

extern char** environ;

namespace tt3d {
namespace {

/// Closes its descriptor at the end of the scope.
struct Descriptor {
  int fd = -1;
  ~Descriptor() {
    if (fd >= 0) ::close(fd);
  }
};

/// Passes the complete lines of `output` from `begin` on to the callback.
void pass_lines(const std::string& output, size_t& begin, const ProcessWatch& watch) {
  if (!watch.on_line) return;
  for (size_t end; (end = output.find('\n', begin)) != std::string::npos; begin = end + 1) {
    watch.on_line(output.substr(begin, end - begin));
  }
}

/// Reads the child's output until the child closes it or the deadline passes.
bool drain(int fd, double deadline, std::string& output, const ProcessWatch& watch) {
  char buffer[4096];
  size_t passed = 0;
  while (true) {
    pass_lines(output, passed, watch);
    const double left = deadline - now_seconds();
    if (left <= 0 || (watch.stop && watch.stop())) return false;
    pollfd poll_fd{fd, POLLIN, 0};
    if (::poll(&poll_fd, 1, static_cast<int>(std::min(left, 1.0) * 1000) + 1) <= 0) continue;
    const ssize_t n = ::read(fd, buffer, sizeof buffer);
    if (n == 0 || (n < 0 && errno != EINTR)) {
      if (passed < output.size() && watch.on_line) watch.on_line(output.substr(passed));
      return true;
    }
    if (n > 0) output.append(buffer, static_cast<size_t>(n));
  }
}

/// Waits for the child's end; false if the deadline passes first. A child may close its output and
/// still hang, so end of output does not mean end of process.
bool ended(pid_t pid, double deadline, int& status, const ProcessWatch& watch) {
  constexpr auto kPause = std::chrono::milliseconds(5);
  for (double asked = now_seconds(); ::waitpid(pid, &status, WNOHANG) == 0;) {
    const double now = now_seconds();
    if (now > deadline) return false;
    if (watch.stop && now - asked > 1) {
      if (watch.stop()) return false;
      asked = now;
    }
    std::this_thread::sleep_for(kPause);
  }
  return true;
}

pid_t spawn(const std::vector<std::string>& command, int output_fd) {
  std::vector<char*> argv;
  argv.reserve(command.size() + 1);
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, output_fd, 1);
  posix_spawn_file_actions_adddup2(&actions, output_fd, 2);
  // A process group of its own, so that the child's own children end with it.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  pid_t pid = 0;
  const int error = posix_spawnp(&pid, argv[0], &actions, &attributes, argv.data(), environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) {
    throw MissingToolError(command.front() + ": cannot start: " + std::strerror(error) +
                           "; run scripts/setup");
  }
  return pid;
}

}  // namespace

ProcessResult watch_process(const std::vector<std::string>& command, double time_limit_seconds,
                            const ProcessWatch& watch) {
  int pipe_fds[2];
  if (::pipe2(pipe_fds, O_CLOEXEC) != 0) throw ResourceError("cannot open a pipe");
  Descriptor reader{pipe_fds[0]};
  Descriptor writer{pipe_fds[1]};
  const pid_t pid = spawn(command, writer.fd);
  ::close(writer.fd);
  writer.fd = -1;

  ProcessResult result;
  const double deadline = now_seconds() + time_limit_seconds;
  int status = 0;
  result.timed_out =
      !drain(reader.fd, deadline, result.output, watch) || !ended(pid, deadline, status, watch);
  if (result.timed_out) {
    ::kill(-pid, SIGKILL);
    while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
    }
  }
  result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return result;
}

ProcessResult run_process(const std::vector<std::string>& command, double time_limit_seconds) {
  return watch_process(command, time_limit_seconds, {});
}

double now_seconds() noexcept {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace tt3d
