#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>

#include "figures.h"
#include "html.h"
#include "record_tables.h"
#include "run_facts.h"
#include "tt3d/report.h"

namespace tt3d {
namespace {

using namespace report;

constexpr const char* kNone = "\u2013";

/// A cell as people read it.
struct Cell {
  std::string text;
  std::string interval = "";  ///< on the page alone
  std::string role = "";      ///< a badge on the page, an asterisk in LaTeX if the attack knew it
};

struct Heading {
  std::string text;
  bool number = false;  ///< to the right in LaTeX
};

/// Rows of one kind: what CSV and JSON hold under `keys`, and what page and LaTeX show.
struct Table {
  std::string file;  ///< without its ending
  std::string key;   ///< in JSON
  std::string title;
  std::vector<std::string> keys;
  std::vector<Heading> headings;
  std::vector<std::vector<Json>> values = {};
  std::vector<std::vector<Cell>> shown = {};
};

/// A run with its records parsed.
struct ParsedRun {
  std::string name;
  std::vector<std::string> surrogates;
  Json own;  ///< an evaluation that names target and true class
};

Json value(const std::optional<double>& x) { return x ? Json(*x) : Json(); }

std::string words(const std::optional<double>& x, double factor, int digits) {
  return x ? fmt::format("{:.{}f}", factor * *x, digits) : kNone;
}

Cell share_cell(const std::optional<double>& share, const std::optional<double>& low,
                const std::optional<double>& high) {
  Cell cell{words(share, 100, 1)};
  if (low && high) cell.interval = words(low, 100, 1) + kNone + words(high, 100, 1);
  return cell;
}

bool is_lit(const Json& record) {
  const Json lit = member(member(record, "renderer"), "lit");
  return lit.is_boolean() && lit.get<bool>();
}

std::string with_light(const std::string& renderer, bool lit) {
  return renderer + (lit ? ", lit" : "");
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

void add_evaluation(const ParsedRun& run, const Json& record, Table& table) {
  const RunFigures f = run_figures(record, {}, {}, run.surrogates);
  const bool lit = is_lit(record);
  for (const VictimFigures& v : f.victims) {
    table.values.push_back({run.name, f.renderer, lit, f.background, v.name, v.surrogate,
                            value(v.asr), value(v.asr_low), value(v.asr_high),
                            value(v.clean_accuracy), value(f.psnr), value(f.ssim), value(f.lpips)});
    table.shown.push_back({{run.name},
                           {with_light(f.renderer, lit)},
                           {f.background},
                           {v.name, "", v.surrogate ? "surrogate" : "unseen"},
                           share_cell(v.asr, v.asr_low, v.asr_high),
                           {words(v.clean_accuracy, 100, 1)},
                           {words(f.psnr, 1, 2)},
                           {words(f.ssim, 1, 3)},
                           {words(f.lpips, 1, 3)}});
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

void add_judge(const ParsedRun& run, const Json& record, Table& table) {
  const std::string task = text(record, "task"), model = file_name(text(record, "model"));
  const std::string renderer = text(member(record, "renderer"), "name");
  const bool lit = is_lit(record);
  const auto views = number(member(record, "views"), "count");
  const Json shares = member(record, "shares");
  if (!shares.is_object()) return;
  for (const auto& item : shares.items()) {
    const std::string& phrase = item.key();
    const auto share = number(shares, phrase);
    const std::string role = phrase_role(phrase, run.own);
    table.values.push_back(
        {run.name, task, model, renderer, lit, phrase, role, value(share), value(views)});
    table.shown.push_back({{run.name},
                           {task_words(task)},
                           {model},
                           {with_light(renderer, lit)},
                           {phrase, "", role},
                           {words(share, 100, 1)},
                           {words(views, 1, 0)}});
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

/// `of` is "all" frames or those of a background, whose label may be empty.
void add_share(const ParsedRun& run, const std::string& video, const std::string& victim,
               const std::string& of, const std::string& label, const Json& share, Table& table) {
  const Json interval = member(share, "asr_ci95");
  std::optional<double> low, high;
  if (interval.is_array() && interval.size() == 2 && interval[0].is_number() &&
      interval[1].is_number()) {
    low = interval[0].get<double>();
    high = interval[1].get<double>();
  }
  const auto asr = number(share, "asr"), frames = number(share, "frames");
  const bool surrogate = contains(run.surrogates, victim);
  const std::string named = label.empty() ? "no label" : label;
  table.values.push_back({run.name, video, victim, surrogate, of, label, value(asr), value(low),
                          value(high), value(frames)});
  table.shown.push_back({{run.name},
                         {video},
                         {victim, "", surrogate ? "surrogate" : "unseen"},
                         {of == "all" ? "all frames" : named},
                         share_cell(asr, low, high),
                         {words(frames, 1, 0)}});
}

void add_video(const ParsedRun& run, const Json& record, Table& table) {
  const std::string video = file_name(text(record, "video"));
  for (const Json& victim : member(record, "victims")) {
    const std::string name = text(victim, "name");
    add_share(run, video, name, "all", "", victim, table);
    const Json backgrounds = member(victim, "backgrounds");
    if (!backgrounds.is_object()) continue;
    for (const auto& item : backgrounds.items()) {
      add_share(run, video, name, "background", item.key(), item.value(), table);
    }
  }
}

// ---- Forms --------------------------------------------------------------------------------

std::string csv_cell(const Json& value) {
  if (value.is_null()) return "";
  if (value.is_number()) return fmt::format("{:.6f}", value.get<double>());
  if (!value.is_string()) return value.dump();
  const std::string text = value.get<std::string>();
  if (text.find_first_of(",\"\r\n") == text.npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string to_csv(const Table& table) {
  std::string text = fmt::format("{}\n", fmt::join(table.keys, ","));
  for (const auto& row : table.values) {
    std::vector<std::string> cells;
    for (const Json& value : row) cells.push_back(csv_cell(value));
    text += fmt::format("{}\n", fmt::join(cells, ","));
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

/// What the attack worked with: a surrogate, or the target's name.
bool known_to_attack(const std::string& role) { return role == "surrogate" || role == "target"; }

std::string latex_cell(const Cell& cell) {
  return cell.text == kNone ? "--"
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

ParsedRun parse_run(const ComparedRun& run, const std::vector<Json>& evaluations) {
  ParsedRun parsed{
      run.name, surrogate_names(parse_json(run.run_json, run.name + "/run.json"), ""), {}};
  for (const Json& record : evaluations) {
    if (parsed.own.is_null() && member(record, "target").is_object()) parsed.own = record;
  }
  return parsed;
}

std::vector<Json> parse_all(const std::vector<std::string>& texts, const std::string& name) {
  std::vector<Json> records;
  for (const std::string& text : texts) records.push_back(parse_json(text, name));
  return records;
}

}  // namespace

Comparison compare_runs(const std::vector<ComparedRun>& runs) {
  Table victims = victims_table(), tasks = tasks_table(), videos = videos_table();
  for (const ComparedRun& run : runs) {
    const auto evaluations = parse_all(run.records, "an evaluation of " + run.name);
    const ParsedRun parsed = parse_run(run, evaluations);
    for (const Json& record : evaluations) add_evaluation(parsed, record, victims);
    for (const Json& record : parse_all(run.judge_records, "a judge's record of " + run.name)) {
      add_judge(parsed, record, tasks);
    }
    for (const Json& record : parse_all(run.video_records, "a video's record of " + run.name)) {
      add_video(parsed, record, videos);
    }
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

}  // namespace tt3d
