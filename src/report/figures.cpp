#include "figures.h"

#include <fmt/format.h>

#include <algorithm>

namespace tt3d::report {
namespace {

constexpr const char* kNone = "\u2013";

/// A class of the record: an object with a name, or plain text. ImageNet names list synonyms; the
/// first will do.
std::string class_name(const Json& value) {
  std::string name = value.is_string() ? value.get<std::string>() : text(value, "name");
  return name.substr(0, name.find(','));
}

VictimFigures victim_figures(const Json& json, const std::vector<std::string>& surrogates) {
  VictimFigures victim;
  victim.name = text(json, "name");
  victim.surrogate =
      std::find(surrogates.begin(), surrogates.end(), victim.name) != surrogates.end();
  victim.asr = number(json, "asr");
  const Json interval = member(json, "asr_ci95");
  if (interval.is_array() && interval.size() == 2 && interval[0].is_number() &&
      interval[1].is_number()) {
    victim.asr_low = interval[0].get<double>();
    victim.asr_high = interval[1].get<double>();
  }
  victim.clean_accuracy = number(json, "clean_accuracy");
  victim.asr_on_correct = number(json, "asr_on_correct");
  victim.asr_on_correct_n = number(json, "asr_on_correct_n");
  victim.target_probability = number(json, "mean_target_probability");
  return victim;
}

std::string percent_or_none(const std::optional<double>& share) {
  return share ? percent(*share) : kNone;
}

std::string decibels(double value) { return fmt::format("{:.1f}\u00a0dB", value); }

std::string quoted(const std::string& name) { return "\u201c" + escape(name) + "\u201d"; }

/// The rate with its interval drawn below it.
std::string rate_cell(const VictimFigures& victim) {
  std::string html = "<td data-label=\"ASR\"><b>" + percent_or_none(victim.asr) + "</b>";
  if (victim.asr && victim.asr_low && victim.asr_high) {
    html += fmt::format(
        " <span class=\"interval\">{:.1f}\u2013{:.1f}</span><svg class=\"rate\" viewBox=\"0 0 100 "
        "8\" preserveAspectRatio=\"none\" aria-hidden=\"true\"><rect class=\"track\" y=\"2\" "
        "width=\"100\" height=\"4\"/><rect class=\"value\" y=\"2\" width=\"{:.1f}\" height=\"4\"/>"
        "<rect class=\"whisker\" x=\"{:.1f}\" y=\"3.4\" width=\"{:.1f}\" height=\"1.2\"/></svg>",
        100 * *victim.asr_low, 100 * *victim.asr_high, 100 * *victim.asr, 100 * *victim.asr_low,
        100 * (*victim.asr_high - *victim.asr_low));
  }
  return html + "</td>";
}

std::string victim_row(const VictimFigures& victim) {
  std::string on_correct = percent_or_none(victim.asr_on_correct);
  if (victim.asr_on_correct && victim.asr_on_correct_n) {
    on_correct +=
        fmt::format(" <span class=\"interval\">of {:.0f}</span>", *victim.asr_on_correct_n);
  }
  // data-label is the column's name where a narrow page stacks the cells.
  return fmt::format(
      "<tr><th scope=\"row\">{}</th><td><span class=\"role {}\">{}</span></td>{}"
      "<td data-label=\"clean accuracy\">{}</td>"
      "<td data-label=\"ASR where right when clean\">{}</td>"
      "<td data-label=\"mean target probability\">{}</td></tr>\n",
      escape(victim.name), victim.surrogate ? "seen" : "unseen",
      victim.surrogate ? "surrogate" : "unseen", rate_cell(victim),
      percent_or_none(victim.clean_accuracy), on_correct,
      percent_or_none(victim.target_probability));
}

std::string tile(const std::string& name, const std::string& value, const std::string& note) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd><dd class=\"note\">" + note +
         "</dd></div>\n";
}

std::string fact(const std::string& name, const std::string& value) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd></div>\n";
}

/// "in A of the views" for the models of one kind.
std::string rate_words(const RunFigures& figures, bool surrogate) {
  const auto mean = figures.mean_asr(surrogate);
  if (!mean) return "";
  const auto count =
      std::count_if(figures.victims.begin(), figures.victims.end(),
                    [&](const VictimFigures& v) { return v.surrogate == surrogate; });
  std::string who = surrogate ? (count == 1 ? "the model the attack could see"
                                            : "the models the attack could see")
                              : (count == 1 ? "a model the attack never saw"
                                            : fmt::format("{} models the attack never saw", count));
  return fmt::format("<b>{}</b> of the views for {}{}", percent(*mean), who,
                     count > 1 ? " (mean)" : "");
}

}  // namespace

std::optional<double> RunFigures::mean_asr(bool surrogate) const {
  double sum = 0;
  int count = 0;
  for (const VictimFigures& victim : victims) {
    if (victim.surrogate != surrogate || !victim.asr) continue;
    sum += *victim.asr;
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / count;
}

RunFigures run_figures(const Json& record, const Json& field, const Json& mesh,
                       const std::vector<std::string>& surrogates) {
  RunFigures figures;
  figures.target = class_name(member(record, "target"));
  figures.true_class = class_name(member(record, "true_class"));
  const Json renderer = member(record, "renderer");
  figures.renderer = text(renderer, "name");
  figures.background = text(record, "background");
  const Json views = member(record, "views");
  figures.distribution = text(views, "distribution");
  figures.views = number(views, "count");
  figures.size = number(views, "size");
  for (const Json& victim : member(record, "victims")) {
    figures.victims.push_back(victim_figures(victim, surrogates));
  }
  std::stable_partition(figures.victims.begin(), figures.victims.end(),
                        [](const VictimFigures& victim) { return victim.surrogate; });
  const Json naturalness = member(record, "naturalness");
  figures.psnr = number(naturalness, "psnr");
  figures.ssim = number(naturalness, "ssim");
  figures.lpips = number(naturalness, "lpips");
  figures.field_psnr = number(field, "psnr_test");
  figures.mesh_psnr = number(mesh, "psnr_test");
  figures.faces = number(mesh, "faces");
  if (const Json closed = member(mesh, "closed"); closed.is_boolean()) {
    figures.closed = closed.get<bool>();
  }
  return figures;
}

std::string summary(const RunFigures& figures) {
  const std::string seen = rate_words(figures, true), unseen = rate_words(figures, false);
  if (seen.empty() && unseen.empty()) return "This run has not been evaluated yet.";
  std::string words = "The shape and colours of this object";
  if (!figures.true_class.empty()) words += ", a " + quoted(figures.true_class) + ",";
  words += " were changed so that image classifiers take it for " +
           (figures.target.empty() ? "another class" : quoted(figures.target)) +
           " from any side. The exported file, loaded back from disk and rendered from " +
           (figures.views ? fmt::format("{:.0f} ", *figures.views) : "") +
           "random viewpoints that the attack did not use, reaches its target in " + seen +
           (seen.empty() || unseen.empty() ? "" : ", and in ") + unseen + ".";
  if (figures.psnr && figures.ssim) {
    words += fmt::format(
        " Against the clean object it keeps a PSNR of <b>{}</b> and an SSIM of "
        "<b>{:.3f}</b>.",
        decibels(*figures.psnr), *figures.ssim);
  }
  return words;
}

std::string headline(const RunFigures& figures) {
  std::string tiles;
  if (const auto rate = figures.mean_asr(true)) {
    tiles += tile("Success, surrogate", percent(*rate), "models the attack saw");
  }
  if (const auto rate = figures.mean_asr(false)) {
    tiles += tile("Success, unseen", percent(*rate), "models it never saw, mean");
  }
  if (figures.psnr) tiles += tile("PSNR", decibels(*figures.psnr), "against the clean object");
  if (figures.ssim) {
    tiles += tile("SSIM", fmt::format("{:.3f}", *figures.ssim), "against the clean object");
  }
  return tiles.empty() ? "" : "<dl class=\"tiles\">\n" + tiles + "</dl>\n";
}

std::string result_table(const RunFigures& figures) {
  if (figures.victims.empty()) return "";
  std::string rows;
  for (const VictimFigures& victim : figures.victims) rows += victim_row(victim);
  std::string note =
      "ASR, attack success rate: the share of views that a model assigns to the "
      "target class, with its 95\u00a0% interval.";
  if (figures.views) {
    note += fmt::format(" {:.0f} views", *figures.views);
    if (figures.size) note += fmt::format(" of {:.0f}\u00a0pixels", *figures.size);
    if (!figures.distribution.empty()) note += ", distribution " + escape(figures.distribution);
    if (!figures.background.empty()) note += ", background " + escape(figures.background);
    if (!figures.renderer.empty()) note += ", renderer " + escape(figures.renderer);
    note += ".";
  }
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Result table\">"
         "<table class=\"results\"><thead><tr><th scope=\"col\">model</th>"
         "<th scope=\"col\">role</th><th scope=\"col\">ASR</th>"
         "<th scope=\"col\">clean accuracy</th><th scope=\"col\">ASR where right when clean</th>"
         "<th scope=\"col\">mean target probability</th></tr></thead>\n<tbody>" +
         rows + "</tbody></table></div>\n<p class=\"note\">" + note + "</p>\n";
}

std::string quality_list(const RunFigures& figures) {
  std::string facts;
  if (figures.psnr) facts += fact("PSNR against clean", decibels(*figures.psnr));
  if (figures.ssim) facts += fact("SSIM against clean", fmt::format("{:.3f}", *figures.ssim));
  if (figures.lpips) facts += fact("LPIPS against clean", fmt::format("{:.3f}", *figures.lpips));
  if (figures.field_psnr) facts += fact("Field, test views", decibels(*figures.field_psnr));
  if (figures.mesh_psnr) facts += fact("Mesh, test views", decibels(*figures.mesh_psnr));
  if (figures.faces) facts += fact("Faces", thousands(static_cast<int64_t>(*figures.faces)));
  if (figures.closed) facts += fact("Closed surface", *figures.closed ? "yes" : "no");
  return facts.empty() ? "" : "<dl class=\"quality\">\n" + facts + "</dl>\n";
}

}  // namespace tt3d::report
