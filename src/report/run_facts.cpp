#include "run_facts.h"

#include <fmt/format.h>

#include <algorithm>

#include "html.h"
#include "tt3d/version.h"

namespace tt3d::report {
namespace {

std::string escaped_fact(const std::string& name, const std::string& value) {
  return fact(escape(name), escape(value));
}

std::string stage_row(const record::StageRecord& stage, double longest) {
  const double share = longest > 0 ? 100 * stage.seconds / longest : 0;
  return fmt::format(
      "<tr><th scope=\"row\">{}</th><td>{}</td><td class=\"bar-cell\" "
      "aria-hidden=\"true\"><span class=\"bar\" style=\"width:{:.1f}%\"></span></td>"
      "<td>{:.2f}\u00a0GiB</td></tr>\n",
      escape(stage.name), duration(stage.seconds), share,
      static_cast<double>(stage.peak_rss_bytes) / (1024.0 * 1024 * 1024));
}

}  // namespace

std::string stage_table(const std::vector<record::StageRecord>& stages) {
  if (stages.empty()) return "";
  record::StageRecord sum = {"all", 0, 0, {}, {}};
  double longest = 0;
  for (const record::StageRecord& stage : stages) {
    sum.seconds += stage.seconds;
    sum.peak_rss_bytes = std::max(sum.peak_rss_bytes, stage.peak_rss_bytes);
    longest = std::max(longest, stage.seconds);
  }
  std::string rows;
  for (const record::StageRecord& stage : stages) rows += stage_row(stage, longest);
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Time and memory\">"
         "<table class=\"stages\"><thead><tr><th scope=\"col\">stage</th>"
         "<th scope=\"col\">time</th><td></td><th scope=\"col\">peak memory</th></tr></thead>\n"
         "<tbody>" +
         rows + "</tbody><tfoot>" + stage_row(sum, 0) + "</tfoot></table></div>\n";
}

std::string provenance(const std::optional<record::RunRecord>& run,
                       const std::optional<record::EvaluationRecord>& evaluation) {
  std::string rows;
  if (run) {
    rows += escaped_fact("seed", std::to_string(run->seed));
    for (const auto& [name, version] : run->versions) rows += escaped_fact(name, version);
    if (run->device) rows += escaped_fact("device", *run->device);
    if (run->threads) rows += escaped_fact("threads", std::to_string(*run->threads));
    for (const auto& [file, hash] : run->inputs) rows += escaped_fact("input " + file, hash);
  } else {
    rows += escaped_fact("tt3d", evaluation ? evaluation->tt3d_version : kVersion);
  }
  if (evaluation) {
    for (const record::VictimRecord& v : evaluation->victims)
      rows += escaped_fact("model " + v.name, v.sha256);
    rows += escaped_fact("asset sha256", evaluation->asset_sha256);
  }
  return "<dl class=\"facts\">\n" + rows + "</dl>\n";
}

}  // namespace tt3d::report
