#include "curves.h"

#include <vector>

#include "chart.h"

namespace tt3d::report {
namespace {

/// A line of a chart for each named column of the log.
std::vector<Series> lines(const record::Curves& curves,
                          const std::vector<std::pair<std::string, std::string>>& columns) {
  std::vector<Series> result;
  for (const auto& [column, shown] : columns) {
    for (const auto& known : record::columns()) {
      if (column != known.name) continue;
      Series line{shown, {}, {}};
      for (const record::CurvePoint& point : curves) {
        line.x.push_back(static_cast<double>(point.step));
        line.y.push_back(point.*known.member);
      }
      result.push_back(std::move(line));
    }
  }
  return result;
}

}  // namespace

std::string curve_charts(const record::Curves& curves) {
  Chart loss{
      "Loss", "step", "loss", lines(curves, {{"loss", "total"}, {"objective", "adversarial"}}),
      {},     true,   false};
  Chart success{"Success on the views of each step",
                "step",
                "share that hits the target",
                lines(curves, {{"success", "success"}}),
                std::pair{0.0, 1.0},
                false,
                true};
  Chart shape{"Regularisers, before their weights",
              "step",
              "value",
              lines(curves, {{"rgb", "colour"},
                             {"chamfer", "Chamfer"},
                             {"laplacian", "Laplacian"},
                             {"edge", "edge length"}}),
              {},
              true,
              false};
  const std::string charts = chart_figure(loss) + chart_figure(success) + chart_figure(shape);
  return charts.empty() ? "" : "<div class=\"charts\">\n" + charts + "</div>\n";
}

}  // namespace tt3d::report
