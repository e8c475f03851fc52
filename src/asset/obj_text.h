#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// The text of OBJ and MTL files: lines, words, numbers and names.
namespace tt3d::asset {

/// Iterates over the words of one line.
class Words {
 public:
  explicit Words(std::string_view line) : rest_(line) {}
  /// The next word, empty at the end.
  std::string_view next();
  /// The next word in lower case, for keywords.
  std::string keyword();
  /// The remaining text, without blanks at either end.
  [[nodiscard]] std::string_view rest() const;
  /// The next word as a finite number, else nullopt. Numbers too small for a double are 0.
  std::optional<double> number();

 private:
  std::string_view rest_;
};

/// Iterates over the lines of a text and joins lines that end in a backslash. Lines end in LF, CR
/// LF or CR.
class Lines {
 public:
  /// Skips the byte order mark of UTF-8.
  explicit Lines(std::string_view text);
  bool next(std::string& line);
  /// Number of the last line that was read, counting from 1.
  [[nodiscard]] long number() const { return number_; }

 private:
  std::string_view take_line();
  std::string_view rest_;
  long number_ = 0;
};

/// The text before a comment: `#` starts one at the beginning of a line or after a blank.
[[nodiscard]] std::string_view without_comment(std::string_view text);
/// A name without its comment, surrounding blanks and double quotes.
[[nodiscard]] std::string plain_name(std::string_view text);
/// The text split at blanks; text in double quotes is one part, without the quotes.
[[nodiscard]] std::vector<std::string> split_names(std::string_view text);
/// True if the text is UTF-16, which OBJ and MTL readers do not expect.
[[nodiscard]] bool is_utf16(std::string_view text);

}  // namespace tt3d::asset
