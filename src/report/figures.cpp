#include "figures.h"

#include "html.h"

#include <fmt/format.h>

#include <algorithm>

namespace tt3d::report {
namespace {

std::string percent_or_none(const std::optional<double>& share) {
  return share ? percent(*share) : kDash;
}

std::string decibels(double value) { return fmt::format("{:.1f}\u00a0dB", value); }

std::string quoted(const std::string& name) { return "\u201c" + escape(name) + "\u201d"; }

/// The rate, with its interval as a bar below.
std::string rate_cell(const record::VictimRecord& victim) {
  return fmt::format(
      "<td data-label=\"ASR\"><b>{}</b> <span class=\"interval\">{:.1f}\u2013{:.1f}</span><svg "
      "class=\"rate\" viewBox=\"0 0 100 8\" preserveAspectRatio=\"none\" "
      "aria-hidden=\"true\"><rect class=\"track\" y=\"2\" width=\"100\" height=\"4\"/><rect "
      "class=\"value\" y=\"2\" width=\"{:.1f}\" height=\"4\"/><rect class=\"whisker\" "
      "x=\"{:.1f}\" y=\"3.4\" width=\"{:.1f}\" height=\"1.2\"/></svg></td>",
      percent(victim.asr), 100 * victim.asr_ci95.low, 100 * victim.asr_ci95.high, 100 * victim.asr,
      100 * victim.asr_ci95.low, 100 * (victim.asr_ci95.high - victim.asr_ci95.low));
}

std::string victim_row(const ShownVictim& shown) {
  const record::VictimRecord& victim = shown.figures;
  std::string on_correct = percent_or_none(victim.asr_on_correct);
  if (victim.asr_on_correct) {
    on_correct += fmt::format(" <span class=\"interval\">of {}</span>", victim.asr_on_correct_n);
  }
  // data-label is the column's name on a narrow page, which stacks the cells.
  return fmt::format(
      "<tr><th scope=\"row\">{}</th><td><span class=\"role {}\">{}</span></td>{}"
      "<td data-label=\"clean accuracy\">{}</td>"
      "<td data-label=\"ASR on correct views\">{}</td>"
      "<td data-label=\"mean target probability\">{}</td></tr>\n",
      escape(victim.name), shown.surrogate ? "seen" : "unseen",
      shown.surrogate ? "surrogate" : "unseen", rate_cell(victim),
      percent_or_none(victim.clean_accuracy), on_correct, percent(victim.mean_target_probability));
}

std::string tile(const std::string& name, const std::string& value, const std::string& note) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd><dd class=\"note\">" + note +
         "</dd></div>\n";
}

/// "A of the views for ..." about the models of one kind.
std::string rate_words(const RunFigures& figures, bool surrogate) {
  const auto mean = figures.mean_asr(surrogate);
  if (!mean) return "";
  const auto count = std::count_if(figures.victims.begin(), figures.victims.end(),
                                   [&](const ShownVictim& v) { return v.surrogate == surrogate; });
  std::string who =
      surrogate
          ? (count == 1 ? "the model that the attack used" : "the models that the attack used")
          : (count == 1 ? "a model that the attack did not use"
                        : fmt::format("{} models that the attack did not use", count));
  return fmt::format("<b>{}</b> of the views for {}{}", percent(*mean), who,
                     count > 1 ? " (mean)" : "");
}

}  // namespace

std::optional<double> RunFigures::mean_asr(bool surrogate) const {
  double sum = 0;
  int count = 0;
  for (const ShownVictim& victim : victims) {
    if (victim.surrogate != surrogate) continue;
    sum += victim.figures.asr;
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / count;
}

std::vector<ShownVictim> shown_victims(const record::EvaluationRecord& evaluation,
                                       const std::vector<std::string>& surrogates) {
  std::vector<ShownVictim> victims;
  for (const record::VictimRecord& v : evaluation.victims) {
    victims.push_back(
        {v, std::find(surrogates.begin(), surrogates.end(), v.name) != surrogates.end()});
  }
  std::stable_partition(victims.begin(), victims.end(),
                        [](const ShownVictim& v) { return v.surrogate; });
  return victims;
}

std::string first_name(const record::ClassId& id) { return id.name.substr(0, id.name.find(',')); }

std::string summary(const RunFigures& figures) {
  if (!figures.evaluation) return "This run has not been evaluated yet.";
  const record::EvaluationRecord& e = *figures.evaluation;
  const std::string seen = rate_words(figures, true), unseen = rate_words(figures, false);
  std::string words = "The shape and colours of this object";
  if (e.true_class) words += ", a " + quoted(first_name(*e.true_class)) + ",";
  words += " were changed so that image classifiers take it for " + quoted(first_name(e.target)) +
           " from any side. The exported file, loaded back from disk and rendered from " +
           std::to_string(e.views.count) +
           " random viewpoints that the attack did not use, reaches its target in " + seen +
           (seen.empty() || unseen.empty() ? "" : ", and in ") + unseen + ".";
  if (e.naturalness.psnr && e.naturalness.ssim) {
    words += fmt::format(
        " Against the clean object it keeps a PSNR of <b>{}</b> and an SSIM of "
        "<b>{:.3f}</b>.",
        decibels(*e.naturalness.psnr), *e.naturalness.ssim);
  }
  return words;
}

std::string headline(const RunFigures& figures) {
  if (!figures.evaluation) return "";
  const record::NaturalnessRecord& natural = figures.evaluation->naturalness;
  std::string tiles;
  if (const auto rate = figures.mean_asr(true)) {
    tiles += tile("Success, surrogate", percent(*rate), "models that the attack used");
  }
  if (const auto rate = figures.mean_asr(false)) {
    tiles += tile("Success, unseen", percent(*rate), "mean of the other models");
  }
  if (natural.psnr) tiles += tile("PSNR", decibels(*natural.psnr), "against the clean object");
  if (natural.ssim) {
    tiles += tile("SSIM", fmt::format("{:.3f}", *natural.ssim), "against the clean object");
  }
  return tiles.empty() ? "" : "<dl class=\"tiles\">\n" + tiles + "</dl>\n";
}

std::string result_table(const RunFigures& figures) {
  if (figures.victims.empty()) return "";
  const record::EvaluationRecord& e = *figures.evaluation;
  std::string rows;
  for (const ShownVictim& victim : figures.victims) rows += victim_row(victim);
  std::string note = fmt::format(
      "ASR, attack success rate: the share of views that a model assigns to the "
      "target class, with its 95\u00a0% interval. {} views",
      e.views.count);
  if (e.views.size) note += fmt::format(" of {}\u00a0pixels", *e.views.size);
  note += ", distribution " + escape(e.views.distribution) + ", background " +
          escape(e.background) + ", renderer " + escape(e.renderer.name) + ".";
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Result table\">"
         "<table class=\"results\"><thead><tr><th scope=\"col\">model</th>"
         "<th scope=\"col\">role</th><th scope=\"col\">ASR</th>"
         "<th scope=\"col\">clean accuracy</th><th scope=\"col\">ASR on correct views</th>"
         "<th scope=\"col\">mean target probability</th></tr></thead>\n<tbody>" +
         rows + "</tbody></table></div>\n<p class=\"note\">" + note + "</p>\n";
}

std::string quality_list(const RunFigures& figures) {
  std::string facts;
  if (figures.evaluation) {
    const record::NaturalnessRecord& n = figures.evaluation->naturalness;
    if (n.psnr) facts += fact("PSNR against clean", decibels(*n.psnr));
    if (n.ssim) facts += fact("SSIM against clean", fmt::format("{:.3f}", *n.ssim));
    if (n.lpips) facts += fact("LPIPS against clean", fmt::format("{:.3f}", *n.lpips));
  }
  if (figures.field) facts += fact("Field, test views", decibels(figures.field->psnr_test));
  if (figures.mesh) {
    const record::MeshMetrics& m = *figures.mesh;
    if (m.psnr_test) facts += fact("Mesh, test views", decibels(*m.psnr_test));
    facts += fact("Faces", thousands(m.faces));
    facts += fact("Closed surface", m.closed ? "yes" : "no");
  }
  return facts.empty() ? "" : "<dl class=\"quality\">\n" + facts + "</dl>\n";
}

}  // namespace tt3d::report
