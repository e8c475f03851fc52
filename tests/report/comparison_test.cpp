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

const Json kRecord = {{"target", {{"index", 849}, {"name", "teapot"}}}};

TEST(ViewSpheres, HitsMissesAndOctantsOfEachVictim) {
  const std::string plots = view_spheres(
      "victim,view,azimuth_deg,elevation_deg,top1_index,top1_label\n"
      "a,0,10,20,849,teapot\n"
      "a,1,-10,20,8,\"hen, a bird\"\n"
      "a,2,44,-5,849,teapot\n"
      "<b>,0,100,0,1,x\n",
      kRecord);
  EXPECT_EQ(count(plots, "<figure"), 2U);
  EXPECT_EQ(count(plots, "class=\"seen-hit\""), 2U);
  EXPECT_EQ(count(plots, "class=\"seen-miss\""), 2U);
  EXPECT_NE(plots.find("a: 2 of 3 views"), plots.npos);
  EXPECT_NE(plots.find("0 to 45 degrees: 2 of 2; 315 to 360 degrees: 0 of 1"), plots.npos);
  EXPECT_NE(plots.find("&lt;b&gt;: 0 of 1 views"), plots.npos);
}

TEST(ViewSpheres, WithoutViewsThereIsNone) {
  EXPECT_EQ(view_spheres("", kRecord), "");
  EXPECT_EQ(view_spheres("victim,azimuth_deg,elevation_deg,top1_index\n", kRecord), "");
  EXPECT_EQ(view_spheres("victim,azimuth_deg\na,1\n", kRecord), "");  // columns are missing
  EXPECT_EQ(view_spheres("victim,azimuth_deg,elevation_deg,top1_index\na,1\n", kRecord), "");
  EXPECT_EQ(view_spheres("victim,azimuth_deg,elevation_deg,top1_index\na,1,2,849\n", {}), "");
}

/// An evaluation of one victim.
std::string record_of(const std::string& victim, double asr) {
  return Json{{"renderer", {{"name", "builtin"}, {"lit", false}}},
              {"background", "white"},
              {"target", {{"index", 849}, {"name", "teapot"}}},
              {"true_class", {{"index", 8}, {"name", "hen, biddy"}}},
              {"victims", {{{"name", victim}, {"asr", asr}, {"asr_ci95", {asr - 0.1, asr + 0.1}}}}},
              {"naturalness", {{"psnr", 22.5}, {"ssim", 0.9}}}}
      .dump();
}

constexpr const char* kJudge = R"({
 "task": "caption", "model": "/home/somebody/judges/caption",
 "shares": {"a, \"b\" & c": 0.05, "Biddy": 0.15, "teapot": 0.65},
 "renderer": {"name": "blender", "lit": true}, "views": {"count": 20}})";

constexpr const char* kVideo = R"({
 "video": "/home/somebody/take_1.mp4",
 "victims": [{"name": "m1", "asr": 0.5, "frames": 10, "asr_ci95": [0.2, 0.8],
   "backgrounds": {"": {"asr": 0, "frames": 2, "asr_ci95": [0, 0.6]},
                   "grass": {"asr": 0.625, "frames": 8, "asr_ci95": [0.3, 0.9]}}},
  {"name": "m2", "asr": 0.25, "frames": 10, "asr_ci95": [0.1, 0.5], "backgrounds": {}}]})";

TEST(CompareRuns, TheSameNumbersInFourForms) {
  const Comparison both = compare_runs({{"first_run", {record_of("m_1", 0.25)}, ""},
                                        {"a \"second\" <run>", {record_of("m2", 0.75)}, ""}});
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

TEST(CompareRuns, ARowARunTaskAndPhrase) {
  const Comparison page =
      compare_runs({{"one", {record_of("m1", 0.5)}, "", {kJudge}}, {"two", {}, "", {kJudge}}});
  const Json rows = Json::parse(page.json)["tasks"];
  ASSERT_EQ(rows.size(), 6U);
  EXPECT_EQ(rows[1], Json::parse(R"({"run": "one", "task": "caption", "model": "caption",
      "renderer": "blender", "lit": true, "phrase": "Biddy", "role": "true class", "share": 0.15,
      "views": 20.0})"));
  EXPECT_EQ(rows[2]["role"], "target");
  EXPECT_EQ(rows[5]["role"], "");  // nothing tells that run's target
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

TEST(CompareRuns, ARowAVideoVictimAndBackground) {
  const std::string run = R"({"config": {"attack": {"surrogates": ["m2"]}}})";
  const Comparison page = compare_runs({{"one", {}, run, {}, {kVideo}}});
  const Json rows = Json::parse(page.json)["videos"];
  ASSERT_EQ(rows.size(), 4U);
  EXPECT_EQ(rows[0], Json::parse(R"({"run": "one", "video": "take_1.mp4", "victim": "m1",
      "surrogate": false, "of": "all", "background": "", "asr": 0.5, "asr_low": 0.2,
      "asr_high": 0.8, "frames": 10.0})"));
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

TEST(CompareRuns, TextThatIsNoJson) {
  EXPECT_THROW((void)compare_runs({{"x", {"{"}, ""}}), InputError);
  EXPECT_THROW((void)compare_runs({{"x", {record_of("m", 0.5)}, "["}}), InputError);
  EXPECT_THROW((void)compare_runs({{"x", {}, "", {"{"}}}), InputError);
  EXPECT_THROW((void)compare_runs({{"x", {}, "", {}, {"{"}}}), InputError);
}

TEST(CompareRuns, OddRecordsAreLeftOut) {
  const Comparison page =
      compare_runs({{"x",
                     {"{}", "[]"},
                     "3",
                     {R"({"shares": [1]})", R"({"shares": {"a": "b"}})"},
                     {R"({"victims": [3, {"asr_ci95": [1], "backgrounds": [2]}]})"}}});
  EXPECT_EQ(Json::parse(page.json)["tasks"].size(), 1U);  // a phrase without a share
  EXPECT_EQ(Json::parse(page.json)["victims"].size(), 0U);
}

/// Leaves a page for tests/python/test_report.py.
TEST(CompareRuns, WrittenForTheBrowser) {
  const char* folder = std::getenv("TT3D_REPORT_OUT");
  if (folder == nullptr) GTEST_SKIP() << "TT3D_REPORT_OUT is not set";
  const std::string run = R"({"config": {"attack": {"surrogates": ["seen-model"]}}})";
  const Comparison page = compare_runs(
      {{"hen-teapot-dual",
        {record_of("seen-model", 0.9), record_of("another-model", 0.3)},
        run,
        {kJudge},
        {kVideo}},
       {"hen-teapot-texture", {record_of("seen-model", 0.8)}, run, {kJudge}, {kVideo}}});
  write_file_atomic(std::filesystem::path(folder) / "comparison.html", page.html);
}

}  // namespace
}  // namespace tt3d::report
