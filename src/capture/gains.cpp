#include "gains.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "tt3d/json.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

double to_linear(double v) { return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4); }
double to_srgb(double v) {
  return v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1 / 2.4) - 0.055;
}

std::array<uint8_t, 256> table_of(double gain) {
  std::array<uint8_t, 256> table{};
  for (size_t i = 0; i < table.size(); ++i) {
    const double level = to_srgb(std::min(1.0, gain * to_linear(static_cast<double>(i) / 255)));
    table[i] = static_cast<uint8_t>(std::lround(255 * level));
  }
  return table;
}

void apply(at::Tensor& rgba, const std::array<double, 3>& gain) {
  const std::array<std::array<uint8_t, 256>, 3> tables = {table_of(gain[0]), table_of(gain[1]),
                                                          table_of(gain[2])};
  rgba = rgba.contiguous();
  uint8_t* p = rgba.data_ptr<uint8_t>();
  for (int64_t i = 0; i < rgba.numel() / 4; ++i, p += 4) {
    for (size_t c = 0; c < 3; ++c) p[c] = tables[c][p[c]];
  }
}

}  // namespace

bool apply_gains(const fs::path& folder, const std::vector<RawView>& raw,
                 std::vector<LoadedView>& views) {
  const fs::path path = folder / "gains.json";
  if (!fs::exists(path)) return false;
  const nlohmann::json document = read_json(path);
  const JsonValue gains(document, path);
  for (size_t i = 0; i < raw.size(); ++i) {
    const std::string name = raw[i].image.filename().string();
    if (!gains.has(name)) continue;
    const auto gain = gains.at(name).as<std::array<double, 3>>();
    for (const double g : gain) {
      if (!(g >= 0.1 && g <= 10)) gains.at(name).fail("expected factors from 0.1 to 10");
    }
    apply(views[i].view.rgba, gain);
  }
  return true;
}

}  // namespace tt3d::capture
