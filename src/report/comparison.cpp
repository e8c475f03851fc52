#include <fmt/format.h>

#include <algorithm>

#include "figures.h"
#include "html.h"
#include "page_parts.h"
#include "run_facts.h"
#include "tt3d/report.h"
#include "tt3d/version.h"

namespace tt3d {
namespace {

using namespace report;

/// One evaluation of one victim.
struct Row {
  std::string run, renderer, background, victim;
  bool lit = false, surrogate = false;
  std::optional<double> asr, low, high, clean_accuracy, psnr, ssim, lpips;
};

std::vector<Row> rows_of(const ComparedRun& run) {
  std::vector<Row> rows;
  const Json facts = parse_json(run.run_json, run.name + "/run.json");
  const auto surrogates = surrogate_names(facts, "");
  for (const std::string& text : run.records) {
    const Json record = parse_json(text, "an evaluation of " + run.name);
    const RunFigures figures = run_figures(record, {}, {}, surrogates);
    const Json lit = member(member(record, "renderer"), "lit");
    for (const VictimFigures& v : figures.victims) {
      rows.push_back({run.name, figures.renderer, figures.background, v.name,
                      lit.is_boolean() && lit.get<bool>(), v.surrogate, v.asr, v.asr_low,
                      v.asr_high, v.clean_accuracy, figures.psnr, figures.ssim, figures.lpips});
    }
  }
  return rows;
}

std::string shown(const std::optional<double>& value, double factor, int digits, const char* none) {
  return value ? fmt::format("{:.{}f}", factor * *value, digits) : none;
}

std::string csv_cell(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string to_csv(const std::vector<Row>& rows) {
  std::string text =
      "run,renderer,lit,background,victim,surrogate,asr,asr_low,asr_high,clean_accuracy,psnr,ssim,"
      "lpips\n";
  for (const Row& r : rows) {
    text += fmt::format("{},{},{},{},{},{},{},{},{},{},{},{},{}\n", csv_cell(r.run), r.renderer,
                        r.lit, csv_cell(r.background), csv_cell(r.victim), r.surrogate,
                        shown(r.asr, 1, 6, ""), shown(r.low, 1, 6, ""), shown(r.high, 1, 6, ""),
                        shown(r.clean_accuracy, 1, 6, ""), shown(r.psnr, 1, 4, ""),
                        shown(r.ssim, 1, 6, ""), shown(r.lpips, 1, 6, ""));
  }
  return text;
}

Json to_json(const std::vector<Row>& rows) {
  const auto value = [](const std::optional<double>& x) { return x ? Json(*x) : Json(); };
  Json list = Json::array();
  for (const Row& r : rows) {
    list.push_back({{"run", r.run},
                    {"renderer", r.renderer},
                    {"lit", r.lit},
                    {"background", r.background},
                    {"victim", r.victim},
                    {"surrogate", r.surrogate},
                    {"asr", value(r.asr)},
                    {"asr_ci95", {value(r.low), value(r.high)}},
                    {"clean_accuracy", value(r.clean_accuracy)},
                    {"psnr", value(r.psnr)},
                    {"ssim", value(r.ssim)},
                    {"lpips", value(r.lpips)}});
  }
  return list;
}

std::string latex_text(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (std::string_view("&%$#_{}").find(c) != std::string_view::npos) out += '\\';
    if (c == '\\') {
      out += "\\textbackslash{}";
    } else if (c == '~' || c == '^') {
      out += fmt::format("\\{}{{}}", c);
    } else {
      out += c;
    }
  }
  return out;
}

std::string renderer_words(const Row& r) { return r.renderer + (r.lit ? ", lit" : ""); }

/// A tabular for booktabs.
std::string to_latex(const std::vector<Row>& rows) {
  std::string text =
      "\\begin{tabular}{lllrrrrr}\n\\toprule\nRun & Renderer & Victim & ASR (\\%) & Clean (\\%) & "
      "PSNR & SSIM & LPIPS \\\\\n\\midrule\n";
  for (const Row& r : rows) {
    text += fmt::format("{} & {} & {}{} & {} & {} & {} & {} & {} \\\\\n", latex_text(r.run),
                        latex_text(renderer_words(r)), latex_text(r.victim),
                        r.surrogate ? "$^*$" : "", shown(r.asr, 100, 1, "--"),
                        shown(r.clean_accuracy, 100, 1, "--"), shown(r.psnr, 1, 2, "--"),
                        shown(r.ssim, 1, 3, "--"), shown(r.lpips, 1, 3, "--"));
  }
  return text + "\\bottomrule\n\\end{tabular}\n";
}

std::string html_table(const std::vector<Row>& rows) {
  constexpr const char* kNone = "\u2013";
  std::string body;
  for (const Row& r : rows) {
    body += fmt::format(
        "<tr><th scope=\"row\">{}</th><td data-label=\"renderer\">{}</td><td "
        "data-label=\"background\">{}</td><td data-label=\"model\">{} <span class=\"role "
        "{}\">{}</span></td><td data-label=\"ASR, %\"><b>{}</b> <span "
        "class=\"interval\">{}\u2013{}</span></td><td data-label=\"clean accuracy, %\">{}</td><td "
        "data-label=\"PSNR, dB\">{}</td><td data-label=\"SSIM\">{}</td><td "
        "data-label=\"LPIPS\">{}</td></tr>\n",
        escape(r.run), escape(renderer_words(r)), escape(r.background), escape(r.victim),
        r.surrogate ? "seen" : "unseen", r.surrogate ? "surrogate" : "unseen",
        shown(r.asr, 100, 1, kNone), shown(r.low, 100, 1, kNone), shown(r.high, 100, 1, kNone),
        shown(r.clean_accuracy, 100, 1, kNone), shown(r.psnr, 1, 2, kNone),
        shown(r.ssim, 1, 3, kNone), shown(r.lpips, 1, 3, kNone));
  }
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Comparison\"><table "
         "class=\"results\"><thead><tr><th scope=\"col\">run</th><th "
         "scope=\"col\">renderer</th><th "
         "scope=\"col\">background</th><th scope=\"col\">model</th><th scope=\"col\">ASR, "
         "%</th><th "
         "scope=\"col\">clean accuracy, %</th><th scope=\"col\">PSNR, dB</th><th "
         "scope=\"col\">SSIM</th><th scope=\"col\">LPIPS</th></tr></thead>\n<tbody>\n" +
         body + "</tbody></table></div>\n";
}

}  // namespace

Comparison compare_runs(const std::vector<ComparedRun>& runs) {
  std::vector<Row> rows;
  for (const ComparedRun& run : runs) {
    const std::vector<Row> own = rows_of(run);
    rows.insert(rows.end(), own.begin(), own.end());
  }
  const std::string title = fmt::format("{} runs compared", runs.size());
  Comparison result;
  result.csv = to_csv(rows);
  result.json = to_json(rows).dump(1) + "\n";
  result.latex = to_latex(rows);
  result.html = fill(
      kPageHtml, {{"title", title},
                  {"style", kPageCss},
                  {"summary",
                   "One row a run, renderer and model. ASR, attack success rate: the share of "
                   "held-out views that a model assigns to the target class, with its 95\u00a0% "
                   "interval."},
                  {"headline", ""},
                  {"objects", ""},
                  {"results", section("results", "Attack success", html_table(rows))},
                  {"renderers", ""},
                  {"tasks", ""},
                  {"videos", ""},
                  {"spheres", ""},
                  {"quality", ""},
                  {"sheet", ""},
                  {"images", ""},
                  {"curves", ""},
                  {"stages", ""},
                  {"provenance", ""},
                  {"version", kVersion}});
  return result;
}

}  // namespace tt3d
