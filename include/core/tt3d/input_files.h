#pragma once

#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

/// Files as users have them: extensions in upper case, hidden files, byte order marks, and paths
/// written on Windows.
namespace tt3d {

/// True if the path ends in one of these extensions, in upper or lower case. `extensions` are in
/// lower case and include the dot: ".png".
[[nodiscard]] bool has_extension(const std::filesystem::path& path,
                                 std::initializer_list<std::string_view> extensions);

/// True for names that begin with a dot, such as .DS_Store, and ._a.jpg, which macOS writes beside
/// a.jpg on foreign disks.
[[nodiscard]] bool is_hidden(const std::filesystem::path& path);

/// The regular files of a folder with one of the extensions, sorted by name, without hidden files.
/// Throws InputError if the folder cannot be read.
[[nodiscard]] std::vector<std::filesystem::path> list_files(
    const std::filesystem::path& folder, std::initializer_list<std::string_view> extensions);

/// A text file without the byte order mark that some editors write at its start. Throws InputError
/// if the file cannot be read or is UTF-16.
[[nodiscard]] std::string read_text(const std::filesystem::path& path);

/// The path with '/' in place of the '\' of Windows.
[[nodiscard]] std::string with_forward_slashes(std::string path);

/// ASCII letters in lower case.
[[nodiscard]] std::string lower_case(std::string text);

}  // namespace tt3d
