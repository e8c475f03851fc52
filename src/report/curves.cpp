#include "curves.h"

#include <cstdlib>
#include <limits>
#include <map>
#include <sstream>
#include <vector>

#include "chart.h"

namespace tt3d::report {
namespace {

using Columns = std::map<std::string, std::vector<double>>;

std::vector<std::string> cells(std::string line) {
  if (!line.empty() && line.back() == '\r') line.pop_back();
  std::vector<std::string> result;
  std::istringstream stream(line);
  for (std::string cell; std::getline(stream, cell, ',');) result.push_back(cell);
  return result;
}

/// NaN for what is not a number: the chart skips it.
double to_number(const std::string& cell) {
  char* end = nullptr;
  const double value = std::strtod(cell.c_str(), &end);
  return end == cell.c_str() ? std::numeric_limits<double>::quiet_NaN() : value;
}

Columns read_columns(const std::string& csv) {
  Columns columns;
  std::istringstream stream(csv);
  std::string line;
  if (!std::getline(stream, line)) return columns;
  const std::vector<std::string> names = cells(line);
  while (std::getline(stream, line)) {
    const std::vector<std::string> row = cells(line);
    if (row.empty()) continue;
    for (size_t i = 0; i < names.size(); ++i) {
      columns[names[i]].push_back(to_number(i < row.size() ? row[i] : ""));
    }
  }
  return columns;
}

/// Lines for the columns that exist: {column, name shown}.
std::vector<Series> pick(const Columns& columns,
                         const std::vector<std::pair<std::string, std::string>>& wanted) {
  std::vector<Series> lines;
  const auto steps = columns.find("step");
  if (steps == columns.end()) return lines;
  for (const auto& [column, name] : wanted) {
    const auto values = columns.find(column);
    if (values != columns.end()) lines.push_back({name, steps->second, values->second});
  }
  return lines;
}

}  // namespace

std::string curve_charts(const std::string& csv) {
  const Columns columns = read_columns(csv);
  Chart loss{
      "Loss", "step", "loss", pick(columns, {{"loss", "total"}, {"objective", "adversarial"}}),
      {},     true,   false};
  Chart success{"Success on the views of each step",
                "step",
                "share that hits the target",
                pick(columns, {{"success", "success"}}),
                std::pair{0.0, 1.0},
                false,
                true};
  Chart shape{"Regularisers, before their weights",
              "step",
              "value",
              pick(columns, {{"rgb", "colour"},
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
