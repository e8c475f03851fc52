#include "tt3d/csv.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "tt3d/core.h"

namespace tt3d {
namespace {

/// Reads rows of cells; a quoted cell may span lines.
class CsvParser {
 public:
  CsvParser(const std::string& text, std::filesystem::path path)
      : text_(text), path_(std::move(path)) {
    if (text_.starts_with("\xEF\xBB\xBF")) at_ = 3;
  }

  /// The next row that is neither blank nor a comment; false at the end.
  bool next(std::vector<std::string>& cells, long& line) {
    while (at_ < text_.size()) {
      line = line_;
      if (text_[at_] == '#') {
        skip_line();
        continue;
      }
      cells = row();
      if (cells.size() > 1 || !cells[0].empty()) return true;
    }
    return false;
  }

 private:
  void skip_line() {
    at_ = std::min(text_.size(), text_.find('\n', at_));
    if (at_ < text_.size()) ++at_;
    ++line_;
  }

  std::vector<std::string> row() {
    const long first = line_;
    std::vector<std::string> cells(1);
    bool quoted = false;
    for (; at_ < text_.size(); ++at_) {
      const char c = text_[at_];
      if (c == '\n') ++line_;
      if (quoted) {
        if (c != '"')
          cells.back() += c;
        else if (at_ + 1 < text_.size() && text_[at_ + 1] == '"')
          cells.back() += text_[++at_];
        else
          quoted = false;
      } else if (c == '"') {
        quoted = true;
      } else if (c == ',') {
        cells.emplace_back();
      } else if (c == '\n') {
        ++at_;
        return cells;
      } else if (c != '\r') {
        cells.back() += c;
      }
    }
    if (quoted) throw InputError(path_, first, "a quote is not closed");
    return cells;
  }

  const std::string& text_;
  std::filesystem::path path_;
  size_t at_ = 0;
  long line_ = 1;
};

/// Parses the whole cell as a T, without the blanks around it.
template <typename T>
bool parse_number(std::string_view cell, T& value) {
  while (cell.starts_with(' ')) cell.remove_prefix(1);
  while (cell.ends_with(' ')) cell.remove_suffix(1);
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  return error == std::errc() && end == cell.data() + cell.size();
}

bool is_number(const std::string& cell) {
  double value = 0;
  return parse_number(cell, value);
}

}  // namespace

CsvTable parse_csv(const std::string& text, const std::filesystem::path& path,
                   const std::vector<std::string>& names) {
  CsvTable table{path, names, {}, {}};
  CsvParser parser(text, path);
  long line = 0;
  std::vector<std::string> cells;
  if (!parser.next(cells, line)) {
    throw InputError(path, names.empty() ? "is empty, expected a header line" : "has no rows");
  }
  const bool headed = names.empty() || !is_number(cells[0]);
  if (names.empty()) table.names = cells;
  for (bool more = headed ? parser.next(cells, line) : true; more;
       more = parser.next(cells, line)) {
    if (cells.size() != table.names.size()) {
      throw InputError(path, line,
                       "has " + std::to_string(cells.size()) + " cells, expected " +
                           std::to_string(table.names.size()) + " as in the header");
    }
    table.rows.push_back(cells);
    table.lines.push_back(line);
  }
  return table;
}

CsvTable read_csv(const std::filesystem::path& path) { return parse_csv(read_file(path), path); }

bool CsvTable::has(const std::string& name) const {
  return std::find(names.begin(), names.end(), name) != names.end();
}

size_t CsvTable::column(const std::string& name) const {
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) throw InputError(path, "has no column '" + name + "'");
  return static_cast<size_t>(found - names.begin());
}

double CsvTable::number(size_t row, size_t column) const {
  const std::string& cell = rows[row][column];
  double value = 0;
  if (!parse_number(cell, value)) {
    throw InputError(path, lines[row], names[column] + ": expected a number, got '" + cell + "'");
  }
  return value;
}

int64_t CsvTable::integer(size_t row, size_t column) const {
  const std::string& cell = rows[row][column];
  int64_t value = 0;
  if (!parse_number(cell, value)) {
    throw InputError(path, lines[row], names[column] + ": expected an integer, got '" + cell + "'");
  }
  return value;
}

std::string csv_line(const std::vector<std::string>& cells) {
  std::string line;
  for (size_t i = 0; i < cells.size(); ++i) {
    if (i > 0) line += ',';
    // A line that starts with '#' would be a comment.
    if (cells[i].find_first_of(",\"\r\n") == std::string::npos && !cells[i].starts_with('#')) {
      line += cells[i];
      continue;
    }
    line += '"';
    for (const char c : cells[i]) line += c == '"' ? std::string("\"\"") : std::string(1, c);
    line += '"';
  }
  return line + "\n";
}

}  // namespace tt3d
