#include "view_sphere.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <sstream>
#include <vector>

namespace tt3d::report {
namespace {

constexpr double kWidth = 420, kHeight = 230, kLeft = 44, kTop = 10, kRight = 22, kBottom = 40;

struct View {
  double azimuth = 0, elevation = 0;
  bool hit = false;
};

/// Cells of a CSV line; quotes enclose commas.
std::vector<std::string> cells(const std::string& line) {
  std::vector<std::string> out(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      out.emplace_back();
    } else if (c != '\r') {
      out.back() += c;
    }
  }
  return out;
}

std::map<std::string, std::vector<View>> read_views(const std::string& csv, int64_t target) {
  std::map<std::string, std::vector<View>> views;
  std::istringstream stream(csv);
  std::string line;
  if (!std::getline(stream, line)) return views;
  const std::vector<std::string> names = cells(line);
  const auto column = [&](const char* name) {
    return static_cast<size_t>(std::find(names.begin(), names.end(), name) - names.begin());
  };
  const std::array<size_t, 4> wanted = {column("victim"), column("azimuth_deg"),
                                        column("elevation_deg"), column("top1_index")};
  const size_t last = *std::max_element(wanted.begin(), wanted.end());
  while (std::getline(stream, line)) {
    const std::vector<std::string> row = cells(line);
    if (last >= row.size()) continue;
    views[row[wanted[0]]].push_back({std::atof(row[wanted[1]].c_str()),
                                     std::atof(row[wanted[2]].c_str()),
                                     std::atoll(row[wanted[3]].c_str()) == target});
  }
  return views;
}

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

/// Shares by eighth of the turn, for readers who cannot see the plot.
std::string spoken(const std::vector<View>& views) {
  std::array<int, 8> hits{}, counts{};
  for (const View& v : views) {
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

std::string plot(const std::string& victim, const std::vector<View>& views) {
  std::string points;
  int64_t hits = 0;
  for (const View& v : views) {
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

std::string view_spheres(const std::string& csv, const Json& record) {
  const auto target = number(member(record, "target"), "index");
  if (!target) return "";
  std::string plots;
  for (const auto& [victim, views] : read_views(csv, static_cast<int64_t>(*target))) {
    plots += plot(victim, views);
  }
  if (plots.empty()) return "";
  return "<p>Every view that was scored. <span class=\"hit key\">\u25cf says the target</span> "
         "<span class=\"miss key\">\u25cb says something else</span></p>\n<div "
         "class=\"charts\">\n" +
         plots + "</div>\n";
}

}  // namespace tt3d::report
