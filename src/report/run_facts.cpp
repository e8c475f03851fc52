#include "run_facts.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <algorithm>
#include <filesystem>

#include "tt3d/version.h"

namespace tt3d::report {
namespace {

Json first_present(const Json& json, const std::vector<std::string>& keys) {
  for (const std::string& key : keys) {
    if (Json value = member(json, key); !value.is_null()) return value;
  }
  return nullptr;
}

/// attack.surrogates in run.json: keys are nested or dotted, below the configuration or on top; the
/// value is a list or the text of one.
Json surrogates_in_run(const Json& run) {
  for (const Json& config : {first_present(run, {"config", "effective_config"}), run}) {
    Json found = member(config, "attack.surrogates");
    if (found.is_null()) found = member(member(config, "attack"), "surrogates");
    if (found.is_string()) found = Json::parse(found.get<std::string>(), nullptr, false);
    if (found.is_array()) return found;
  }
  return nullptr;
}

std::vector<std::string> surrogates_in_toml(const std::string& text) {
  std::vector<std::string> names;
  try {
    const toml::table table = toml::parse(text);
    if (const toml::array* array = table["attack"]["surrogates"].as_array()) {
      for (const toml::node& node : *array) names.push_back(node.value_or(std::string()));
    }
  } catch (const toml::parse_error&) {
    // The text is shown as it is; without it every model counts as unseen.
  }
  return names;
}

std::string value_text(const Json& value) {
  return value.is_string() ? value.get<std::string>() : value.dump();
}

std::string fact_rows(const std::string& prefix, const Json& value) {
  if (value.is_null()) return "";
  if (!value.is_object()) {
    return "<div><dt>" + escape(prefix) + "</dt><dd>" + escape(value_text(value)) + "</dd></div>\n";
  }
  std::string rows;
  for (const auto& [key, inner] : value.items()) {
    rows += fact_rows(prefix.empty() ? key : prefix + " " + key, inner);
  }
  return rows;
}

std::string stage_row(const Json& stage, double longest) {
  const double seconds = number(stage, "seconds").value_or(0);
  const auto bytes = number(stage, "peak_rss_bytes");
  const double share = longest > 0 ? 100 * seconds / longest : 0;
  return fmt::format(
      "<tr><th scope=\"row\">{}</th><td>{}</td><td class=\"bar-cell\" "
      "aria-hidden=\"true\"><span class=\"bar\" style=\"width:{:.1f}%\"></span></td>"
      "<td>{}</td></tr>\n",
      escape(text(stage, "name")), duration(seconds), share,
      bytes ? fmt::format("{:.2f}\u00a0GiB", *bytes / (1024.0 * 1024 * 1024)) : "\u2013");
}

}  // namespace

std::vector<std::string> surrogate_names(const Json& run, const std::string& toml) {
  std::vector<std::string> names;
  const Json found = surrogates_in_run(run);
  for (const Json& name : found.is_array() ? found : Json::array()) {
    if (name.is_string()) names.push_back(name.get<std::string>());
  }
  if (names.empty()) names = surrogates_in_toml(toml);
  for (std::string& name : names) {
    if (name.find('/') != name.npos || name.ends_with(".pt2")) {
      name = std::filesystem::path(name).stem().string();
    }
  }
  return names;
}

std::string stage_table(const Json& run) {
  const Json stages = member(run, "stages");
  if (!stages.is_array() || stages.empty()) return "";
  double total = 0, longest = 0, peak = 0;
  for (const Json& stage : stages) {
    const double seconds = number(stage, "seconds").value_or(0);
    total += seconds;
    longest = std::max(longest, seconds);
    peak = std::max(peak, number(stage, "peak_rss_bytes").value_or(0));
  }
  std::string rows;
  for (const Json& stage : stages) rows += stage_row(stage, longest);
  const Json sum = {{"name", "all"}, {"seconds", total}, {"peak_rss_bytes", peak}};
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Time and memory\">"
         "<table class=\"stages\"><thead><tr><th scope=\"col\">stage</th>"
         "<th scope=\"col\">time</th><td></td><th scope=\"col\">peak memory</th></tr></thead>\n"
         "<tbody>" +
         rows + "</tbody><tfoot>" + stage_row(sum, 0) + "</tfoot></table></div>\n";
}

std::string provenance(const Json& run, const Json& record) {
  std::string rows;
  if (text(member(run, "versions"), "tt3d").empty()) {
    const std::string recorded = text(record, "tt3d_version");
    rows += fact_rows("tt3d", recorded.empty() ? kVersion : recorded);
  }
  for (const char* key : {"seed", "created", "started", "versions", "device", "threads"}) {
    rows += fact_rows(std::string(key) == "versions" ? "" : key, member(run, key));
  }
  rows += fact_rows("input", first_present(run, {"input_hashes", "inputs", "hashes"}));
  for (const Json& victim : member(record, "victims")) {
    rows += fact_rows("model " + text(victim, "name"), member(victim, "sha256"));
  }
  rows += fact_rows("asset sha256", member(record, "asset_sha256"));
  return "<dl class=\"facts\">\n" + rows + "</dl>\n";
}

}  // namespace tt3d::report
