#pragma once

#include <filesystem>
#include <string>
#include <vector>

/// Comma-separated values (RFC 4180): a header line, then one row per line. Cells with commas,
/// quotes or line ends are quoted.
namespace tt3d {

/// The content of a CSV file.
struct CsvTable {
  std::filesystem::path path;  ///< the file, for messages
  std::vector<std::string> names;
  std::vector<std::vector<std::string>> rows;  ///< each has as many cells as names
  std::vector<long> lines;                     ///< first line of each row in the file, from 1

  /// The index of a column; throws InputError if there is none with this name.
  [[nodiscard]] size_t column(const std::string& name) const;
  /// True if there is a column with this name.
  [[nodiscard]] bool has(const std::string& name) const;
  /// A cell as a number, blanks around it ignored. Throws InputError with file, line and column if
  /// it is not a number.
  [[nodiscard]] double number(size_t row, size_t column) const;
  [[nodiscard]] int64_t integer(size_t row, size_t column) const;
};

/// Parses a table; `path` is used in errors. A byte order mark, blank lines and lines that start
/// with '#' are skipped. Throws InputError for a row whose number of cells differs from the
/// header's. `names`: the names of the columns, for a file whose header line may be missing. The
/// first row is then a header if its first cell is not a number.
[[nodiscard]] CsvTable parse_csv(const std::string& text, const std::filesystem::path& path,
                                 const std::vector<std::string>& names = {});
/// Reads and parses a file.
[[nodiscard]] CsvTable read_csv(const std::filesystem::path& path);

/// Writes one row: cells with quotes if needed, and a newline at the end.
[[nodiscard]] std::string csv_line(const std::vector<std::string>& cells);

}  // namespace tt3d
