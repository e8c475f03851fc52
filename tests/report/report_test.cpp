#include "tt3d/report.h"
#include "tt3d/asset.h"
#include "tt3d/image.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <regex>
#include <vector>

#include "report/html.h"
#include "support/shapes.h"

namespace tt3d::report {
namespace {

record::VictimRecord victim(const std::string& name, double asr, record::Interval interval,
                            double probability) {
  record::VictimRecord v;
  v.name = name;
  v.sha256 = "ab";
  v.asr = asr;
  v.asr_ci95 = interval;
  v.mean_target_probability = probability;
  return v;
}

record::EvaluationRecord sample_evaluation() {
  record::EvaluationRecord r;
  r.target = {849, "n04398044", "teapot"};
  r.true_class = record::ClassId{8, "n01514859", "hen <b>&"};
  r.asset_sha256 = "0123abcd";
  r.renderer = {"builtin", "0.1.0", false, 1};
  r.background = "white";
  r.views = {"dome", 100, 0, 400};
  r.victims = {victim("unseen-one", 0.62, {0.522, 0.709}, 0.41),
               victim("unseen-two", 0.70, {0.604, 0.781}, 0.52),
               victim("seen-model", 0.97, {0.915, 0.990}, 0.88)};
  r.victims[0].clean_accuracy = 0.81;
  r.victims[0].asr_on_correct = 0.593;
  r.victims[0].asr_on_correct_n = 81;
  r.victims[2].clean_accuracy = 0.93;
  r.victims[2].asr_on_correct = 0.968;
  r.victims[2].asr_on_correct_n = 93;
  r.victims[2].answers = {{849, "teapot", 0.9, 0.9, 0.0, 8}, {8, "hen", 0.9, 0.0, 0.9, 8}};
  r.poses = {{10, 20, 3, 0}, {200, -10, 3, 0}};
  r.naturalness.psnr = 24.37;
  r.naturalness.ssim = 0.9123;
  r.tt3d_version = "0.1.0";
  return r;
}

/// The evaluation of the same object in another renderer with light, including geometry.
record::EvaluationRecord lit_evaluation() {
  record::EvaluationRecord r;
  r.renderer = {"mitsuba", "3.9.1", true, 64};
  r.background = "#808080";
  r.views = {"dome", 20, 0, 400};
  r.victims = {victim("seen-model", 0.45, {0.3, 0.6}, 0.4),
               victim("unseen-one", 0.35, {0.2, 0.5}, 0.3)};
  r.geometry = record::GeometryRecord{0.012345, 0.0871, 11.52, 42, 5};
  return r;
}

record::JudgeRecord sample_judge() {
  record::JudgeRecord r;
  r.task = "detect";
  r.model = "/home/somebody/models/judges/dino <1>";
  r.shares = {{"Hen <b>&", 0.15}, {"teapot", 0.65}, {"vase", 0.05}};
  r.renderer.name = "builtin";
  r.views = {"dome", 20, 0, {}};
  return r;
}

record::VideoRecord sample_video() {
  record::VideoRecord r;
  r.video = "/takes/table <&>.mp4";
  r.target = {849, "", "teapot"};
  r.frames = 60;
  r.victims = {{"seen-model",
                "bb",
                {},
                {60, 0.55, {0.42, 0.67}},
                0.5,
                {{"", {1, 1, {0.2, 1}}},
                 {"grass", {40, 0.775, {0.62, 0.88}}},
                 {"wood", {19, 0.05, {0.01, 0.25}}}}}};
  return r;
}

record::RunRecord sample_run() {
  record::RunRecord r;
  r.seed = 7;
  r.versions = {{"torch", "2.11.0"}};
  r.stages = {{"field", 185.2, 1610612736, 7, {}}, {"attack", 431.9, 2147483648, 7, {}}};
  r.config = {{"attack.surrogates", {"models/seen-model.pt2"}}};
  return r;
}

/// A sphere with its directions as uvs; the texture is a chequerboard of two colours.
asset::TexturedMesh sphere_asset(int level, float tint) {
  const testing::Shape shape = testing::sphere(level);
  const at::Tensor x = shape.vertices.select(1, 0), y = shape.vertices.select(1, 1);
  const at::Tensor u = at::atan2(y, x).div(6.2831853).add(0.5);
  const at::Tensor v = shape.vertices.select(1, 2).clamp(-1, 1).acos().div(3.1415927);
  const at::Tensor cell = at::arange(256, at::kFloat).div(16).floor();
  const at::Tensor check = (cell.unsqueeze(1) + cell).remainder(2);
  const at::Tensor texture = at::stack({check * tint, check * 0.5 + 0.25, 1 - check}, 2);
  return {shape.vertices,
          shape.faces,
          {at::stack({u, v}, 1), shape.faces.clone()},
          image::to_uint8(texture)};
}

at::Tensor flat_picture(double level) {
  return at::full({300, 300, 3}, level, at::kFloat).mul(255).to(at::kByte);
}

ReportInput sample_input() {
  static const asset::TexturedMesh clean = sphere_asset(4, 0.9F);
  static const asset::TexturedMesh adversarial = sphere_asset(4, 0.3F);
  ReportInput input;
  input.title = "Hen <script>alert(1)</script>";
  input.clean = &clean;
  input.adversarial = &adversarial;
  input.evaluation = sample_evaluation();
  input.run = sample_run();
  input.others = {lit_evaluation()};
  input.judges = {sample_judge()};
  input.videos = {{sample_video(), {}}};
  for (int i = 0; i < 5; ++i) {
    ShownFrame frame{flat_picture(0.3 + 0.1 * i), 1.5 * i, i < 2 ? "grass" : "", {}};
    frame.answers = {{"seen-model", i % 2 ? "teapot" : "hen <i>", 0.8, i % 2 == 1}};
    input.videos[0].frames.push_back(frame);
  }
  input.field = record::FieldMetrics{31.24, 8};
  input.mesh = record::MeshMetrics{40312, 20158, 1, 0, 2, true, 28.81};
  input.config_toml = "seed = 7\n# a < b & \"c\"\n[attack]\ntarget = \"teapot\"\n";
  for (int i = 0; i < 250; ++i) {
    const double fall = std::exp(-i / 60.0);
    input.curves.push_back(
        {i, 6 * fall + 0.9, 6.5 * fall + 0.2, 0.01 - 0.008 * fall, 0.0002, 0.05, 0.002, 1 - fall});
  }
  for (int i = 0; i < 6; ++i) {
    ShownView view{flat_picture(0.4 + 0.05 * i), flat_picture(0.8), 60.0 * i, 15, {}};
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

/// True if all elements are opened and closed in order, except void elements and the contents of
/// scripts.
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

/// The page without pictures and 3D data; these are too large for regular expressions.
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
  const std::string html = render_report(sample_input());
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

/// The table in the region with this name.
std::string region(const std::string& html, const std::string& name) {
  const size_t start = html.find("aria-label=\"" + name + "\"");
  return start == html.npos ? "" : html.substr(start, html.find("</table>", start) - start);
}

TEST(Report, HasOneRowPerRenderer) {
  const std::string table = region(render_report(sample_input()), "By renderer");
  EXPECT_TRUE(has(table,
                  "<th scope=\"row\">builtin, unlit, white, 100 views</th><td "
                  "data-label=\"unseen-one\">62.0\u00a0%</td>"));
  EXPECT_TRUE(has(table,
                  "<th scope=\"row\">mitsuba, lit, #808080, 20 views</th><td "
                  "data-label=\"unseen-one\">35.0\u00a0%</td><td "
                  "data-label=\"unseen-two\">\u2013</td><td "
                  "data-label=\"seen-model\">45.0\u00a0%</td>"));
}

TEST(Report, HasOneRowPerTaskAndPhrase) {
  const std::string table = region(render_report(sample_input()), "By task");
  EXPECT_TRUE(has(table, "detection"));
  EXPECT_TRUE(has(table,
                  "teapot <span class=\"role seen\">target</span></td><td "
                  "data-label=\"found in\"><b>65.0\u00a0%</b>"));
  EXPECT_TRUE(has(table, "Hen &lt;b&gt;&amp; <span class=\"role unseen\">true class</span>"));
  EXPECT_TRUE(has(table, "vase</td>"));
  EXPECT_TRUE(has(table, "dino &lt;1&gt;"));
  EXPECT_FALSE(has(table, "somebody"));
}

TEST(Report, HasOneColumnPerBackgroundOfAVideo) {
  const std::string html = render_report(sample_input());
  const std::string table = region(html, "Video table &lt;&amp;&gt;.mp4");
  EXPECT_TRUE(has(table,
                  "<th scope=\"col\">all frames</th><th scope=\"col\">no label</th><th "
                  "scope=\"col\">grass</th><th scope=\"col\">wood</th>"));
  EXPECT_TRUE(has(table, "<b>55.0\u00a0%</b> <span class=\"interval\">of 60</span>"));
  EXPECT_TRUE(has(table,
                  "<td data-label=\"grass\"><b>77.5\u00a0%</b> <span "
                  "class=\"interval\">of 40</span></td>"));
}

TEST(Report, ShowsTheFramesOfAVideo) {
  const ReportInput input = sample_input();
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
  // It is in the section of the videos, which explains the marks.
  EXPECT_GT(start, page.find("id=\"videos\""));
  EXPECT_LT(start, page.find("id=\"spheres\""));
  EXPECT_TRUE(has(page, "</span> answers \u201cteapot\u201d</span>"));
  ReportInput without;
  without.videos = {{sample_video(), {}}};
  EXPECT_FALSE(has(render_report(without), "Frames of"));
}

TEST(Report, ShowsTheDistancesBetweenTheShapes) {
  const std::string html = render_report(sample_input());
  for (const char* row :
       {"<dt>Chamfer distance</dt><dd>0.0123</dd>", "<dt>Hausdorff distance</dt><dd>0.0871</dd>",
        "<dt>Mean turn of normals</dt><dd>11.5\u00b0</dd>",
        "<dt>Self-intersecting faces</dt><dd>42</dd>",
        "<dt>Self-intersecting, clean</dt><dd>5</dd>"}) {
    EXPECT_TRUE(has(html, row)) << row;
  }
  ReportInput without;
  without.evaluation = sample_evaluation();
  EXPECT_FALSE(has(render_report(without), "Chamfer"));
}

TEST(Report, EscapesAllText) {
  const std::string html = render_report(sample_input());
  EXPECT_FALSE(has(html, "<script>alert"));
  EXPECT_TRUE(has(html, "Hen &lt;script&gt;alert(1)&lt;/script&gt;"));
  EXPECT_TRUE(has(html, "black &amp; white &lt;hen&gt;"));
  EXPECT_TRUE(has(html, "# a &lt; b &amp; &quot;c&quot;"));
  EXPECT_TRUE(has(html, "hen &lt;b&gt;&amp;"));
}

TEST(Report, IsSelfContainedAndBalanced) {
  const std::string page = without_data(render_report(sample_input()));
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
  ReportInput input;
  asset::TexturedMesh mesh = sphere_asset(6, 0.5F);
  mesh.texture = image::to_uint8(testing::uniform({2048, 2048, 3}, 0, 1, 3).to(at::kFloat));
  input.clean = input.adversarial = &mesh;
  EXPECT_LT(render_report(input).size(), 8u << 20);
}

TEST(Report, AnEmptyRunGivesAPage) {
  const std::string html = render_report({});
  EXPECT_TRUE(has(html, "has not been evaluated yet"));
  EXPECT_FALSE(has(html, "<canvas"));
  EXPECT_EQ(unbalanced_element(html), "");
}

TEST(Report, TakesTheSurrogatesFromTheRun) {
  ReportInput input;
  input.evaluation = sample_evaluation();
  input.run = record::RunRecord();
  input.run->config = {{"attack.surrogates", {"unseen-one"}}};
  const std::string html = render_report(input);
  EXPECT_TRUE(has(html, ">unseen-one</th><td><span class=\"role seen\">surrogate</span>"));
  EXPECT_TRUE(has(html, ">seen-model</th><td><span class=\"role unseen\">unseen</span>"));
}

TEST(Report, PicturesOfTheWrongShapeAreInputErrors) {
  ReportInput input;
  input.views.push_back({at::zeros({4, 4}), {}, 0, 0, {}});
  EXPECT_THROW((void)render_report(input), InputError);
}

TEST(Report, EmptyRecordsGiveAPage) {
  ReportInput input;
  input.evaluation = record::EvaluationRecord();
  input.run = record::RunRecord();
  input.others = {record::EvaluationRecord()};
  input.judges = {record::JudgeRecord()};
  input.videos = {ShownVideo()};
  EXPECT_EQ(unbalanced_element(render_report(input)), "");
}

/// Writes a page for tests/python/test_report.py.
TEST(Report, WrittenForTheBrowser) {
  const char* folder = std::getenv("TT3D_REPORT_OUT");
  if (folder == nullptr) GTEST_SKIP() << "TT3D_REPORT_OUT is not set";
  write_report(sample_input(), std::filesystem::path(folder) / "report.html");
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
}  // namespace tt3d::report
