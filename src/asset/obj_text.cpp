#include "obj_text.h"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace tt3d::asset {
namespace {

constexpr std::string_view kBlanks = " \t";

std::string_view trimmed(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(kBlanks), text.size()));
  return text.substr(0, text.find_last_not_of(kBlanks) + 1);
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// True if the absolute value of a decimal number is below 1, judged by its digits: from_chars
/// reports "out of range" for numbers too small and too large alike.
bool is_below_one(std::string_view digits) {
  const size_t mark = std::min(digits.find_first_of("eE"), digits.size());
  const std::string_view mantissa = digits.substr(0, mark);
  const size_t first = mantissa.find_first_of("123456789");
  if (first == std::string_view::npos) return true;
  const size_t point = std::min(mantissa.find('.'), mantissa.size());
  const auto lead = static_cast<double>(point) - static_cast<double>(first);
  double exponent = 0;
  for (const char c : digits.substr(std::min(mark + 1, digits.size()))) {
    if (is_digit(c)) exponent = 10 * exponent + (c - '0');
  }
  const bool negative = mark + 1 < digits.size() && digits[mark + 1] == '-';
  return lead + (negative ? -exponent : exponent) <= 0;
}

}  // namespace

std::string_view Words::next() {
  rest_.remove_prefix(std::min(rest_.find_first_not_of(kBlanks), rest_.size()));
  const size_t end = std::min(rest_.find_first_of(kBlanks), rest_.size());
  const std::string_view word = rest_.substr(0, end);
  rest_.remove_prefix(end);
  return word;
}

std::string Words::keyword() {
  std::string word(next());
  for (char& c : word) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return word;
}

std::string_view Words::rest() const { return trimmed(rest_); }

std::optional<double> Words::number() {
  std::string_view word = next();
  if (word.starts_with('+')) word.remove_prefix(1);
  double value = 0;
  const auto result = std::from_chars(word.data(), word.data() + word.size(), value);
  if (word.empty() || result.ptr != word.data() + word.size()) return std::nullopt;
  if (result.ec == std::errc::result_out_of_range) {
    return is_below_one(word) ? std::optional(0.0) : std::nullopt;
  }
  if (result.ec != std::errc() || !std::isfinite(value)) return std::nullopt;
  return value;
}

Lines::Lines(std::string_view text) : rest_(text) {
  if (rest_.starts_with("\xEF\xBB\xBF")) rest_.remove_prefix(3);
}

std::string_view Lines::take_line() {
  const size_t end = std::min(rest_.find_first_of("\r\n"), rest_.size());
  const std::string_view line = rest_.substr(0, end);
  const bool pair = rest_.substr(end).starts_with("\r\n");
  rest_.remove_prefix(std::min(end + (pair ? 2 : 1), rest_.size()));
  ++number_;
  return line;
}

bool Lines::next(std::string& line) {
  line.clear();
  if (rest_.empty()) return false;
  bool more = true;
  while (more && !rest_.empty()) {
    const std::string_view part = take_line();
    line += part;
    // A backslash at the end of a comment, such as a Windows path, joins nothing.
    more = part.ends_with('\\') && without_comment(part).size() == part.size();
    if (more) line.back() = ' ';
  }
  return true;
}

std::string_view without_comment(std::string_view text) {
  for (size_t i = text.find('#'); i != std::string_view::npos; i = text.find('#', i + 1)) {
    if (i == 0 || kBlanks.find(text[i - 1]) != std::string_view::npos) return text.substr(0, i);
  }
  return text;
}

std::string plain_name(std::string_view text) {
  text = trimmed(without_comment(text));
  if (text.size() >= 2 && text.front() == '"' && text.back() == '"') {
    text = text.substr(1, text.size() - 2);
  }
  return std::string(text);
}

std::vector<std::string> split_names(std::string_view text) {
  std::vector<std::string> names;
  for (text = trimmed(text); !text.empty(); text = trimmed(text)) {
    const bool quoted = text.front() == '"';
    if (quoted) text.remove_prefix(1);
    const size_t end = std::min(text.find_first_of(quoted ? "\"" : kBlanks), text.size());
    names.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(end + (quoted ? 1 : 0), text.size()));
  }
  return names;
}

bool is_utf16(std::string_view text) {
  return text.starts_with("\xFF\xFE") || text.starts_with("\xFE\xFF");
}

}  // namespace tt3d::asset
