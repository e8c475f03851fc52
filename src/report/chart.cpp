#include "chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "html.h"

namespace tt3d::report {
namespace {

// Drawing area in SVG units; the SVG scales with the page.
constexpr double kWidth = 520, kHeight = 300;
constexpr double kLeft = 78, kRight = 14, kTop = 14, kBottom = 46;
constexpr size_t kMaxPoints = 400;

/// Range of an axis in plot units: values, or their decimal logarithms.
struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
  /// Widens an empty or flat range.
  void widen() {
    if (high > low) return;
    const double margin = std::max(std::abs(low) * 0.05, 1e-3);
    low -= margin;
    high += margin;
  }
};

/// Maps values to positions in the drawing.
struct Frame {
  Range x, y;
  bool logarithmic = false;
  [[nodiscard]] double column(double value) const {
    return kLeft + (value - x.low) / (x.high - x.low) * (kWidth - kLeft - kRight);
  }
  [[nodiscard]] double row_of_drawn(double drawn) const {
    return kHeight - kBottom - (drawn - y.low) / (y.high - y.low) * (kHeight - kTop - kBottom);
  }
  [[nodiscard]] double row(double value) const {
    return row_of_drawn(logarithmic ? std::log10(value) : value);
  }
};

/// The series without points that cannot be drawn.
Series drawable(const Series& series, bool logarithmic) {
  Series kept{series.name, {}, {}};
  for (size_t i = 0; i < std::min(series.x.size(), series.y.size()); ++i) {
    const double value = series.y[i];
    if (!std::isfinite(series.x[i]) || !std::isfinite(value) || (logarithmic && value <= 0)) {
      continue;
    }
    kept.x.push_back(series.x[i]);
    kept.y.push_back(value);
  }
  return thin_out(kept, kMaxPoints);
}

Frame frame_of(const std::vector<Series>& lines, const Chart& chart) {
  Frame frame;
  frame.logarithmic = chart.logarithmic;
  for (const Series& line : lines) {
    for (const double x : line.x) frame.x.add(x);
    for (const double y : line.y) frame.y.add(chart.logarithmic ? std::log10(y) : y);
  }
  if (chart.y_range) frame.y = {chart.y_range->first, chart.y_range->second};
  frame.x.widen();
  frame.y.widen();
  if (chart.logarithmic) {  // A margin between the lines and the frame.
    const double margin = 0.04 * (frame.y.high - frame.y.low);
    frame.y = {frame.y.low - margin, frame.y.high + margin};
  }
  if (!chart.y_range && !chart.logarithmic && frame.y.low > 0 && frame.y.low < 0.5 * frame.y.high) {
    frame.y.low = 0;
  }
  return frame;
}

/// Decimal logarithms of the powers of ten in a range of logarithms. If these are few, also those
/// of 2 and 5 times a power of ten.
std::vector<double> decade_ticks(const Range& range) {
  const double span = range.high - range.low;
  const std::vector<double> factors =
      span < 2.2 ? std::vector<double>{1, 2, 5} : std::vector<double>{1};
  const double stride = std::max(1.0, std::ceil(span / 6));
  std::vector<double> ticks;
  for (double decade = std::floor(range.low); decade <= range.high; decade += stride) {
    for (const double factor : factors) {
      const double tick = decade + std::log10(factor);
      if (tick >= range.low && tick <= range.high) ticks.push_back(tick);
    }
  }
  return ticks;
}

/// Ticks of the y axis in plot units.
std::vector<double> y_ticks(const Frame& frame) {
  std::vector<double> ticks;
  if (frame.logarithmic) ticks = decade_ticks(frame.y);
  return ticks.size() >= 2 ? ticks : round_ticks(frame.y.low, frame.y.high, 5);
}

std::string tick_text(double drawn, const Chart& chart) {
  if (chart.shares) return fmt::format("{:.0f}\u00a0%", 100 * drawn);
  const double value = chart.logarithmic ? std::pow(10, drawn) : drawn;
  return fmt::format("{:.3g}", value == 0 ? 0.0 : value);
}

std::string axes(const Frame& frame, const Chart& chart) {
  std::string svg;
  for (const double tick : y_ticks(frame)) {
    const double y = frame.row_of_drawn(tick);
    svg += fmt::format(
        "<line class=\"grid\" x1=\"{:.0f}\" x2=\"{:.0f}\" y1=\"{:.1f}\" "
        "y2=\"{:.1f}\"/><text x=\"{:.0f}\" y=\"{:.1f}\" text-anchor=\"end\">{}"
        "</text>\n",
        kLeft, kWidth - kRight, y, y, kLeft - 8, y + 4, tick_text(tick, chart));
  }
  const double base = kHeight - kBottom;
  for (const double tick : round_ticks(frame.x.low, frame.x.high, 5)) {
    const double x = frame.column(tick);
    svg += fmt::format(
        "<line class=\"axis\" x1=\"{0:.1f}\" x2=\"{0:.1f}\" y1=\"{1:.0f}\" "
        "y2=\"{2:.0f}\"/><text x=\"{0:.1f}\" y=\"{3:.0f}\" "
        "text-anchor=\"middle\">{4:.6g}</text>\n",
        x, base, base + 5, base + 19, tick);
  }
  svg += fmt::format("<path class=\"axis\" d=\"M{:.0f} {:.0f}V{:.0f}H{:.0f}\"/>\n", kLeft, kTop,
                     base, kWidth - kRight);
  svg += fmt::format(
      "<text class=\"label\" x=\"{:.0f}\" y=\"{:.0f}\" text-anchor=\"middle\">{}"
      "</text>\n",
      (kLeft + kWidth - kRight) / 2, kHeight - 8, escape(chart.x_label));
  svg += fmt::format(
      "<text class=\"label\" transform=\"translate(13 {:.0f}) rotate(-90)\" "
      "text-anchor=\"middle\">{}</text>\n",
      (kTop + base) / 2, escape(chart.y_label));
  return svg;
}

std::string line_path(const Series& line, const Frame& frame, size_t index) {
  std::string path;
  for (size_t i = 0; i < line.x.size(); ++i) {
    path += fmt::format("{}{:.1f} {:.1f}", i == 0 ? "M" : "L", frame.column(line.x[i]),
                        frame.row(line.y[i]));
  }
  return fmt::format("<path class=\"line line-{}\" d=\"{}\"/>\n", index, path);
}

std::string legend(const std::vector<Series>& lines) {
  if (lines.size() < 2) return "";
  std::string html = "<ul class=\"legend\">";
  for (size_t i = 0; i < lines.size(); ++i) {
    html += fmt::format(
        "<li><svg width=\"28\" height=\"8\" aria-hidden=\"true\"><path "
        "class=\"line line-{}\" d=\"M1 4H27\"/></svg>{}</li>",
        i, escape(lines[i].name));
  }
  return html + "</ul>";
}

/// The text for screen readers.
std::string description(const Chart& chart, const std::vector<Series>& lines) {
  std::string words = chart.title + " against " + chart.x_label + ".";
  for (const Series& line : lines) {
    const auto value = [&](double y) {
      return chart.shares ? percent(y) : fmt::format("{:.3g}", y);
    };
    words +=
        fmt::format(" {}: from {} to {}.", line.name, value(line.y.front()), value(line.y.back()));
  }
  return words;
}

}  // namespace

std::vector<double> round_ticks(double low, double high, int count) {
  std::vector<double> ticks;
  if (!(high > low) || count < 1) return ticks;
  const double raw = (high - low) / count;
  const double power = std::pow(10, std::floor(std::log10(raw)));
  const double factor = raw / power;
  const double step = power * (factor <= 1.5 ? 1 : factor <= 3.5 ? 2 : factor <= 7.5 ? 5 : 10);
  const auto first = static_cast<int64_t>(std::ceil(low / step - 1e-9));
  const auto last = static_cast<int64_t>(std::floor(high / step + 1e-9));
  for (int64_t i = first; i <= last; ++i) ticks.push_back(static_cast<double>(i) * step);
  return ticks;
}

Series thin_out(const Series& series, size_t count) {
  const size_t n = series.x.size();
  if (n <= count) return series;
  Series thin{series.name, {}, {}};
  for (size_t i = 0; i < count; ++i) {
    const size_t first = i * n / count, last = (i + 1) * n / count;
    double x = 0, y = 0;
    for (size_t k = first; k < last; ++k) x += series.x[k], y += series.y[k];
    thin.x.push_back(x / static_cast<double>(last - first));
    thin.y.push_back(y / static_cast<double>(last - first));
  }
  return thin;
}

std::string chart_figure(const Chart& chart) {
  std::vector<Series> lines;
  for (const Series& series : chart.series) {
    Series line = drawable(series, chart.logarithmic);
    if (line.x.size() >= 2) lines.push_back(std::move(line));
  }
  if (lines.empty()) return "";
  const Frame frame = frame_of(lines, chart);
  std::string svg = axes(frame, chart);
  for (size_t i = 0; i < lines.size(); ++i) svg += line_path(lines[i], frame, i);
  return fmt::format(
      "<figure class=\"chart\"><figcaption>{}</figcaption>\n"
      "<svg viewBox=\"0 0 {:.0f} {:.0f}\" role=\"img\" aria-label=\"{}\">\n{}</svg>"
      "{}</figure>\n",
      escape(chart.title), kWidth, kHeight, escape(description(chart, lines)), svg, legend(lines));
}

}  // namespace tt3d::report
