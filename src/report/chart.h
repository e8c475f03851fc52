#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

/// Line charts as inline SVG.
namespace tt3d::report {

/// A line of a chart; points that are not finite are skipped.
struct Series {
  std::string name;
  std::vector<double> x, y;  ///< same length
};

struct Chart {
  std::string title, x_label, y_label;
  std::vector<Series> series;
  std::optional<std::pair<double, double>> y_range;  ///< default: the range of the values
  bool logarithmic = false;                          ///< y axis in decades; values <= 0 are skipped
  bool shares = false;                               ///< tick labels of y in [0,1] are per cent
};

/// The chart as <figure> with axes, ticks, labels and a legend; "" if no series has two points.
[[nodiscard]] std::string chart_figure(const Chart& chart);

/// Round numbers that divide [low, high] into about `count` steps (1, 2 or 5 times a power of 10).
[[nodiscard]] std::vector<double> round_ticks(double low, double high, int count);

/// At most `count` points: means over equally long parts of the series.
[[nodiscard]] Series thin_out(const Series& series, size_t count);

}  // namespace tt3d::report
