#include "tt3d/report.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <regex>
#include <vector>

#include "report/html.h"
#include "support/shapes.h"
#include "support/temporary_folder.h"

namespace tt3d {
namespace {

constexpr const char* kRecord = R"({
 "target": {"index": 849, "wnid": "n04398044", "name": "teapot"},
 "true_class": {"index": 8, "wnid": "n01514859", "name": "hen <b>&"},
 "asset_sha256": "0123abcd",
 "renderer": {"name": "builtin", "version": "0.1.0", "lit": false}, "background": "white",
 "views": {"distribution": "dome", "count": 100, "seed": 0, "size": 400},
 "victims": [
  {"name": "unseen-one", "sha256": "aa", "clean_accuracy": 0.81, "clean_n": 100, "asr": 0.62,
   "asr_ci95": [0.522, 0.709], "asr_on_correct": 0.593, "asr_on_correct_n": 81,
   "mean_target_probability": 0.41},
  {"name": "unseen-two", "sha256": "cc", "clean_accuracy": null, "clean_n": 0, "asr": 0.70,
   "asr_ci95": [0.604, 0.781], "asr_on_correct": null, "asr_on_correct_n": 0,
   "mean_target_probability": 0.52},
  {"name": "seen-model", "sha256": "bb", "clean_accuracy": 0.93, "clean_n": 100, "asr": 0.97,
   "asr_ci95": [0.915, 0.990], "asr_on_correct": 0.968, "asr_on_correct_n": 93,
   "mean_target_probability": 0.88}],
 "naturalness": {"psnr": 24.37, "ssim": 0.9123, "lpips": null},
 "tt3d_version": "0.1.0", "wall_seconds": 12.5})";

/// The same object under another renderer's light, with the shapes compared.
constexpr const char* kLit = R"({
 "renderer": {"name": "mitsuba", "version": "3.9.1", "lit": true}, "background": "#808080",
 "victims": [{"name": "seen-model", "asr": 0.45}, {"name": "unseen-one", "asr": 0.35}],
 "geometry": {"chamfer": 0.012345, "hausdorff": 0.0871, "normal_deviation_deg": 11.52,
              "self_intersecting_faces": 42, "self_intersecting_faces_clean": 5}})";

constexpr const char* kJudge = R"({
 "task": "detect", "model": "/home/somebody/models/judges/dino <1>",
 "shares": {"Hen <b>&": 0.15, "teapot": 0.65, "vase": 0.05}, "answers": [],
 "renderer": {"name": "builtin", "lit": false}, "views": {"distribution": "dome", "count": 20}})";

constexpr const char* kVideo = R"({
 "video": "/takes/table <&>.mp4", "target": {"index": 849, "name": "teapot"}, "frames": 60,
 "victims": [{"name": "seen-model", "asr": 0.55, "frames": 60, "asr_ci95": [0.42, 0.67],
   "backgrounds": {"": {"asr": 1, "frames": 1, "asr_ci95": [0.2, 1]},
                   "grass": {"asr": 0.775, "frames": 40, "asr_ci95": [0.62, 0.88]},
                   "wood": {"asr": 0.05, "frames": 19, "asr_ci95": [0.01, 0.25]}}}]})";

constexpr const char* kRun = R"({"seed": 7, "versions": {"torch": "2.11.0"},
 "stages": [{"name": "field", "seconds": 185.2, "peak_rss_bytes": 1610612736},
            {"name": "attack", "seconds": 431.9, "peak_rss_bytes": 2147483648}],
 "config": {"attack": {"surrogates": ["models/seen-model.pt2"]}}})";

/// A sphere whose uvs are its directions; the texture is a chequerboard in two colours.
TexturedMesh sphere_asset(int level, float tint) {
  const testing::Shape shape = testing::sphere(level);
  const at::Tensor x = shape.vertices.select(1, 0), y = shape.vertices.select(1, 1);
  const at::Tensor u = at::atan2(y, x).div(6.2831853).add(0.5);
  const at::Tensor v = shape.vertices.select(1, 2).clamp(-1, 1).acos().div(3.1415927);
  const at::Tensor cell = at::arange(256, at::kFloat).div(16).floor();
  const at::Tensor check = (cell.unsqueeze(1) + cell).remainder(2);
  const at::Tensor texture = at::stack({check * tint, check * 0.5 + 0.25, 1 - check}, 2);
  return {shape.vertices, shape.faces, at::stack({u, v}, 1), shape.faces.clone(),
          to_uint8(texture)};
}

at::Tensor flat_picture(double level) {
  return at::full({300, 300, 3}, level, at::kFloat).mul(255).to(at::kByte);
}

ReportInput sample_input(const std::filesystem::path& folder) {
  ReportInput input;
  input.title = "Hen <script>alert(1)</script>";
  input.clean_glb = folder / "clean.glb";
  input.adversarial_glb = folder / "adversarial.glb";
  write_glb(sphere_asset(4, 0.9F), input.clean_glb);
  write_glb(sphere_asset(4, 0.3F), input.adversarial_glb);
  input.record_json = kRecord;
  input.run_json = kRun;
  input.other_records = {kLit};
  input.judge_records = {kJudge};
  input.videos = {{kVideo, {}}};
  for (int i = 0; i < 5; ++i) {
    ReportFrame frame{flat_picture(0.3 + 0.1 * i), 1.5 * i, i < 2 ? "grass" : "", {}};
    frame.answers = {{"seen-model", i % 2 ? "teapot" : "hen <i>", 0.8, i % 2 == 1}};
    input.videos[0].frames.push_back(frame);
  }
  input.views_csv =
      "victim,view,azimuth_deg,elevation_deg,distance,roll_deg,top1_index,top1_name,p_top1,"
      "p_target,p_true,clean_top1_index\n"
      "seen-model,0,10,20,3,0,849,teapot,0.9,0.9,0.0,8\n"
      "seen-model,1,200,-10,3,0,8,hen,0.9,0.0,0.9,8\n";
  input.field_metrics_json = R"({"psnr_test": 31.24})";
  input.mesh_metrics_json = R"({"psnr_test": 28.81, "faces": 40312, "closed": true})";
  input.config_toml = "seed = 7\n# a < b & \"c\"\n[attack]\ntarget = \"teapot\"\n";
  input.curves_csv = "step,loss,objective,rgb,chamfer,laplacian,edge,success\n";
  for (int i = 0; i < 250; ++i) {
    const double fall = std::exp(-i / 60.0);
    input.curves_csv += std::to_string(i) + "," + std::to_string(6 * fall + 0.9) + "," +
                        std::to_string(6.5 * fall + 0.2) + "," +
                        std::to_string(0.01 - 0.008 * fall) + ",0.0002,0.05,0.002," +
                        std::to_string(1 - fall) + "\n";
  }
  for (int i = 0; i < 6; ++i) {
    ReportView view{flat_picture(0.4 + 0.05 * i), flat_picture(0.8), 60.0 * i, 15, {}};
    view.answers = {{"seen-model", "teapot", 0.98, true},
                    {"unseen-one", i % 2 ? "teapot" : "black & white <hen>", 0.61, i % 2 == 1},
                    {"unseen-two", "a class with rather a long name, to break lines", 0.4, false}};
    input.views.push_back(view);
  }
  return input;
}

bool has(const std::string& html, const std::string& part) {
  return html.find(part) != std::string::npos;
}

/// Elements that are opened and closed in order; void elements and scripts' contents apart.
std::string unbalanced_element(const std::string& html) {
  static const std::regex tag("<(/?)([a-zA-Z][a-zA-Z0-9]*)([^>]*)>");
  static const std::regex script("<script[^>]*>[\\s\\S]*?</script>|<style>[\\s\\S]*?</style>");
  const std::string text = std::regex_replace(html, script, "");
  std::vector<std::string> open;
  for (std::sregex_iterator it(text.begin(), text.end(), tag), end; it != end; ++it) {
    const std::string name = (*it)[2], rest = (*it)[3];
    if (name == "meta" || name == "link" || name == "img" || rest.ends_with("/")) continue;
    if ((*it)[1].length() == 0) {
      open.push_back(name);
    } else if (open.empty() || open.back() != name) {
      return "</" + name + "> at " + std::to_string(it->position());
    } else {
      open.pop_back();
    }
  }
  return open.empty() ? "" : "<" + open.back() + ">";
}

/// The page without pictures and 3D data, which regular expressions cannot chew.
std::string without_data(const std::string& html) {
  std::string out;
  size_t at = 0;
  for (size_t start = html.find("base64,"); start != html.npos; start = html.find("base64,", at)) {
    out.append(html, at, start - at);
    at = html.find_first_of("\"'", start);
  }
  out.append(html, at, html.npos);
  const size_t data = out.find("<script type=\"application/json\"");
  if (data == out.npos) return out;
  return out.erase(data, out.find("</script>", data) + 9 - data);
}

TEST(Report, ShowsTheFiguresOfARun) {
  const testing::TemporaryFolder folder;
  const std::string html = render_report(sample_input(folder.path()));
  for (const char* figure :
       {"97.0\u00a0%", "62.0\u00a0%", "91.5\u201399.0", "93.0\u00a0%", "96.8\u00a0%", "88.0\u00a0%",
        "24.4\u00a0dB", "0.912", "31.2\u00a0dB", "28.8\u00a0dB", "40,312", "3\u00a0min 05\u00a0s",
        "2.00\u00a0GiB", "2.11.0", "azimuth 60\u00b0", "66.0\u00a0%"}) {
    EXPECT_TRUE(has(html, figure)) << figure;
  }
  EXPECT_LT(html.find(">seen-model</th>"), html.find(">unseen-one</th>"));
  EXPECT_TRUE(has(html, "<span class=\"role seen\">surrogate</span>"));
  EXPECT_TRUE(has(html, "\u25c9"));
}

/// The table whose region has this name.
std::string region(const std::string& html, const std::string& name) {
  const size_t start = html.find("aria-label=\"" + name + "\"");
  return start == html.npos ? "" : html.substr(start, html.find("</table>", start) - start);
}

TEST(Report, ARowARenderer) {
  const testing::TemporaryFolder folder;
  const std::string table = region(render_report(sample_input(folder.path())), "By renderer");
  EXPECT_TRUE(has(table,
                  "<th scope=\"row\">builtin, unlit, white, 100 views</th><td "
                  "data-label=\"unseen-one\">62.0\u00a0%</td>"));
  EXPECT_TRUE(has(table,
                  "<th scope=\"row\">mitsuba, lit, #808080</th><td "
                  "data-label=\"unseen-one\">35.0\u00a0%</td><td "
                  "data-label=\"unseen-two\">\u2013</td><td "
                  "data-label=\"seen-model\">45.0\u00a0%</td>"));
}

TEST(Report, ARowATaskAndPhrase) {
  const testing::TemporaryFolder folder;
  const std::string table = region(render_report(sample_input(folder.path())), "By task");
  EXPECT_TRUE(has(table, "detection"));
  EXPECT_TRUE(has(table,
                  "teapot <span class=\"role seen\">target</span></td><td "
                  "data-label=\"found in\"><b>65.0\u00a0%</b>"));
  EXPECT_TRUE(has(table, "Hen &lt;b&gt;&amp; <span class=\"role unseen\">true class</span>"));
  EXPECT_TRUE(has(table, "vase</td>"));
  EXPECT_TRUE(has(table, "dino &lt;1&gt;"));
  EXPECT_FALSE(has(table, "somebody"));
}

TEST(Report, AColumnABackgroundOfAVideo) {
  const testing::TemporaryFolder folder;
  const std::string html = render_report(sample_input(folder.path()));
  const std::string table = region(html, "Video table &lt;&amp;&gt;.mp4");
  EXPECT_TRUE(has(table,
                  "<th scope=\"col\">all frames</th><th scope=\"col\">no label</th><th "
                  "scope=\"col\">grass</th><th scope=\"col\">wood</th>"));
  EXPECT_TRUE(has(table, "<b>55.0\u00a0%</b> <span class=\"interval\">of 60</span>"));
  EXPECT_TRUE(has(table,
                  "<td data-label=\"grass\"><b>77.5\u00a0%</b> <span "
                  "class=\"interval\">of 40</span></td>"));
}

TEST(Report, AStripOfAVideosFrames) {
  const testing::TemporaryFolder folder;
  const ReportInput input = sample_input(folder.path());
  const std::string page = without_data(render_report(input));
  const size_t start =
      page.find("role=\"region\" aria-label=\"Frames of table &lt;&amp;&gt;.mp4\"");
  ASSERT_NE(start, page.npos);
  const std::string strip = page.substr(start, page.find("</ol>", start) - start);
  static const std::regex image("<img [^>]*alt=\"frame at [0-9.]+\u00a0s(, grass)?\"");
  EXPECT_EQ(std::distance(std::sregex_iterator(strip.begin(), strip.end(), image), {}), 5);
  EXPECT_TRUE(has(strip, "<p>1.5\u00a0s, grass</p>"));
  EXPECT_TRUE(has(strip, "<span class=\"spoken\">target: </span>teapot <b>80\u00a0%</b>"));
  EXPECT_TRUE(has(strip, "<span class=\"spoken\">not the target: </span>hen &lt;i&gt;"));
  // It stands in the part of the videos, which says what the marks mean.
  EXPECT_GT(start, page.find("id=\"videos\""));
  EXPECT_LT(start, page.find("id=\"spheres\""));
  EXPECT_TRUE(has(page, "</span> says \u201cteapot\u201d</span>"));
  ReportInput without;
  without.videos = {{kVideo, {}}};
  EXPECT_FALSE(has(render_report(without), "Frames of"));
}

TEST(Report, ShapesAreCompared) {
  const testing::TemporaryFolder folder;
  const std::string html = render_report(sample_input(folder.path()));
  for (const char* row :
       {"<dt>Chamfer distance</dt><dd>0.0123</dd>", "<dt>Hausdorff distance</dt><dd>0.0871</dd>",
        "<dt>Mean turn of normals</dt><dd>11.5\u00b0</dd>",
        "<dt>Self-intersecting faces</dt><dd>42</dd>",
        "<dt>Self-intersecting, clean</dt><dd>5</dd>"}) {
    EXPECT_TRUE(has(html, row)) << row;
  }
  ReportInput without;
  without.record_json = kRecord;
  EXPECT_FALSE(has(render_report(without), "Chamfer"));
}

TEST(Report, EscapesAllText) {
  const testing::TemporaryFolder folder;
  const std::string html = render_report(sample_input(folder.path()));
  EXPECT_FALSE(has(html, "<script>alert"));
  EXPECT_TRUE(has(html, "Hen &lt;script&gt;alert(1)&lt;/script&gt;"));
  EXPECT_TRUE(has(html, "black &amp; white &lt;hen&gt;"));
  EXPECT_TRUE(has(html, "# a &lt; b &amp; &quot;c&quot;"));
  EXPECT_TRUE(has(html, "hen &lt;b&gt;&amp;"));
}

TEST(Report, IsSelfContainedAndBalanced) {
  const testing::TemporaryFolder folder;
  const std::string page = without_data(render_report(sample_input(folder.path())));
  EXPECT_FALSE(has(page, "http://"));
  EXPECT_FALSE(has(page, "https://"));
  EXPECT_FALSE(has(page, "{{"));
  EXPECT_EQ(unbalanced_element(page), "");
  static const std::regex image("<img [^>]*>");
  for (std::sregex_iterator it(page.begin(), page.end(), image), end; it != end; ++it) {
    EXPECT_TRUE(has(it->str(), "alt=\"")) << it->str();
  }
}

TEST(Report, LargeObjectsStaySmallEnough) {
  const testing::TemporaryFolder folder;
  ReportInput input;
  input.clean_glb = folder / "clean.glb";
  input.adversarial_glb = folder / "adversarial.glb";
  TexturedMesh mesh = sphere_asset(6, 0.5F);
  mesh.texture = to_uint8(testing::uniform({2048, 2048, 3}, 0, 1, 3).to(at::kFloat));
  write_glb(mesh, input.clean_glb);
  write_glb(mesh, input.adversarial_glb);
  EXPECT_LT(render_report(input).size(), 8u << 20);
}

TEST(Report, EmptyRunStillGivesAPage) {
  const std::string html = render_report({});
  EXPECT_TRUE(has(html, "has not been evaluated yet"));
  EXPECT_FALSE(has(html, "<canvas"));
  EXPECT_EQ(unbalanced_element(html), "");
}

TEST(Report, SurrogatesFromTheConfigurationText) {
  ReportInput input;
  input.record_json = kRecord;
  input.config_toml = "[attack]\nsurrogates = [\"seen-model\", \"unseen-two\"]\n";
  const std::string html = render_report(input);
  EXPECT_TRUE(has(html, ">unseen-two</th><td><span class=\"role seen\">surrogate</span>"));
}

TEST(Report, SurrogatesFromDottedKeysOfRunJson) {
  ReportInput input;
  input.record_json = kRecord;
  for (const char* value : {R"(["unseen-one"])", R"("[\"unseen-one\"]")"}) {
    input.run_json = std::string("{\"config\": {\"attack.surrogates\": ") + value + "}}";
    const std::string html = render_report(input);
    EXPECT_TRUE(has(html, ">unseen-one</th><td><span class=\"role seen\">surrogate</span>"));
  }
}

TEST(Report, BadInputIsNamed) {
  ReportInput input;
  input.record_json = "{\"victims\": [";
  try {
    (void)render_report(input);
    FAIL() << "accepted broken JSON";
  } catch (const InputError& error) {
    EXPECT_TRUE(has(error.what(), "evaluation record")) << error.what();
  }
  input = {};
  input.clean_glb = "/nowhere/clean.glb";
  EXPECT_THROW((void)render_report(input), InputError);
  input = {};
  input.views.push_back({at::zeros({4, 4}), {}, 0, 0, {}});
  EXPECT_THROW((void)render_report(input), InputError);
}

TEST(Report, OddJsonIsLeftOut) {
  ReportInput input;
  input.record_json = R"({"victims": [3, {"name": 5, "asr": "x", "asr_ci95": [1]}], "target": []})";
  input.run_json = R"({"stages": [7, {"seconds": null}], "versions": "one"})";
  input.mesh_metrics_json = "[1, 2]";
  input.other_records = {"{}", R"({"renderer": 4, "geometry": [], "victims": {}})"};
  input.judge_records = {R"({"task": 3, "shares": {"a": "b"}})", R"({"shares": [0.5]})"};
  input.videos = {{"{}", {}}, {R"({"video": 2, "victims": [4, {"backgrounds": [1]}]})", {}}};
  EXPECT_EQ(unbalanced_element(render_report(input)), "");
}

/// Leaves a page for tests/python/test_report.py.
TEST(Report, WrittenForTheBrowser) {
  const char* folder = std::getenv("TT3D_REPORT_OUT");
  if (folder == nullptr) GTEST_SKIP() << "TT3D_REPORT_OUT is not set";
  write_report(sample_input(folder), std::filesystem::path(folder) / "report.html");
}

TEST(Html, Texts) {
  EXPECT_EQ(report::escape("<a href='x'>&\"</a>"),
            "&lt;a href=&#39;x&#39;&gt;&amp;&quot;&lt;/a&gt;");
  EXPECT_EQ(report::thousands(1234567), "1,234,567");
  EXPECT_EQ(report::thousands(999), "999");
  EXPECT_EQ(report::thousands(-1000), "-1,000");
  EXPECT_EQ(report::duration(59.94), "59.9\u00a0s");
  EXPECT_EQ(report::duration(3725), "1\u00a0h 02\u00a0min");
  EXPECT_EQ(report::fill("a{{x}}b{{y}}", {{"x", "{{y}}"}, {"y", "2"}}), "a{{y}}b2");
  EXPECT_THROW((void)report::fill("{{z}}", {}), std::logic_error);
}

}  // namespace
}  // namespace tt3d
