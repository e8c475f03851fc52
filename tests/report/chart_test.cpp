#include <gtest/gtest.h>

#include <limits>

#include "report/chart.h"
#include "report/curves.h"
#include "tt3d/report.h"

namespace tt3d::report {
namespace {

TEST(Chart, TicksAreRoundAndInside) {
  EXPECT_EQ(round_ticks(0, 1000, 5), (std::vector<double>{0, 200, 400, 600, 800, 1000}));
  const auto ticks = round_ticks(-0.13, 0.27, 4);
  ASSERT_EQ(ticks.size(), 4u);
  EXPECT_NEAR(ticks[0], -0.1, 1e-12);
  EXPECT_NEAR(ticks[3], 0.2, 1e-12);
  EXPECT_TRUE(round_ticks(1, 1, 5).empty());
  EXPECT_TRUE(round_ticks(0, std::numeric_limits<double>::quiet_NaN(), 5).empty());
}

TEST(Chart, ThinningKeepsTheMean) {
  Series series{"s", {}, {}};
  for (int i = 0; i < 1000; ++i) {
    series.x.push_back(i);
    series.y.push_back(i % 2);
  }
  const Series thin = thin_out(series, 100);
  ASSERT_EQ(thin.x.size(), 100u);
  for (const double y : thin.y) EXPECT_DOUBLE_EQ(y, 0.5);
  EXPECT_DOUBLE_EQ(thin.x.front(), 4.5);
}

TEST(Chart, PointsAgreeWithTheAxes) {
  const Chart chart{"t", "x", "y", {{"s", {0, 10}, {0, 1}}}, std::pair{0.0, 1.0}, false, true};
  const std::string svg = chart_figure(chart);
  EXPECT_NE(svg.find("d=\"M78.0 254.0L506.0 14.0\""), std::string::npos) << svg;
  EXPECT_NE(svg.find(">100\u00a0%</text>"), std::string::npos);
  EXPECT_NE(svg.find("from 0.0\u00a0% to 100.0\u00a0%"), std::string::npos);
}

TEST(Chart, LogarithmicAxesHaveRoundTicks) {
  const std::string svg = chart_figure({"t", "x", "y", {{"s", {0, 1}, {0.3, 7}}}, {}, true, false});
  for (const char* tick : {">0.5</text>", ">1</text>", ">2</text>", ">5</text>"}) {
    EXPECT_NE(svg.find(tick), std::string::npos) << tick;
  }
}

TEST(Chart, IsEmptyWithoutPoints) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(chart_figure({"t", "x", "y", {{"s", {1, 2}, {nan, 3}}}, {}, false, false}), "");
  EXPECT_EQ(chart_figure({"t", "x", "y", {{"s", {1, 2}, {0, -3}}}, {}, true, false}), "");
  EXPECT_EQ(curve_charts({}), "");
}

TEST(Curves, ColumnsMayBeFlatEmptyOrNotFinite) {
  record::Curves curves(3);
  for (size_t i = 0; i < 3; ++i) {
    curves[i].step = static_cast<int64_t>(i);
    curves[i].loss = 2.5;
  }
  curves[1].loss = std::numeric_limits<double>::quiet_NaN();
  curves[2].success = 1;
  const std::string html = curve_charts(curves);
  EXPECT_NE(html.find("<figcaption>Loss</figcaption>"), std::string::npos);
  EXPECT_NE(html.find("Success on the views"), std::string::npos);
  EXPECT_EQ(html.find("Regularisers"), std::string::npos);
  EXPECT_EQ(html.find("nan"), std::string::npos);
  EXPECT_EQ(html.find("inf"), std::string::npos);
}

}  // namespace
}  // namespace tt3d::report
