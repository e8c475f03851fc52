#include "naturalness.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

namespace tt3d {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

constexpr int64_t kSmallestBox = 11;       ///< window of SSIM
constexpr double kLpipsSecondsAView = 60;  ///< two passes through VGG on a busy machine

/// [low, high) widened to the smallest box and moved into [0, size).
void widen(int64_t& low, int64_t& high, int64_t size) {
  low = std::clamp<int64_t>(low, 0, size);
  high = std::clamp<int64_t>(high, 0, size);
  const int64_t missing = std::min(kSmallestBox, size) - (high - low);
  if (missing > 0) {
    low = std::clamp<int64_t>(low - (missing + 1) / 2, 0, size - std::min(kSmallestBox, size));
    high = low + std::min(kSmallestBox, size);
  }
}

}  // namespace

PixelBox object_box(const Camera& camera, const Tensor& vertices) {
  const Tensor matrix =
      at::tensor(at::ArrayRef<double>(camera.camera_to_world.data(), 16), at::kDouble).view({4, 4});
  const Tensor seen = (vertices.to(at::kCPU, at::kDouble) - matrix.slice(0, 0, 3).select(1, 3))
                          .matmul(matrix.slice(0, 0, 3).slice(1, 0, 3));
  const Tensor depth = -seen.select(1, 2);
  if (depth.min().item<double>() <= 0) return {0, 0, camera.width, camera.height};
  const Tensor x = camera.cx + camera.fx * seen.select(1, 0) / depth;
  const Tensor y = camera.cy - camera.fy * seen.select(1, 1) / depth;
  const auto low = [](const Tensor& t) {
    return static_cast<int64_t>(std::floor(t.min().item<double>()));
  };
  const auto high = [](const Tensor& t) {
    return static_cast<int64_t>(std::ceil(t.max().item<double>()));
  };
  PixelBox box{low(x), low(y), high(x), high(y)};
  widen(box.left, box.right, camera.width);
  widen(box.top, box.bottom, camera.height);
  return box;
}

Naturalness::Naturalness(const EvaluateOptions& options, const TexturedMesh& asset)
    : options_(options), vertices_(asset.vertices) {
  if (!options.lpips.empty()) folder_ = std::make_unique<ExchangeFolder>();
}

void Naturalness::add(const Tensor& adversarial, const Tensor& clean, const Camera& camera) {
  const PixelBox box = object_box(camera, vertices_);
  const auto cut = [&](const Tensor& t) {
    return t.slice(0, box.top, box.bottom).slice(1, box.left, box.right);
  };
  psnr_ += psnr(adversarial, clean);
  ssim_ += ssim(adversarial, clean);
  psnr_box_ += psnr(cut(adversarial), cut(clean));
  ssim_box_ += ssim(cut(adversarial), cut(clean));
  if (folder_) {
    json pair = json::array();
    for (const auto& [name, picture] : {std::pair{"clean", clean}, {"adversarial", adversarial}}) {
      const fs::path file = *folder_ / (name + std::to_string(count_) + ".png");
      write_file_atomic(file, encode_png(to_uint8(picture.cpu())));
      pair.push_back(file.string());
    }
    pair.push_back({box.left, box.top, box.right, box.bottom});
    pairs_.push_back(pair);
  }
  ++count_;
}

void Naturalness::finish(EvalRecord& record, Progress& progress) const {
  const auto n = static_cast<double>(count_);
  record.psnr = psnr_ / n;
  record.ssim = ssim_ / n;
  record.psnr_box = psnr_box_ / n;
  record.ssim_box = ssim_box_ / n;
  if (!folder_) return;
  const fs::path list = *folder_ / "pairs.json", out = *folder_ / "lpips.json";
  write_file_atomic(list, pairs_.dump());
  (void)run_tool("perceptual.py",
                 {options_.lpips, options_.lpips_backbone.string(), list.string(), out.string()},
                 "lpips", 60 + kLpipsSecondsAView * n, progress);
  const json result = json::parse(read_file(out));
  record.lpips = result.at("lpips").get<double>();
  record.lpips_box = result.at("lpips_box").get<double>();
}

GeometryRecord compare_geometry(const TexturedMesh& clean, const TexturedMesh& adversarial,
                                double time_limit_seconds, Progress& progress) {
  const ExchangeFolder folder;
  const fs::path out = folder / "geometry.json";
  const fs::path before = folder / "clean.safetensors", after = folder / "adversarial.safetensors";
  save_mesh_tensors(clean, before);
  save_mesh_tensors(adversarial, after);
  (void)run_tool("geometry.py", {before.string(), after.string(), out.string()}, "geometry",
                 time_limit_seconds, progress);
  const json j = json::parse(read_file(out));
  return {j.at("chamfer"), j.at("hausdorff"), j.at("normal_deviation_deg"),
          j.at("self_intersecting_faces_adversarial"), j.at("self_intersecting_faces_clean")};
}

}  // namespace tt3d
