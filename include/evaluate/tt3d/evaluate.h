#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tt3d/asset.h"
#include "tt3d/core.h"
#include "tt3d/keys.h"
#include "tt3d/model.h"
#include "tt3d/record.h"
#include "tt3d/scene.h"

/// Evaluates exported assets: loads them from disk, renders held-out random views, and scores
/// victims. Success is measured here, on the exported files, never inside the attack.
namespace tt3d::evaluate {

// ---- Rendering of assets ------------------------------------------------------------------

/// The built-in renderer: unlit pictures of an asset, [N,H,W,4], premultiplied colour and alpha,
/// with trilinear texture look-up and antialiased silhouettes. All cameras have the same picture
/// size.
class AssetRenderer {
 public:
  /// Renders on `device`; the pictures are on this device.
  explicit AssetRenderer(const asset::TexturedMesh& asset, at::Device device = at::kCPU);
  [[nodiscard]] at::Tensor render(const std::vector<scene::Camera>& cameras) const;

 private:
  asset::TexturedMesh asset_;
  at::Tensor texels_;  ///< [H,W,3] float
  at::Tensor twins_;
  at::Tensor corner_uvs_, corner_faces_, corner_index_;  ///< for texture derivatives
  double extent_ = 1;
};

/// Programs that render assets.
enum class RendererName { kBuiltin, kMitsuba, kBlender, kMeshlab };
[[nodiscard]] constexpr std::array<std::string_view, 4> enum_names(RendererName) {
  return {"builtin", "mitsuba", "blender", "meshlab"};
}

/// The renderer and its settings.
struct RendererChoice {
  RendererName name = RendererName::kBuiltin;
  bool lit = false;
  int samples = 0;
  double time_limit_seconds = 60;

  void keys(KeyList& key) {
    key("renderer", name, "program that renders the pictures");
    key("lit", lit,
        "with environment light, sun and ground; the built-in renderer shows the texture unlit "
        "only");
    samples_key(key);
    key("view_time_limit", time_limit_seconds, {1e-3, 1e6}, "seconds",
        "time limit per view of the other renderers");
  }
  void samples_key(KeyList& key) {
    key("samples", samples, {0, 65536}, "",
        "samples per pixel, averaged in linear light; the built-in renderer takes a square number "
        "of "
        "at most 64; 0: 1 in the built-in renderer, with light 64 in Mitsuba and 8 in Blender, "
        "else 16");
  }
};

/// Throws InputError if the built-in renderer does not support lighting or that sample count.
void check_renderer(const RendererChoice& renderer);
/// Samples per pixel; `samples` = 0 gives the default of the renderer.
[[nodiscard]] int samples_of(const RendererChoice& renderer);

/// Pictures of an asset from given views, by any renderer. The other renderers read a file: Blender
/// the GLB or OBJ itself, Mitsuba and MeshLab an OBJ. This OBJ is written from the loaded asset,
/// unless the file is an OBJ of tt3d. The other renderers make all pictures in the constructor, in
/// one child process.
class AssetViews {
 public:
  /// Throws InputError, MissingToolError (with the install command), ResourceError (failure, hang).
  AssetViews(const std::filesystem::path& path, const asset::TexturedMesh& asset,
             std::vector<scene::SampledView> views, const RendererChoice& renderer,
             at::Device device, Progress& progress);
  ~AssetViews();
  AssetViews(AssetViews&&) noexcept;
  AssetViews& operator=(AssetViews&&) noexcept;
  /// Views [begin,end): [N,H,W,4], premultiplied colour and alpha, in [0,1].
  [[nodiscard]] at::Tensor render(int64_t begin, int64_t end) const;
  /// Version of the renderer.
  [[nodiscard]] const std::string& version() const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

// ---- Evaluation ---------------------------------------------------------------------------

struct EvaluateOptions {
  std::filesystem::path asset;
  std::filesystem::path clean;   ///< the object before the attack; empty: no figures about it
  std::string target;            ///< class: index, WordNet id or name (find_class)
  uint64_t seed = 0;             ///< views come from a stream that training does not use
  at::Device device = at::kCPU;  ///< device of the renderer and the victims
  double geometry_time_limit_seconds = 600;

  std::string true_class;
  std::vector<std::string> victims;
  int64_t views = 100;
  scene::ViewDistribution view_distribution = scene::ViewDistribution::kDome;
  int size = 400;
  std::string background = "white";
  RendererChoice renderer;
  bool geometry = false;
  std::string lpips = "none";            ///< network of LPIPS against the clean object
  std::filesystem::path lpips_backbone;  ///< empty: models/lpips/NET.pth
  [[nodiscard]] bool measures_lpips() const { return lpips != "none"; }

  void keys(KeyList& key) {
    key("true_class", true_class,
        "true class of the object; an untargeted attack avoids it; empty: no accuracy "
        "figures");
    key("victims", victims, "models that are scored");
    key("views", views, {1, 1e6}, "", "held-out random views");
    key("view_distribution", view_distribution, "distribution of the random views");
    key("size", size, {16, 8192}, "pixels", "side of the pictures");
    key("background", background, "white, #rrggbb or a folder of photographs");
    key("geometry", geometry,
        "also compares shapes with the clean object (needs scripts/setup --all)");
    key.one_of("lpips", lpips, {"none", "vgg", "alex", "squeeze"},
               "network of LPIPS against the clean object (needs scripts/setup --all)");
    key("lpips_backbone", lpips_backbone,
        "torchvision's weights of that network; empty: models/lpips/NET.pth");
    renderer.samples_key(key);
  }
};

/// Compares the geometry of two assets, in a child process with a time limit. Throws
/// MissingToolError and ResourceError.
[[nodiscard]] record::GeometryRecord compare_geometry(const asset::TexturedMesh& clean,
                                                      const asset::TexturedMesh& adversarial,
                                                      double time_limit_seconds,
                                                      Progress& progress);

/// The views of evaluations and renderings. Their random stream is never one of training, for any
/// seed.
[[nodiscard]] std::vector<scene::SampledView> evaluation_views(scene::ViewDistribution distribution,
                                                               uint64_t seed, int64_t count,
                                                               int size,
                                                               const scene::ViewFrame& frame);

/// Composites views [begin,end) over their backgrounds: [N,3,H,W] in [0,1], rounded to 8 bits as in
/// a PNG. Background i depends on (seed, i) alone.
[[nodiscard]] at::Tensor pictures_over(const AssetViews& views,
                                       const scene::Backgrounds& background, int64_t begin,
                                       int64_t end, uint64_t seed);

/// Runs an evaluation. `assets` loads each file once. Throws InputError (files, classes, models).
[[nodiscard]] record::EvaluationRecord evaluate_asset(const EvaluateOptions& options,
                                                      asset::AssetFiles& assets,
                                                      Progress& progress);

/// Appends the answers of a victim to pictures [N,3,H,W] in [0,1], and to the clean pictures if
/// defined. `target` and `true_class`: indices in the labels of this victim.
void answer(const model::Classifier& model, const at::Tensor& pictures, const at::Tensor& clean,
            int64_t target, std::optional<int64_t> true_class,
            std::vector<record::ViewAnswer>& answers);

// ---- Pictures and videos of an asset ------------------------------------------------------

/// Renders views into a NeRF-synthetic capture: PNG files with alpha, transforms_test.json and
/// transforms_train.json (the same views). load_capture can read it. Uses the asset, views and
/// renderer of `options`.
void render_to_folder(const EvaluateOptions& options, const std::filesystem::path& out,
                      Progress& progress);

/// Options of a video that goes once around the object.
struct TurntableOptions {
  std::filesystem::path asset, out;  ///< out: a file .mp4
  double seconds = 6, elevation_deg = 15;
  int frames_per_second = 25, size = 480;
  int blur = 1;  ///< pictures averaged per frame (motion blur)
  int crf = 20;  ///< compression of H.264: 18 loses little, 35 visibly
  std::string background = "white";
  uint64_t seed = 0;  ///< seed of the background
  RendererChoice renderer;
  at::Device device = at::kCPU;
};
/// Renders and encodes the video (ffmpeg). Throws InputError, MissingToolError, ResourceError.
void render_turntable(const TurntableOptions& options, Progress& progress);

// ---- Videos -------------------------------------------------------------------------------

/// Options of scoring a video.
struct VideoOptions {
  std::filesystem::path video;
  std::string target, true_class;  ///< classes; true_class may be empty
  std::vector<std::string> victims;
  int64_t frames = 60;         ///< sampled evenly over the whole length
  std::string box;             ///< LEFT,TOP,WIDTH,HEIGHT in pixels of the upright frame; empty: all
  bool track = false;          ///< true: the box belongs to the first frame, and a tracker follows
                               ///< it
  std::filesystem::path mask;  ///< picture; the box is that of its light pixels
  std::filesystem::path backgrounds;  ///< CSV of start_seconds,end_seconds,label; empty: none
  double time_limit_seconds = 3600;
  at::Device device = at::kCPU;
};

/// A sampled frame.
struct VideoFrame {
  int64_t index = 0;  ///< index in the video
  double seconds = 0;
  scene::PixelBox box;
  std::string background;  ///< label from the table; "" if no row covers the time
  at::Tensor picture;      ///< [H,W,3] uint8, the crop that victims get, at most 320 pixels a side
};

/// A record, and the data of its CSV file and pictures.
struct ScoredVideo {
  record::VideoRecord record;
  std::vector<VideoFrame> frames;
  std::vector<std::vector<record::ViewAnswer>> answers;  ///< [victim][frame]
};

/// Scores frames of a video. ffmpeg decodes them one after the other, so memory does not grow with
/// the length of the video. Throws InputError (no video, no frames, box outside the frame,
/// malformed table), MissingToolError and ResourceError.
[[nodiscard]] ScoredVideo score_video(const VideoOptions& options, Progress& progress);
/// Writes FILE.json, FILE.csv with a row for each victim and frame, and up to 60 frames as pictures
/// into FILE.frames. The `strip` of the record lists these pictures with the answers.
void save(ScoredVideo& video, const std::filesystem::path& json_path);

}  // namespace tt3d::evaluate
