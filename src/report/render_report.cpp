#include <fmt/format.h>

#include "contact_sheet.h"
#include "curves.h"
#include "figures.h"
#include "html.h"
#include "page_parts.h"
#include "record_tables.h"
#include "run_facts.h"
#include "tt3d/report.h"
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
  return page(
      {{"title", escape(title)},
       {"summary", summary(figures)},
       {"headline", headline(figures)},
       {"objects", viewer_section(viewer_objects(input))},
       {"results", section("results", "Attack success", result_table(figures))},
       {"renderers",
        section("renderers", "Other renderers", renderer_table(record, input.other_records))},
       {"tasks", section("tasks", "Other tasks", task_table(input.judge_records, record))},
       {"videos", section("videos", "Videos", video_parts(input.videos))},
       {"spheres",
        section("spheres", "Where the attack fails", view_spheres(input.views_csv, record))},
       {"quality", section("quality", "Naturalness and quality",
                           quality_list(figures) + geometry_list(record, input.other_records))},
       {"sheet", section("views", "Views", contact_sheet(input.views, figures.target))},
       {"curves", section("curves", "Optimisation", curve_charts(input.curves_csv))},
       {"stages", section("stages", "Time and memory", stage_table(run))},
       {"provenance", section("provenance", "How this was made",
                              configuration(input.config_toml) +
                                  "<details><summary>Versions, "
                                  "seed and checksums</summary>\n" +
                                  provenance(run, record) + "</details>\n")}});
}

void write_report(const ReportInput& input, const std::filesystem::path& html) {
  write_file_atomic(html, render_report(input));
}

}  // namespace tt3d
