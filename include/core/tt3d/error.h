#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>

/// Every failure that a user can cause is one of these types. Its message is one line that names
/// the file, the line or key, what was expected and what to do. The program maps the types to exit
/// codes.
namespace tt3d {

/// Base of all tt3d errors.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
  /// Exit code of the program (docs/architecture.md).
  [[nodiscard]] virtual int exit_code() const noexcept { return 1; }
};

/// Wrong input or usage: a file, a key, a value. Exit code 2.
class InputError : public Error {
 public:
  using Error::Error;
  /// "FILE: message".
  InputError(const std::filesystem::path& file, const std::string& message)
      : Error(file.string() + ": " + message) {}
  /// "FILE:LINE: message"; lines count from 1.
  InputError(const std::filesystem::path& file, long line, const std::string& message)
      : Error(file.string() + ":" + std::to_string(line) + ": " + message) {}
  [[nodiscard]] int exit_code() const noexcept override { return 2; }
};

/// A program or package that a command needs is absent; the message holds the install command.
/// Exit code 3.
class MissingToolError : public Error {
 public:
  using Error::Error;
  [[nodiscard]] int exit_code() const noexcept override { return 3; }
};

/// An optimisation diverged and going back to an earlier state did not help. Exit code 4.
class NumericError : public Error {
 public:
  using Error::Error;
  [[nodiscard]] int exit_code() const noexcept override { return 4; }
};

/// Out of memory, disk or another limit, or a folder that cannot be written. Exit code 5.
class ResourceError : public Error {
 public:
  using Error::Error;
  [[nodiscard]] int exit_code() const noexcept override { return 5; }
};

/// The user asked to stop. Work that was checkpointed can be resumed. Exit code 130.
class Interrupted : public Error {
 public:
  Interrupted() : Error("interrupted; run the same command again to go on") {}
  [[nodiscard]] int exit_code() const noexcept override { return 130; }
};

}  // namespace tt3d
