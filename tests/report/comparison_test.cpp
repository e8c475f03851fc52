#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

#include "report/view_sphere.h"
#include "tt3d/error.h"
#include "tt3d/report.h"

namespace tt3d::report {
namespace {

size_t count(const std::string& text, const std::string& part) {
  size_t n = 0;
  for (size_t at = text.find(part); at != text.npos; at = text.find(part, at + 1)) ++n;
  return n;
}

using Json = nlohmann::json;

TEST(ViewSpheres, HitsMissesAndOctantsOfEachVictim) {
  record::EvaluationRecord r;
  r.target = {849, "", "teapot"};
  r.poses = {{10, 20, 3, 0}, {-10, 20, 3, 0}, {44, -5, 3, 0}};
  r.victims.resize(2);
  r.victims[0].name = "a";
  r.victims[0].answers = {{849, "teapot", 1, 1, {}, {}},
                          {8, "hen, a bird", 1, 0, {}, {}},
                          {849, "teapot", 1, 1, {}, {}}};
  r.victims[1].name = "<b>";
  r.victims[1].answers = {{1, "x", 1, 0, {}, {}}};
  const std::string plots = view_spheres(r);
  EXPECT_EQ(count(plots, "<figure"), 2U);
  EXPECT_EQ(count(plots, "class=\"seen-hit\""), 2U);
  EXPECT_EQ(count(plots, "class=\"seen-miss\""), 2U);
  EXPECT_NE(plots.find("a: 2 of 3 views"), plots.npos);
  EXPECT_NE(plots.find("0 to 45 degrees: 2 of 2; 315 to 360 degrees: 0 of 1"), plots.npos);
  EXPECT_NE(plots.find("&lt;b&gt;: 0 of 1 views"), plots.npos);
}

TEST(ViewSpheres, AreEmptyWithoutViews) {
  EXPECT_EQ(view_spheres({}), "");
  EXPECT_EQ(view_spheres(record::EvaluationRecord()), "");
}

/// An evaluation of one victim.
record::EvaluationRecord record_of(const std::string& name, double asr) {
  record::EvaluationRecord r;
  r.renderer.name = "builtin";
  r.background = "white";
  r.target = {849, "", "teapot"};
  r.true_class = record::ClassId{8, "", "hen, biddy"};
  record::VictimRecord v;
  v.name = name;
  v.asr = asr;
  v.asr_ci95 = {asr - 0.1, asr + 0.1};
  r.victims = {v};
  r.naturalness.psnr = 22.5;
  r.naturalness.ssim = 0.9;
  return r;
}

record::JudgeRecord judge_record() {
  record::JudgeRecord r;
  r.task = "caption";
  r.model = "/home/somebody/judges/caption";
  r.shares = {{"a, \"b\" & c", 0.05}, {"Biddy", 0.15}, {"teapot", 0.65}};
  r.renderer.name = "blender";
  r.renderer.lit = true;
  r.views.count = 20;
  return r;
}

record::VideoRecord video_record() {
  record::VideoRecord r;
  r.video = "/home/somebody/take_1.mp4";
  r.victims = {{"m1",
                "",
                {},
                {10, 0.5, {0.2, 0.8}},
                0.5,
                {{"", {2, 0, {0, 0.6}}}, {"grass", {8, 0.625, {0.3, 0.9}}}}},
               {"m2", "", {}, {10, 0.25, {0.1, 0.5}}, 0.25, {}}};
  return r;
}

TEST(CompareRuns, PageJsonCsvAndLatexHaveTheSameNumbers) {
  const Comparison both = compare_runs({{"first_run", {{record_of("m_1", 0.25)}, {}, {}}},
                                        {"a \"second\" <run>", {{record_of("m2", 0.75)}, {}, {}}}});
  const Json rows = Json::parse(both.json)["victims"];
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_EQ(rows[0]["victim"], "m_1");
  EXPECT_EQ(rows[0]["asr"], 0.25);
  EXPECT_EQ(rows[1]["asr_low"], 0.65);
  EXPECT_EQ(rows[1]["asr_high"], 0.85);
  EXPECT_TRUE(rows[0]["lpips"].is_null());
  ASSERT_EQ(both.tables.size(), 3U);
  const auto& [file, csv, latex] = both.tables[0];
  EXPECT_EQ(file, "comparison");
  EXPECT_EQ(count(csv, "\n"), 3U);
  EXPECT_NE(csv.find("first_run,builtin,false,white,m_1,false,0.250000,0.150000"), csv.npos);
  EXPECT_NE(csv.find("\"a \"\"second\"\" <run>\""), csv.npos);
  EXPECT_NE(latex.find("first\\_run & builtin & white & m\\_1 & 25.0 & -- & 22.50"), latex.npos);
  EXPECT_NE(both.html.find("<b>25.0</b>"), both.html.npos);
  EXPECT_NE(both.html.find("a &quot;second&quot; &lt;run&gt;"), both.html.npos);
  EXPECT_EQ(both.html.find("id=\"tasks\""), both.html.npos);
  EXPECT_EQ(both.html.find("id=\"videos\""), both.html.npos);
}

TEST(CompareRuns, HasOneRowPerRunTaskAndPhrase) {
  const Comparison page = compare_runs({{"one", {{record_of("m1", 0.5)}, {judge_record()}, {}}},
                                        {"two", {{}, {judge_record()}, {}}}});
  const Json rows = Json::parse(page.json)["tasks"];
  ASSERT_EQ(rows.size(), 6U);
  EXPECT_EQ(rows[0], Json::parse(R"({"run": "one", "task": "caption", "model": "caption",
      "renderer": "blender", "lit": true, "phrase": "Biddy", "role": "true class", "share": 0.15,
      "views": 20})"));
  EXPECT_EQ(rows[2]["role"], "target");
  EXPECT_EQ(rows[5]["role"], "");  // the target of this run is unknown
  const auto& [file, csv, latex] = page.tables.at(1);
  EXPECT_EQ(file, "comparison-tasks");
  EXPECT_EQ(count(csv, "\n"), 7U);
  EXPECT_NE(csv.find("one,caption,caption,blender,true,\"a, \"\"b\"\" & c\",,0.050000,20.000000\n"),
            csv.npos);
  EXPECT_NE(latex.find("one & captions & caption & blender, lit & teapot$^*$ & 65.0 & 20 \\\\"),
            latex.npos);
  EXPECT_NE(latex.find("a, \"b\" \\& c & 5.0"), latex.npos);
  EXPECT_NE(page.html.find("teapot <span class=\"role seen\">target</span></td><td "
                           "data-label=\"found in, %\">65.0</td>"),
            page.html.npos);
  EXPECT_EQ((page.html + page.json).find("somebody"), std::string::npos);
}

TEST(CompareRuns, HasOneRowPerVideoVictimAndBackground) {
  const Comparison page = compare_runs({{"one", {{}, {}, {{"", video_record()}}}, {"m2"}}});
  const Json rows = Json::parse(page.json)["videos"];
  ASSERT_EQ(rows.size(), 4U);
  EXPECT_EQ(rows[0], Json::parse(R"({"run": "one", "video": "take_1.mp4", "victim": "m1",
      "surrogate": false, "of": "all", "background": "", "asr": 0.5, "asr_low": 0.2,
      "asr_high": 0.8, "frames": 10})"));
  EXPECT_EQ(rows[1]["of"], "background");
  EXPECT_EQ(rows[1]["frames"], 2);
  EXPECT_EQ(rows[2]["background"], "grass");
  EXPECT_EQ(rows[3]["surrogate"], true);
  const auto& [file, csv, latex] = page.tables.at(2);
  EXPECT_EQ(file, "comparison-videos");
  EXPECT_NE(csv.find("one,take_1.mp4,m1,false,background,grass,0.625000,0.300000,0.900000,8"),
            csv.npos);
  EXPECT_NE(latex.find("one & take\\_1.mp4 & m2$^*$ & all frames & 25.0 & 10 \\\\"), latex.npos);
  EXPECT_NE(latex.find("m1 & no label & 0.0 & 2 \\\\"), latex.npos);
  EXPECT_NE(page.html.find("<td data-label=\"background\">grass</td><td data-label=\"ASR, "
                           "%\"><b>62.5</b> <span class=\"interval\">30.0\u201390.0</span></td>"),
            page.html.npos);
}

/// Writes a page for tests/python/test_report.py.
TEST(CompareRuns, WrittenForTheBrowser) {
  const char* folder = std::getenv("TT3D_REPORT_OUT");
  if (folder == nullptr) GTEST_SKIP() << "TT3D_REPORT_OUT is not set";
  const std::vector<std::string> surrogates = {"seen-model"};
  const Comparison page =
      compare_runs({{"hen-teapot-dual",
                     {{record_of("seen-model", 0.9), record_of("another-model", 0.3)},
                      {judge_record()},
                      {{"", video_record()}}},
                     surrogates},
                    {"hen-teapot-texture",
                     {{record_of("seen-model", 0.8)}, {judge_record()}, {{"", video_record()}}},
                     surrogates}});
  write_file_atomic(std::filesystem::path(folder) / "comparison.html", page.html);
}

}  // namespace
}  // namespace tt3d::report
