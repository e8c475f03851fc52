#include "naturalness.h"

#include "tt3d/asset.h"
#include "tt3d/image.h"
#include "tt3d/json.h"
#include "tt3d/scene.h"

#include <ATen/ATen.h>

namespace tt3d::evaluate {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

constexpr double kLpipsSecondsAView = 60;  ///< time of two passes through VGG on a busy machine

}  // namespace

PictureComparison::PictureComparison(const EvaluateOptions& options,
                                     const asset::TexturedMesh& asset)
    : options_(options), vertices_(asset.vertices) {
  if (options.measures_lpips()) folder_ = std::make_unique<ExchangeFolder>();
}

void PictureComparison::add(const Tensor& adversarial, const Tensor& clean,
                            const scene::Camera& camera) {
  const scene::PixelBox box = scene::object_box(camera, vertices_);
  const auto cut = [&](const Tensor& t) {
    return t.slice(0, box.top, box.bottom).slice(1, box.left, box.right);
  };
  psnr_ += image::psnr(adversarial, clean);
  ssim_ += image::ssim(adversarial, clean);
  psnr_box_ += image::psnr(cut(adversarial), cut(clean));
  ssim_box_ += image::ssim(cut(adversarial), cut(clean));
  if (folder_) {
    json pair = json::array();
    for (const auto& [name, picture] : {std::pair{"clean", clean}, {"adversarial", adversarial}}) {
      const fs::path file = *folder_ / (name + std::to_string(count_) + ".png");
      write_file_atomic(file, image::encode_png(image::to_uint8(picture.cpu())));
      pair.push_back(file.string());
    }
    pair.push_back({box.left, box.top, box.right, box.bottom});
    pairs_.push_back(pair);
  }
  ++count_;
}

record::NaturalnessRecord PictureComparison::finish(Progress& progress) const {
  const auto n = static_cast<double>(count_);
  record::NaturalnessRecord means;
  means.psnr = psnr_ / n;
  means.ssim = ssim_ / n;
  means.psnr_box = psnr_box_ / n;
  means.ssim_box = ssim_box_ / n;
  if (!folder_) return means;
  means.lpips_net = options_.lpips;
  const fs::path list = *folder_ / "pairs.json", out = *folder_ / "lpips.json";
  write_file_atomic(list, pairs_.dump());
  const fs::path backbone = options_.lpips_backbone.empty()
                                ? fs::path("models/lpips") / (options_.lpips + ".pth")
                                : options_.lpips_backbone;
  (void)run_tool("perceptual.py", {options_.lpips, backbone.string(), list.string(), out.string()},
                 "lpips", 60 + kLpipsSecondsAView * n, progress);
  const json document = read_json(out);
  const JsonValue result(document, out);
  means.lpips = result.at("lpips").as<double>();
  means.lpips_box = result.at("lpips_box").as<double>();
  return means;
}

record::GeometryRecord compare_geometry(const asset::TexturedMesh& clean,
                                        const asset::TexturedMesh& adversarial,
                                        double time_limit_seconds, Progress& progress) {
  const ExchangeFolder folder;
  const fs::path out = folder / "geometry.json";
  const fs::path before = folder / "clean.safetensors", after = folder / "adversarial.safetensors";
  asset::save_mesh_tensors(clean, before);
  asset::save_mesh_tensors(adversarial, after);
  (void)run_tool("geometry.py", {before.string(), after.string(), out.string()}, "geometry",
                 time_limit_seconds, progress);
  const json document = read_json(out);
  const JsonValue result(document, out);
  return {result.at("chamfer").as<double>(), result.at("hausdorff").as<double>(),
          result.at("normal_deviation_deg").as<double>(),
          result.at("self_intersecting_faces_adversarial").as<int64_t>(),
          result.at("self_intersecting_faces_clean").as<int64_t>()};
}

}  // namespace tt3d::evaluate
