#include "view_sphere.h"

#include "html.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace tt3d::report {
namespace {

constexpr double kWidth = 420, kHeight = 230, kLeft = 44, kTop = 10, kRight = 22, kBottom = 40;

/// A view as a point in the plot.
struct Point {
  double azimuth = 0, elevation = 0;
  bool hit = false;
};

double column_of(double azimuth) {
  return kLeft + (azimuth - 360 * std::floor(azimuth / 360)) / 360 * (kWidth - kLeft - kRight);
}
double row_of(double elevation) {
  return kTop + (90 - elevation) / 180 * (kHeight - kTop - kBottom);
}

std::string axes() {
  std::string svg;
  for (const int elevation : {-90, -45, 0, 45, 90}) {
    svg += fmt::format(
        "<line class=\"grid\" x1=\"{:.0f}\" x2=\"{:.0f}\" y1=\"{:.1f}\" y2=\"{:.1f}\"/>"
        "<text x=\"{:.0f}\" y=\"{:.1f}\" text-anchor=\"end\">{}\u00b0</text>\n",
        kLeft, kWidth - kRight, row_of(elevation), row_of(elevation), kLeft - 6,
        row_of(elevation) + 4, elevation);
  }
  for (int azimuth = 0; azimuth <= 360; azimuth += 90) {
    const double x = kLeft + azimuth / 360.0 * (kWidth - kLeft - kRight);
    svg += fmt::format("<text x=\"{:.0f}\" y=\"{:.0f}\" text-anchor=\"middle\">{}\u00b0</text>\n",
                       x, kHeight - kBottom + 16, azimuth);
  }
  return svg + fmt::format(
                   "<text class=\"label\" x=\"{:.0f}\" y=\"{:.0f}\" "
                   "text-anchor=\"middle\">azimuth; elevation upwards</text>\n",
                   (kLeft + kWidth) / 2, kHeight - 6);
}

/// Shares by octant of azimuth, for screen readers.
std::string spoken(const std::vector<Point>& views) {
  std::array<int, 8> hits{}, counts{};
  for (const Point& v : views) {
    const double turn = v.azimuth / 360 - std::floor(v.azimuth / 360);
    const auto octant = std::min<size_t>(7, static_cast<size_t>(turn * 8));
    ++counts[octant];
    hits[octant] += v.hit;
  }
  std::string words;
  for (size_t k = 0; k < 8; ++k) {
    if (counts[k] == 0) continue;
    words += fmt::format("{}{} to {} degrees: {} of {}", words.empty() ? "" : "; ", 45 * k,
                         45 * (k + 1), hits[k], counts[k]);
  }
  return words;
}

std::string plot(const std::string& victim, const std::vector<Point>& views) {
  std::string points;
  int64_t hits = 0;
  for (const Point& v : views) {
    hits += v.hit;
    points += fmt::format("<circle class=\"{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{}\"/>\n",
                          v.hit ? "seen-hit" : "seen-miss", column_of(v.azimuth),
                          row_of(v.elevation), v.hit ? 4 : 3.5);
  }
  return fmt::format(
      "<figure class=\"chart\"><figcaption>{}: {} of {} views</figcaption>\n<svg viewBox=\"0 0 "
      "{:.0f} {:.0f}\" role=\"img\" aria-label=\"Hits of {} by azimuth: "
      "{}\">\n{}{}</svg></figure>\n",
      escape(victim), hits, views.size(), kWidth, kHeight, escape(victim), spoken(views), axes(),
      points);
}

}  // namespace

std::string view_spheres(const std::optional<record::EvaluationRecord>& evaluation) {
  if (!evaluation) return "";
  std::string plots;
  for (const record::VictimRecord& victim : evaluation->victims) {
    std::vector<Point> points;
    for (size_t i = 0; i < victim.answers.size(); ++i) {
      const record::ViewPose& pose = evaluation->poses[i];
      points.push_back({pose.azimuth_deg, pose.elevation_deg,
                        victim.answers[i].top1 == evaluation->target.index});
    }
    if (!points.empty()) plots += plot(victim.name, points);
  }
  if (plots.empty()) return "";
  return "<p>All scored views. <span class=\"hit key\">\u25cf answers the target</span> "
         "<span class=\"miss key\">\u25cb another answer</span></p>\n<div "
         "class=\"charts\">\n" +
         plots + "</div>\n";
}

}  // namespace tt3d::report
