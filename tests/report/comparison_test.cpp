#include <gtest/gtest.h>

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
              {"victims", {{{"name", victim}, {"asr", asr}, {"asr_ci95", {asr - 0.1, asr + 0.1}}}}},
              {"naturalness", {{"psnr", 22.5}, {"ssim", 0.9}}}}
      .dump();
}

TEST(CompareRuns, TheSameNumbersInFourForms) {
  const Comparison both = compare_runs({{"first_run", {record_of("m_1", 0.25)}, ""},
                                        {"a \"second\" <run>", {record_of("m2", 0.75)}, ""}});
  const Json rows = Json::parse(both.json);
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_EQ(rows[0]["victim"], "m_1");
  EXPECT_EQ(rows[0]["asr"], 0.25);
  EXPECT_EQ(rows[1]["asr_ci95"], Json::parse("[0.65,0.85]"));
  EXPECT_TRUE(rows[0]["lpips"].is_null());
  EXPECT_EQ(count(both.csv, "\n"), 3U);
  EXPECT_NE(both.csv.find("\"first_run\",builtin,false,\"white\",\"m_1\",false,0.250000"),
            both.csv.npos);
  EXPECT_NE(both.csv.find("\"a \"\"second\"\" <run>\""), both.csv.npos);
  EXPECT_NE(both.latex.find("first\\_run & builtin & m\\_1 & 25.0"), both.latex.npos);
  EXPECT_NE(both.html.find("<b>25.0</b>"), both.html.npos);
  EXPECT_NE(both.html.find("a &quot;second&quot; &lt;run&gt;"), both.html.npos);
}

TEST(CompareRuns, TextThatIsNoJson) {
  EXPECT_THROW((void)compare_runs({{"x", {"{"}, ""}}), InputError);
  EXPECT_THROW((void)compare_runs({{"x", {record_of("m", 0.5)}, "["}}), InputError);
}

}  // namespace
}  // namespace tt3d::report
