#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tt3d/core.h"
#include "tt3d/csv.h"
#include "tt3d/record.h"

namespace tt3d::record {
namespace fs = std::filesystem;

void to_json(nlohmann::json& to, const Interval& interval) {
  to = nlohmann::json::array({interval.low, interval.high});
}

void read(const JsonValue& from, Interval& to) {
  const auto ends = from.as<std::array<double, 2>>();
  to = {ends[0], ends[1]};
}

Interval wilson_interval(int64_t successes, int64_t n) {
  if (n == 0) return {0, 1};
  constexpr double z = 1.959963984540054;
  const auto count = static_cast<double>(n);
  const double p = static_cast<double>(successes) / count;
  const double denominator = 1 + z * z / count;
  const double middle = (p + z * z / (2 * count)) / denominator;
  const double half =
      z * std::sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / denominator;
  return {std::max(0.0, middle - half), std::min(1.0, middle + half)};
}

void summarize(VictimRecord& v, int64_t target, std::optional<int64_t> true_class) {
  const auto n = static_cast<int64_t>(v.answers.size());
  int64_t hits = 0, with_clean = 0, correct = 0, hits_on_correct = 0;
  double probability = 0;
  for (const ViewAnswer& a : v.answers) {
    const bool hit = a.top1 == target;
    hits += hit;
    probability += a.p_target;
    with_clean += a.clean_top1.has_value();
    if (true_class && a.clean_top1 == true_class) {
      ++correct;
      hits_on_correct += hit;
    }
  }
  v.asr = static_cast<double>(hits) / static_cast<double>(n);
  v.asr_ci95 = wilson_interval(hits, n);
  v.mean_target_probability = probability / static_cast<double>(n);
  if (!true_class || with_clean == 0) return;
  v.clean_n = n;
  v.clean_accuracy = static_cast<double>(correct) / static_cast<double>(n);
  v.asr_on_correct_n = correct;
  if (correct > 0) {
    v.asr_on_correct = static_cast<double>(hits_on_correct) / static_cast<double>(correct);
  }
}

// ---- The CSV file -------------------------------------------------------------------------

namespace {

const std::vector<std::string> kHeader = {
    "victim",     "view",      "azimuth_deg", "elevation_deg", "distance", "roll_deg",
    "top1_index", "top1_name", "p_top1",      "p_target",      "p_true",   "clean_top1_index"};

std::string views_csv(const EvaluationRecord& r) {
  std::string text = csv_line(kHeader);
  for (const VictimRecord& v : r.victims) {
    for (size_t i = 0; i < v.answers.size(); ++i) {
      const ViewPose& pose = r.poses[i];
      const ViewAnswer& a = v.answers[i];
      text +=
          csv_line({v.name, std::to_string(i), fmt::format("{:.4f}", pose.azimuth_deg),
                    fmt::format("{:.4f}", pose.elevation_deg), fmt::format("{:.6g}", pose.distance),
                    fmt::format("{:.4f}", pose.roll_deg), std::to_string(a.top1), a.top1_name,
                    fmt::format("{:.6f}", a.p_top1), fmt::format("{:.6f}", a.p_target),
                    a.p_true ? fmt::format("{:.6f}", *a.p_true) : "",
                    a.clean_top1 ? std::to_string(*a.clean_top1) : ""});
    }
  }
  return text;
}

VictimRecord& victim_named(EvaluationRecord& record, const std::string& name, const CsvTable& csv,
                           size_t row) {
  for (VictimRecord& v : record.victims) {
    if (v.name == name) return v;
  }
  throw InputError(csv.path, csv.lines[row], "victim '" + name + "' is not in the record");
}

void read_rows(const CsvTable& csv, EvaluationRecord& record) {
  std::vector<size_t> at;
  for (const std::string& name : kHeader) at.push_back(csv.column(name));
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    const std::vector<std::string>& cells = csv.rows[row];
    VictimRecord& victim = victim_named(record, cells[at[0]], csv, row);
    const auto view = static_cast<size_t>(csv.integer(row, at[1]));
    if (view != victim.answers.size()) {
      throw InputError(csv.path, csv.lines[row],
                       "expected view " + std::to_string(victim.answers.size()));
    }
    ViewAnswer a;
    a.top1 = csv.integer(row, at[6]);
    a.top1_name = cells[at[7]];
    a.p_top1 = csv.number(row, at[8]);
    a.p_target = csv.number(row, at[9]);
    if (!cells[at[10]].empty()) a.p_true = csv.number(row, at[10]);
    if (!cells[at[11]].empty()) a.clean_top1 = csv.integer(row, at[11]);
    victim.answers.push_back(a);
    if (view == record.poses.size()) {
      record.poses.push_back({csv.number(row, at[2]), csv.number(row, at[3]),
                              csv.number(row, at[4]), csv.number(row, at[5])});
    }
  }
}

}  // namespace

void save(const EvaluationRecord& record, const fs::path& json_path) {
  fs::path csv_path = json_path;
  write_file_atomic(csv_path.replace_extension(".csv"), views_csv(record));
  write_json(json_path, tt3d::to_json(record));
}

EvaluationRecord load_evaluation(const fs::path& json_path) {
  auto record = read_json_as<EvaluationRecord>(json_path);
  fs::path csv_path = json_path;
  csv_path.replace_extension(".csv");
  if (fs::exists(csv_path)) read_rows(read_csv(csv_path), record);
  return record;
}

}  // namespace tt3d::record
