#include "tt3d/core.h"
#include "tt3d/input_files.h"
#include "tt3d/record.h"

namespace tt3d::record {
namespace fs = std::filesystem;

std::vector<std::string> RunRecord::surrogates() const {
  std::vector<std::string> names;
  const auto found = config.find("attack.surrogates");
  if (found == config.end() || !found->second.is_array()) return names;
  for (const auto& model : found->second) {
    if (model.is_string()) names.push_back(fs::path(model.get<std::string>()).stem().string());
  }
  return names;
}

Records load_records(const fs::path& folder, const std::string& without) {
  Records records;
  for (const fs::path& path : list_files(folder, {".json"})) {
    if (path.filename() == without) continue;
    const auto document = nlohmann::json::parse(read_file(path), nullptr, false);
    if (!document.is_object()) continue;
    const JsonValue value(document, path);
    if (value.has("victims") && value.has("renderer")) {
      records.evaluations.push_back(load_evaluation(path));
    } else if (value.has("task") && value.has("shares")) {
      records.judges.push_back(value.as<JudgeRecord>());
    } else if (value.has("victims") && value.has("video")) {
      records.videos.emplace_back(path, value.as<VideoRecord>());
    }
  }
  return records;
}

}  // namespace tt3d::record
