#include "json_file.h"

#include <algorithm>
#include <cmath>

namespace tt3d {

nlohmann::json read_json_file(const std::filesystem::path& path) {
  const std::string text = read_file(path);
  if (text.empty()) throw InputError(path, "the file is empty, expected JSON");
  try {
    return nlohmann::json::parse(text);
  } catch (const nlohmann::json::parse_error& error) {
    const size_t end = std::min(text.size(), error.byte);
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<long>(end), '\n');
    throw InputError(path, line, "is not valid JSON (NaN and Infinity are not numbers in JSON)");
  } catch (const nlohmann::json::exception&) {
    throw InputError(path, "holds a number that is out of range");
  }
}

double json_number(const nlohmann::json& object, const char* key, double fallback,
                   const std::string& where) {
  const auto found = object.find(key);
  if (found == object.end() || found->is_null()) return fallback;
  if (!found->is_number() || !std::isfinite(found->get<double>())) {
    throw InputError(where + "." + key + ": expected a finite number");
  }
  return found->get<double>();
}

std::string json_text(const nlohmann::json& object, const char* key, const std::string& where) {
  const auto found = object.find(key);
  if (found == object.end() || found->is_null()) return {};
  if (!found->is_string()) throw InputError(where + "." + key + ": expected a text");
  return found->get<std::string>();
}

}  // namespace tt3d
