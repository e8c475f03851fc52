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

namespace tt3d::report {
namespace {

using nlohmann::json;

/// Data inside <script>: "<" must not end the element.
std::string script_data(const json& data) {
  std::string out;
  for (const char c : data.dump(-1, ' ', false, json::error_handler_t::replace)) {
    if (c == '<') {
      out += "\\u003c";
    } else {
      out += c;
    }
  }
  return out;
}

json viewer_objects(const ReportInput& input) {
  json objects = json::array();
  if (input.clean) objects.push_back(viewer_object(*input.clean, "clean"));
  if (input.adversarial) objects.push_back(viewer_object(*input.adversarial, "adversarial"));
  return objects;
}

std::string canvases(const json& objects) {
  std::string html;
  for (const json& object : objects) {
    const std::string name = escape(object["name"].get<std::string>());
    html += "<figure><canvas tabindex=\"0\" role=\"img\" aria-label=\"The " + name +
            " object in 3D. Arrow keys turn it, plus and minus zoom.\"></canvas><figcaption>" +
            name + "</figcaption></figure>\n";
  }
  return html;
}

std::string viewer_section(const json& objects) {
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
  RunFigures figures;
  figures.evaluation = input.evaluation;
  figures.field = input.field;
  figures.mesh = input.mesh;
  const auto surrogates = input.run ? input.run->surrogates() : std::vector<std::string>();
  if (input.evaluation) figures.victims = shown_victims(*input.evaluation, surrogates);
  const std::string title = input.title.empty() ? "Adversarial 3D object" : input.title;
  const std::string target =
      input.evaluation ? first_name(input.evaluation->target) : std::string();
  const auto stages = input.run ? input.run->stages : std::vector<record::StageRecord>();
  return page(
      {{"title", escape(title)},
       {"summary", summary(figures)},
       {"headline", headline(figures)},
       {"objects", viewer_section(viewer_objects(input))},
       {"results", section("results", "Attack success", result_table(figures))},
       {"renderers",
        section("renderers", "Other renderers", renderer_table(input.evaluation, input.others))},
       {"tasks", section("tasks", "Other tasks", task_table(input.judges, input.evaluation))},
       {"videos", section("videos", "Videos", video_parts(input.videos))},
       {"spheres", section("spheres", "Where the attack fails", view_spheres(input.evaluation))},
       {"quality", section("quality", "Naturalness and quality",
                           quality_list(figures) + geometry_list(input.evaluation, input.others))},
       {"sheet", section("views", "Views", contact_sheet(input.views, target))},
       {"curves", section("curves", "Optimisation", curve_charts(input.curves))},
       {"stages", section("stages", "Time and memory", stage_table(stages))},
       {"provenance", section("provenance", "How this was made",
                              configuration(input.config_toml) +
                                  "<details><summary>Versions, seed and checksums</summary>\n" +
                                  provenance(input.run, input.evaluation) + "</details>\n")}});
}

void write_report(const ReportInput& input, const std::filesystem::path& html) {
  write_file_atomic(html, render_report(input));
}

}  // namespace tt3d::report
