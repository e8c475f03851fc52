#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "tt3d/core.h"

namespace tt3d {

/// Parses a JSON file; errors name file and line.
[[nodiscard]] nlohmann::json read_json_file(const std::filesystem::path& path);

/// The member `key` as a finite number, or `fallback` where it is absent; throws InputError
/// starting with `where` if it is something else.
[[nodiscard]] double json_number(const nlohmann::json& object, const char* key, double fallback,
                                 const std::string& where);

/// The member `key` as a text, or "" where it is absent.
[[nodiscard]] std::string json_text(const nlohmann::json& object, const char* key,
                                    const std::string& where);

}  // namespace tt3d
