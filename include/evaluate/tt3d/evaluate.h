#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tt3d/bake.h"
#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/model.h"

/// Judges exported assets: loads them back from disk, renders held-out random views, scores
/// victims. Success is counted here, on what ships, never inside the attack.
namespace tt3d {

// ---- Rendering of assets ------------------------------------------------------------------

/// What a view distribution is scaled by for an asset, in its units: read from `views.json` beside
/// it, which a run writes from its capture, else from the asset's bounding box.
[[nodiscard]] ViewFrame asset_view_frame(const TexturedMesh& asset,
                                         const std::filesystem::path& asset_path);
/// Writes `views.json` into the folder of the assets.
void write_view_frame(const ViewFrame& frame, const std::filesystem::path& folder);

/// Unlit pictures of an asset by the built-in renderer: [N,H,W,4], premultiplied colour and alpha,
/// trilinear texture look-up, antialiased silhouettes. Cameras share one picture size.
class AssetRenderer {
 public:
  /// Renders on `device`, where the pictures come from too.
  explicit AssetRenderer(const TexturedMesh& asset, at::Device device = at::kCPU);
  [[nodiscard]] at::Tensor render(const std::vector<Camera>& cameras) const;

 private:
  TexturedMesh asset_;
  at::Tensor texels_;  ///< [H,W,3] float
  at::Tensor twins_;
  at::Tensor corner_uvs_, corner_faces_, corner_index_;  ///< for texture derivatives
  double extent_ = 1;
};

// ---- Measures -----------------------------------------------------------------------------

/// Peak signal-to-noise ratio of pictures [H,W,C] in [0,1], dB; 100 when equal.
[[nodiscard]] double psnr(const at::Tensor& a, const at::Tensor& b);
/// Structural similarity (Wang et al. 2004): Gaussian window of sigma 1.5 over 11 pixels, mean
/// over colours and over the pixels whose window lies inside. [H,W,C] in [0,1].
[[nodiscard]] double ssim(const at::Tensor& a, const at::Tensor& b);
/// Wilson's 95 % interval of k successes in n.
struct Interval {
  double low = 0, high = 0;
};
[[nodiscard]] Interval wilson_interval(int64_t successes, int64_t n);

// ---- Evaluation ---------------------------------------------------------------------------

struct EvaluateOptions {
  std::filesystem::path asset;
  std::filesystem::path clean;  ///< empty: no clean figures
  std::string target;           ///< class, as find_class takes it
  std::string true_class;       ///< empty: no accuracy figures
  std::vector<std::string> victims;
  int64_t views = 100;
  std::string view_distribution = "dome";
  int size = 400;
  std::string background = "white";
  uint64_t seed = 0;  ///< views are drawn from a stream of their own, apart from training's
  at::Device device = at::kCPU;  ///< where pictures are rendered and victims run
};

/// A victim's answer to one view.
struct ViewAnswer {
  int64_t top1 = -1;
  std::string top1_name;
  double p_top1 = 0, p_target = 0, p_true = 0;
  int64_t clean_top1 = -1;
};

struct VictimRecord {
  std::string name, sha256;
  double asr = 0, mean_target_probability = 0;
  Interval asr_ci95;
  std::optional<double> clean_accuracy, asr_on_correct;
  int64_t clean_n = 0, asr_on_correct_n = 0;
  std::vector<ViewAnswer> answers;  ///< one a view
};

struct EvalRecord {
  EvaluateOptions options;
  std::string asset_sha256;
  ClassId target, true_class;
  std::vector<SampledView> views;
  std::vector<VictimRecord> victims;
  std::optional<double> psnr, ssim;
  double wall_seconds = 0;
};

/// The views that evaluations and renderings draw: of a stream apart from training's, whatever the
/// seed.
[[nodiscard]] std::vector<SampledView> evaluation_views(const std::string& distribution,
                                                        uint64_t seed, int64_t count, int size,
                                                        const ViewFrame& frame);

/// Evaluates. Throws InputError (files, classes, models).
[[nodiscard]] EvalRecord evaluate_asset(const EvaluateOptions& options, Progress& progress);

/// The evaluation record of the contract as JSON text, and the per-view rows as CSV.
[[nodiscard]] std::string record_json(const EvalRecord& record);
[[nodiscard]] std::string record_csv(const EvalRecord& record);
/// Writes FILE.json and FILE.csv.
void write_record(const EvalRecord& record, const std::filesystem::path& json_path);

/// Renders `count` views into a NeRF-synthetic capture: PNG files with alpha, transforms_test.json
/// and transforms_train.json (the same views), so that it can be read back as a capture.
void render_to_folder(const std::filesystem::path& asset, const std::string& distribution,
                      int64_t count, int size, uint64_t seed, const std::filesystem::path& out,
                      Progress& progress, at::Device device = at::kCPU);

}  // namespace tt3d
