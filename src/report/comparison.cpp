#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>

#include "figures.h"
#include "html.h"
#include "record_tables.h"
#include "tt3d/csv.h"
#include "tt3d/report.h"

namespace tt3d::report {
namespace {

using Json = nlohmann::ordered_json;  // keys stay in the order of the columns

/// A cell of the page and of LaTeX.
struct Cell {
  std::string text;
  std::string interval = "";  ///< page only
  std::string role = "";      ///< badge on the page; an asterisk in LaTeX for the surrogates and
                              ///< the target
};

struct Heading {
  std::string text;
  bool number = false;  ///< right-aligned in LaTeX
};

/// A table: the values for CSV and JSON with their `keys`, and the cells for page and LaTeX.
struct Table {
  std::string file;  ///< file name without extension
  std::string key;   ///< key in JSON
  std::string title;
  std::vector<std::string> keys;
  std::vector<Heading> headings;
  std::vector<std::vector<Json>> values = {};
  std::vector<std::vector<Cell>> shown = {};
};

Json value(const std::optional<double>& x) { return x ? Json(*x) : Json(); }

std::string words(const std::optional<double>& x, double factor, int digits) {
  return x ? fmt::format("{:.{}f}", factor * *x, digits) : kDash;
}

Cell share_cell(double share, const record::Interval& interval) {
  return {words(share, 100, 1), words(interval.low, 100, 1) + kDash + words(interval.high, 100, 1)};
}

std::string with_light(const record::RendererRecord& renderer) {
  return renderer.name + (renderer.lit ? ", lit" : "");
}

std::string file_name(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

// ---- Rows ---------------------------------------------------------------------------------

Table victims_table() {
  return {"comparison",
          "victims",
          "Attack success",
          {"run", "renderer", "lit", "background", "victim", "surrogate", "asr", "asr_low",
           "asr_high", "clean_accuracy", "psnr", "ssim", "lpips"},
          {{"run"},
           {"renderer"},
           {"background"},
           {"model"},
           {"ASR, %", true},
           {"clean accuracy, %", true},
           {"PSNR, dB", true},
           {"SSIM", true},
           {"LPIPS", true}}};
}

void add_evaluation(const ComparedRun& run, const record::EvaluationRecord& e, Table& table) {
  const record::NaturalnessRecord& n = e.naturalness;
  for (const ShownVictim& shown : shown_victims(e, run.surrogates)) {
    const record::VictimRecord& v = shown.figures;
    table.values.push_back({run.name, e.renderer.name, e.renderer.lit, e.background, v.name,
                            shown.surrogate, v.asr, v.asr_ci95.low, v.asr_ci95.high,
                            value(v.clean_accuracy), value(n.psnr), value(n.ssim), value(n.lpips)});
    table.shown.push_back({{run.name},
                           {with_light(e.renderer)},
                           {e.background},
                           {v.name, "", shown.surrogate ? "surrogate" : "unseen"},
                           share_cell(v.asr, v.asr_ci95),
                           {words(v.clean_accuracy, 100, 1)},
                           {words(n.psnr, 1, 2)},
                           {words(n.ssim, 1, 3)},
                           {words(n.lpips, 1, 3)}});
  }
}

Table tasks_table() {
  return {"comparison-tasks",
          "tasks",
          "Other tasks",
          {"run", "task", "model", "renderer", "lit", "phrase", "role", "share", "views"},
          {{"run"},
           {"task"},
           {"model"},
           {"renderer"},
           {"phrase"},
           {"found in, %", true},
           {"views", true}}};
}

void add_judge(const ComparedRun& run, const record::JudgeRecord& judge, Table& table) {
  OwnEvaluation own;
  if (!run.records.evaluations.empty()) own = run.records.evaluations.front();
  const std::string model = file_name(judge.model);
  for (const auto& [phrase, share] : judge.shares) {
    const std::string role = phrase_role(phrase, own);
    table.values.push_back({run.name, judge.task, model, judge.renderer.name, judge.renderer.lit,
                            phrase, role, share, judge.views.count});
    table.shown.push_back({{run.name},
                           {task_words(judge.task)},
                           {model},
                           {with_light(judge.renderer)},
                           {phrase, "", role},
                           {words(share, 100, 1)},
                           {std::to_string(judge.views.count)}});
  }
}

Table videos_table() {
  return {"comparison-videos",
          "videos",
          "Videos",
          {"run", "video", "victim", "surrogate", "of", "background", "asr", "asr_low", "asr_high",
           "frames"},
          {{"run"}, {"video"}, {"model"}, {"background"}, {"ASR, %", true}, {"frames", true}}};
}

/// Adds the row for `of`: "all" frames, or those of a background, whose label can be empty.
void add_share(const ComparedRun& run, const std::string& video, const std::string& victim,
               const std::string& of, const std::string& label, const record::FrameShare& share,
               Table& table) {
  const bool surrogate = contains(run.surrogates, victim);
  const std::string named = label.empty() ? "no label" : label;
  table.values.push_back({run.name, video, victim, surrogate, of, label, share.asr,
                          share.asr_ci95.low, share.asr_ci95.high, share.frames});
  table.shown.push_back({{run.name},
                         {video},
                         {victim, "", surrogate ? "surrogate" : "unseen"},
                         {of == "all" ? "all frames" : named},
                         share_cell(share.asr, share.asr_ci95),
                         {std::to_string(share.frames)}});
}

void add_video(const ComparedRun& run, const record::VideoRecord& record, Table& table) {
  const std::string video = file_name(record.video);
  for (const record::VideoVictim& victim : record.victims) {
    add_share(run, video, victim.name, "all", "", victim.all, table);
    for (const auto& [label, share] : victim.backgrounds) {
      add_share(run, video, victim.name, "background", label, share, table);
    }
  }
}

// ---- Forms --------------------------------------------------------------------------------

std::string csv_text(const Json& value) {
  if (value.is_null()) return "";
  if (value.is_number()) return fmt::format("{:.6f}", value.get<double>());
  return value.is_string() ? value.get<std::string>() : value.dump();
}

std::string to_csv(const Table& table) {
  std::string text = csv_line(table.keys);
  for (const auto& row : table.values) {
    std::vector<std::string> cells;
    for (const Json& value : row) cells.push_back(csv_text(value));
    text += csv_line(cells);
  }
  return text;
}

Json to_json(const Table& table) {
  Json rows = Json::array();
  for (const auto& values : table.values) {
    Json row = Json::object();
    for (size_t i = 0; i < values.size(); ++i) row[table.keys[i]] = values[i];
    rows.push_back(row);
  }
  return rows;
}

std::string latex_text(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') {
      out += "\\textbackslash{}";
    } else if (c == '~' || c == '^') {
      out += fmt::format("\\{}{{}}", c);
    } else {
      if (std::string_view("&%$#_{}").find(c) != std::string_view::npos) out += '\\';
      out += c;
    }
  }
  return out;
}

/// True for a role that the attack used: a surrogate, or the name of the target.
bool known_to_attack(const std::string& role) { return role == "surrogate" || role == "target"; }

std::string latex_cell(const Cell& cell) {
  return cell.text == kDash ? "--"
                            : latex_text(cell.text) + (known_to_attack(cell.role) ? "$^*$" : "");
}

/// A tabular for booktabs.
std::string to_latex(const Table& table) {
  std::string columns;
  std::vector<std::string> cells;
  for (const Heading& heading : table.headings) {
    columns += heading.number ? 'r' : 'l';
    cells.push_back(latex_text(heading.text));
  }
  std::string text = fmt::format("\\begin{{tabular}}{{{}}}\n\\toprule\n{} \\\\\n\\midrule\n",
                                 columns, fmt::join(cells, " & "));
  for (const auto& row : table.shown) {
    cells.clear();
    for (const Cell& cell : row) cells.push_back(latex_cell(cell));
    text += fmt::format("{} \\\\\n", fmt::join(cells, " & "));
  }
  return text + "\\bottomrule\n\\end{tabular}\n";
}

std::string html_cell(const Cell& cell) {
  std::string html = escape(cell.text);
  if (!cell.role.empty()) {
    html += fmt::format(" <span class=\"role {}\">{}</span>",
                        known_to_attack(cell.role) ? "seen" : "unseen", escape(cell.role));
  }
  if (cell.interval.empty()) return html;
  return "<b>" + html + "</b> <span class=\"interval\">" + cell.interval + "</span>";
}

std::string html_table(const Table& table) {
  if (table.shown.empty()) return "";
  std::string head, body;
  for (const Heading& heading : table.headings) head += head_cell(escape(heading.text));
  for (const auto& row : table.shown) {
    body += "<tr>" + row_head(html_cell(row.front()));
    for (size_t i = 1; i < row.size(); ++i) {
      body += cell(escape(table.headings[i].text), html_cell(row[i]));
    }
    body += "</tr>\n";
  }
  return section(table.key, table.title, report::table(table.title, head, body));
}

}  // namespace

Comparison compare_runs(const std::vector<ComparedRun>& runs) {
  Table victims = victims_table(), tasks = tasks_table(), videos = videos_table();
  for (const ComparedRun& run : runs) {
    for (const auto& evaluation : run.records.evaluations) {
      add_evaluation(run, evaluation, victims);
    }
    for (const auto& judge : run.records.judges) add_judge(run, judge, tasks);
    for (const auto& [path, video] : run.records.videos) add_video(run, video, videos);
  }
  Comparison result;
  Json all = Json::object();
  for (const Table* table : {&victims, &tasks, &videos}) {
    result.tables.push_back({table->file, to_csv(*table), to_latex(*table)});
    all[table->key] = to_json(*table);
  }
  result.json = all.dump(1) + "\n";
  result.html = page(
      {{"title", fmt::format("{} {} compared", runs.size(), runs.size() == 1 ? "run" : "runs")},
       {"summary",
        "ASR, attack success rate: the share of held-out views, or of a video\u2019s frames, that "
        "a model assigns to the target class, with its 95\u00a0% interval. Other tasks: the share "
        "of views in which a phrase was found."},
       {"results", html_table(victims)},
       {"tasks", html_table(tasks)},
       {"videos", html_table(videos)}});
  return result;
}

}  // namespace tt3d::report
