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

/// Who makes the pictures.
struct RendererChoice {
  std::string name = "builtin";  ///< builtin, mitsuba, blender or meshlab
  bool lit = false;              ///< environment, sun and ground instead of the bare texture
  /// Rays a pixel; 0: 1 in the built-in renderer, lit 64 in Mitsuba and 8 in Blender, else 16. In
  /// the built-in one a square number (4: two by two), averaged in linear light. MeshLab has no
  /// choice.
  int samples = 0;
  double time_limit_seconds = 60;  ///< a view, in another renderer
};

/// Refuses a name that is not a renderer, and light or a number of samples that the built-in one
/// has not: InputError.
void check_renderer(const RendererChoice& renderer);
/// Rays a pixel that a choice stands for.
[[nodiscard]] int samples_of(const RendererChoice& renderer);

/// Means of `factor` by `factor` pixels of premultiplied sRGB pictures [N,H,W,4] in linear light,
/// as a camera takes them: [N,H/factor,W/factor,4], premultiplied again.
[[nodiscard]] at::Tensor average_pixels(const at::Tensor& pictures, int64_t factor);

/// Pictures of an asset from given views, by any renderer. Another renderer reads the file itself:
/// Blender the GLB or OBJ, Mitsuba and MeshLab, which know no GLB, an OBJ, written from what
/// load_asset gives unless the file is an OBJ of ours. It makes all pictures at construction, in
/// one child process.
class AssetViews {
 public:
  /// Throws InputError, MissingToolError (with the install command), ResourceError (failure, hang).
  AssetViews(const std::filesystem::path& path, const TexturedMesh& asset,
             std::vector<SampledView> views, const RendererChoice& renderer, at::Device device,
             Progress& progress);
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

/// The rectangle of pixels around the object in a view.
struct PixelBox {
  int64_t left = 0, top = 0, right = 0, bottom = 0;  ///< right and bottom are outside
};
/// Around the projections of all vertices [V,3], within the picture, 11 pixels a side or more, the
/// window of SSIM. The whole picture where a vertex is behind the camera.
[[nodiscard]] PixelBox object_box(const Camera& camera, const at::Tensor& vertices);

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
  RendererChoice renderer;
  std::string lpips;  ///< vgg, alex or squeeze: also LPIPS against the clean object; empty: none
  std::filesystem::path lpips_backbone;  ///< torchvision's weights of that network
  bool geometry = false;  ///< also Chamfer, Hausdorff, normals, self-intersections against clean
  double geometry_time_limit_seconds = 600;
};

/// Distances of the adversarial from the clean object, in the asset's units (geometry.py).
struct GeometryRecord {
  double chamfer = 0, hausdorff = 0, normal_deviation_deg = 0;
  int64_t self_intersecting_faces = 0, self_intersecting_faces_clean = 0;
};

/// Geometry of two assets compared, in a child process with a time limit. Throws MissingToolError
/// and ResourceError.
[[nodiscard]] GeometryRecord compare_geometry(const TexturedMesh& clean,
                                              const TexturedMesh& adversarial,
                                              double time_limit_seconds, Progress& progress);

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
  std::string renderer_version;
  ClassId target, true_class;
  std::vector<SampledView> views;
  std::vector<VictimRecord> victims;
  std::optional<double> psnr, ssim;          ///< over the frame, background included
  std::optional<double> psnr_box, ssim_box;  ///< over the rectangle around the object
  std::optional<double> lpips, lpips_box;
  std::optional<GeometryRecord> geometry;
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

/// A victim's shares, counted from its answers. `true_class` -1 and `has_clean` false leave the
/// figures about the clean object out.
void summarize(VictimRecord& victim, int64_t target, int64_t true_class, bool has_clean);
/// Appends a victim's answers to pictures [N,3,H,W] in [0,1], and to the clean ones if defined.
void answer(const Classifier& model, const at::Tensor& pictures, const at::Tensor& clean,
            int64_t target, int64_t true_class, std::vector<ViewAnswer>& answers);

/// Renders `count` views into a NeRF-synthetic capture: PNG files with alpha, transforms_test.json
/// and transforms_train.json (the same views), so that it can be read back as a capture.
void render_to_folder(const std::filesystem::path& asset, const std::string& distribution,
                      int64_t count, int size, uint64_t seed, const std::filesystem::path& out,
                      Progress& progress, at::Device device = at::kCPU,
                      const RendererChoice& renderer = {});

/// A video once around the object.
struct TurntableOptions {
  std::filesystem::path asset, out;  ///< out: .mp4
  double seconds = 6, elevation_deg = 15;
  int frames_per_second = 25, size = 480;
  int blur = 1;  ///< pictures that are averaged to a frame: an open shutter
  int crf = 20;  ///< of H.264: 18 hardly loses, 35 visibly
  std::string background = "white";
  uint64_t seed = 0;  ///< of the background
  RendererChoice renderer;
  at::Device device = at::kCPU;
};
/// Renders and encodes it (ffmpeg). Throws InputError, MissingToolError, ResourceError.
void render_turntable(const TurntableOptions& options, Progress& progress);

// ---- Videos -------------------------------------------------------------------------------

/// How success in a video is counted.
struct VideoOptions {
  std::filesystem::path video;
  std::string target, true_class;  ///< classes; true_class may be empty
  std::vector<std::string> victims;
  int64_t frames = 60;         ///< sampled evenly over the whole length
  std::string box;             ///< LEFT,TOP,WIDTH,HEIGHT in pixels of the upright frame; empty: all
  bool track = false;          ///< the box is that of the first frame, and is followed
  std::filesystem::path mask;  ///< picture; the box around its light pixels is taken
  std::filesystem::path backgrounds;  ///< CSV of start_seconds,end_seconds,label; empty: none
  double time_limit_seconds = 3600;
  at::Device device = at::kCPU;
};

/// A sampled frame.
struct VideoFrame {
  int64_t index = 0;  ///< in the video
  double seconds = 0;
  PixelBox box;
  std::string background;  ///< label; "" outside the table
  at::Tensor picture;      ///< [H,W,3] uint8, what the victims see, at most 320 pixels a side
};

struct VideoRecord {
  VideoOptions options;
  std::string video_sha256;
  int64_t width = 0, height = 0;  ///< upright
  double duration_seconds = 0;
  ClassId target, true_class;
  std::vector<VideoFrame> frames;
  std::vector<VictimRecord> victims;  ///< one answer a frame
};

/// Scores a video's frames. Frames are decoded one after the other by ffmpeg, so that memory does
/// not grow with the video. Throws InputError (no video, no frames, box outside, table),
/// MissingToolError and ResourceError.
[[nodiscard]] VideoRecord score_video(const VideoOptions& options, Progress& progress);
/// JSON with ASR by victim and by background label; and a CSV row a frame and victim.
[[nodiscard]] std::string video_json(const VideoRecord& record);
[[nodiscard]] std::string video_csv(const VideoRecord& record);
/// Writes FILE.json, FILE.csv, and up to 60 frames evenly as pictures into FILE.frames, which the
/// JSON's `strip` lists with the answers.
void write_video_record(const VideoRecord& record, const std::filesystem::path& json_path);

}  // namespace tt3d
