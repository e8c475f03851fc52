#include <fmt/format.h>

#include "tt3d/csv.h"
#include "tt3d/record.h"

namespace tt3d::record {

const std::vector<Column<CurvePoint>>& columns(const CurvePoint* /*row*/) {
  static const std::vector<Column<CurvePoint>> list = {
      {"loss", &CurvePoint::loss, "{:.6g}"},
      {"objective", &CurvePoint::objective, "{:.6g}"},
      {"rgb", &CurvePoint::rgb, "{:.6g}"},
      {"chamfer", &CurvePoint::chamfer, "{:.6g}"},
      {"laplacian", &CurvePoint::laplacian, "{:.6g}"},
      {"edge", &CurvePoint::edge, "{:.6g}"},
      {"success", &CurvePoint::success, "{:.4f}"}};
  return list;
}

const std::vector<Column<Epoch>>& columns(const Epoch* /*row*/) {
  static const std::vector<Column<Epoch>> list = {{"objective", &Epoch::objective, "{:.6g}"},
                                                  {"success", &Epoch::success, "{:.4f}"},
                                                  {"held_out", &Epoch::held_out, "{:.4f}"}};
  return list;
}

namespace {

template <typename Row>
std::string log_csv(const std::vector<Row>& rows) {
  const auto& list = columns(static_cast<const Row*>(nullptr));
  std::vector<std::string> cells = {"step"};
  for (const auto& column : list) cells.emplace_back(column.name);
  std::string text = csv_line(cells);
  for (const Row& row : rows) {
    cells = {std::to_string(row.step)};
    for (const auto& column : list) {
      cells.push_back(fmt::format(fmt::runtime(column.format), row.*column.member));
    }
    text += csv_line(cells);
  }
  return text;
}

}  // namespace

std::string curves_csv(const Curves& curves) { return log_csv(curves); }

std::string epochs_csv(const std::vector<Epoch>& epochs) { return log_csv(epochs); }

Curves load_curves(const std::filesystem::path& path) {
  const CsvTable csv = read_csv(path);
  Curves curves(csv.rows.size());
  const size_t step = csv.column("step");
  for (size_t i = 0; i < curves.size(); ++i) curves[i].step = csv.integer(i, step);
  for (const auto& column : columns()) {
    const size_t at = csv.column(column.name);
    for (size_t i = 0; i < curves.size(); ++i) curves[i].*column.member = csv.number(i, at);
  }
  return curves;
}

}  // namespace tt3d::record
