#include <fmt/format.h>

#include "contact_sheet.h"
#include "curves.h"
#include "figures.h"
#include "html.h"
#include "page_parts.h"
#include "run_facts.h"
#include "tt3d/report.h"
#include "tt3d/version.h"
#include "view_sphere.h"
#include "viewer_object.h"

namespace tt3d {
namespace {

using namespace report;

/// Data inside <script>: "<" must not end the element.
std::string script_data(const Json& json) {
  std::string out;
  for (const char c : json.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    if (c == '<') {
      out += "\\u003c";
    } else {
      out += c;
    }
  }
  return out;
}

Json viewer_objects(const ReportInput& input) {
  Json objects = Json::array();
  if (!input.clean_glb.empty()) objects.push_back(viewer_object(input.clean_glb, "clean"));
  if (!input.adversarial_glb.empty()) {
    objects.push_back(viewer_object(input.adversarial_glb, "adversarial"));
  }
  return objects;
}

std::string canvases(const Json& objects) {
  std::string html;
  for (const Json& object : objects) {
    const std::string name = escape(text(object, "name"));
    html += "<figure><canvas tabindex=\"0\" role=\"img\" aria-label=\"The " + name +
            " object in 3D. Arrow keys turn it, plus and minus zoom.\"></canvas><figcaption>" +
            name + "</figcaption></figure>\n";
  }
  return html;
}

std::string viewer_section(const Json& objects) {
  if (objects.empty()) return "";
  return section(
      "objects", "The object, from any side",
      "<div class=\"stage\">" + canvases(objects) +
          "</div>\n<p class=\"controls\"><button type=\"button\" id=\"pause\" "
          "aria-pressed=\"false\">Pause</button><button type=\"button\" id=\"reset\">Reset view"
          "</button><span class=\"note\">Drag to turn, wheel to zoom; both move together.</span>"
          "</p>\n<p id=\"no-webgl\" class=\"warning\" hidden>This browser cannot draw 3D (WebGL "
          "2). Open the files in <code>asset/</code> with any 3D viewer; the pictures below show "
          "the same object.</p>\n<script type=\"application/json\" id=\"viewer-data\">" +
          script_data(objects) + "</script>\n<script>" + kViewerJs + "</script>\n");
}

/// Success by renderer: a column a model, a row an evaluation.
std::string renderer_table(const Json& own, const std::vector<std::string>& others) {
  if (others.empty()) return "";
  std::vector<Json> records = {own};
  for (const std::string& text : others) {
    records.push_back(parse_json(text, "another renderer's record"));
  }
  std::string head, body;
  for (const Json& victim : member(own, "victims")) {
    head += "<th scope=\"col\">" + escape(text(victim, "name")) + "</th>";
  }
  for (const Json& record : records) {
    const Json renderer = member(record, "renderer"), lit = member(renderer, "lit");
    body += "<tr><th scope=\"row\">" + escape(text(renderer, "name")) +
            (lit.is_boolean() && lit.get<bool>() ? ", lit" : ", unlit") + ", " +
            escape(text(record, "background")) + "</th>";
    for (const Json& victim : member(own, "victims")) {
      std::optional<double> rate;
      for (const Json& other : member(record, "victims")) {
        if (text(other, "name") == text(victim, "name")) rate = number(other, "asr");
      }
      body += "<td data-label=\"" + escape(text(victim, "name")) + "\">" +
              (rate ? percent(*rate) : "\u2013") + "</td>";
    }
    body += "</tr>\n";
  }
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"By renderer\"><table "
         "class=\"results\"><thead><tr><th scope=\"col\">renderer and background</th>" +
         head + "</tr></thead>\n<tbody>\n" + body + "</tbody></table></div>\n";
}

std::string configuration(const std::string& toml) {
  if (toml.empty()) return "";
  return "<details><summary>Configuration</summary><pre tabindex=\"0\">" + escape(toml) +
         "</pre></details>\n";
}

}  // namespace

std::string render_report(const ReportInput& input) {
  const Json record = parse_json(input.record_json, "the evaluation record");
  const Json run = parse_json(input.run_json, "run.json");
  const RunFigures figures =
      run_figures(record, parse_json(input.field_metrics_json, "the field's metrics"),
                  parse_json(input.mesh_metrics_json, "the mesh's metrics"),
                  surrogate_names(run, input.config_toml));
  const std::string title = input.title.empty() ? "Adversarial 3D object" : input.title;
  return fill(kPageHtml,
              {{"title", escape(title)},
               {"style", kPageCss},
               {"summary", summary(figures)},
               {"headline", headline(figures)},
               {"objects", viewer_section(viewer_objects(input))},
               {"results", section("results", "Attack success", result_table(figures))},
               {"renderers", section("renderers", "Other renderers",
                                     renderer_table(record, input.other_records))},
               {"spheres", section("spheres", "Where the attack fails",
                                   view_spheres(input.views_csv, record))},
               {"quality", section("quality", "Naturalness and quality", quality_list(figures))},
               {"sheet", section("views", "Views", contact_sheet(input.views, figures.target))},
               {"images", section("pictures", "Pictures", gallery(input.images))},
               {"curves", section("curves", "Optimisation", curve_charts(input.curves_csv))},
               {"stages", section("stages", "Time and memory", stage_table(run))},
               {"provenance", section("provenance", "How this was made",
                                      configuration(input.config_toml) +
                                          "<details><summary>Versions, "
                                          "seed and checksums</summary>\n" +
                                          provenance(run, record) + "</details>\n")},
               {"version", kVersion}});
}

void write_report(const ReportInput& input, const std::filesystem::path& html) {
  write_file_atomic(html, render_report(input));
}

}  // namespace tt3d
