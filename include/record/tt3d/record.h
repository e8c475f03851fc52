#pragma once

#include <concepts>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "tt3d/json.h"

/// Records: the measurements of a run as plain structs. Each struct has one function that names its
/// members; it serves reading and writing of JSON (tt3d/json.h). Report and comparison use these
/// structs alone.
namespace tt3d::record {

/// `S` is `T` or `const T`, so that one `members` function reads and writes.
template <typename S, typename T>
concept Is = std::same_as<std::remove_const_t<S>, T>;

/// A class of a model.
struct ClassId {
  int64_t index = -1;
  std::string wnid;  ///< WordNet id; empty if the model has none
  std::string name;  ///< synonyms, separated by ", "
};
template <typename V, Is<ClassId> S>
void members(V& visit, S& c) {
  visit("index", c.index);
  visit.optional("wnid", c.wnid);
  visit("name", c.name);
}

/// A 95 % confidence interval; in JSON a list [low, high].
struct Interval {
  double low = 0, high = 0;
};
void to_json(nlohmann::json& to, const Interval& interval);
void read(const JsonValue& from, Interval& to);

/// Wilson's 95 % interval for `successes` in `n` trials.
[[nodiscard]] Interval wilson_interval(int64_t successes, int64_t n);

/// The renderer of the pictures.
struct RendererRecord {
  std::string name;
  std::optional<std::string> version;
  bool lit = false;
  std::optional<int64_t> samples;  ///< samples per pixel
};
template <typename V, Is<RendererRecord> S>
void members(V& visit, S& r) {
  visit("name", r.name);
  visit("version", r.version);
  visit.optional("lit", r.lit);
  visit("samples", r.samples);
}

/// The views of an evaluation.
struct ViewsRecord {
  std::string distribution;
  int64_t count = 0;
  uint64_t seed = 0;
  std::optional<int64_t> size;  ///< side of the pictures, pixels
};
template <typename V, Is<ViewsRecord> S>
void members(V& visit, S& v) {
  visit("distribution", v.distribution);
  visit("count", v.count);
  visit("seed", v.seed);
  visit("size", v.size);
}

// ---- Evaluation ---------------------------------------------------------------------------

/// The answer of a victim for one view; a row of the CSV file of the record.
struct ViewAnswer {
  int64_t top1 = -1;
  std::string top1_name;
  double p_top1 = 0, p_target = 0;
  std::optional<double> p_true;       ///< present if a true class was given
  std::optional<int64_t> clean_top1;  ///< present if a clean object was given
};

/// A view of the evaluation; part of a row of the CSV file.
struct ViewPose {
  double azimuth_deg = 0, elevation_deg = 0, distance = 0, roll_deg = 0;
};

/// The answers of one model for all views, and their figures.
struct VictimRecord {
  std::string name, sha256;
  std::optional<ClassId> target, true_class;  ///< in the labels of this model
  double asr = 0;  ///< attack success rate: share of views assigned to the target
  Interval asr_ci95;
  double mean_target_probability = 0;
  std::optional<double> clean_accuracy;  ///< share of clean views assigned to the true class
  int64_t clean_n = 0;
  std::optional<double> asr_on_correct;  ///< success among the views whose clean picture is
                                         ///< classified correctly
  int64_t asr_on_correct_n = 0;
  std::vector<ViewAnswer> answers;  ///< one per view; stored in the CSV file
};
template <typename V, Is<VictimRecord> S>
void members(V& visit, S& v) {
  visit("name", v.name);
  visit("sha256", v.sha256);
  visit("target", v.target);
  visit("true_class", v.true_class);
  visit("clean_accuracy", v.clean_accuracy);
  visit("clean_n", v.clean_n);
  visit("asr", v.asr);
  visit("asr_ci95", v.asr_ci95);
  visit("asr_on_correct", v.asr_on_correct);
  visit("asr_on_correct_n", v.asr_on_correct_n);
  visit("mean_target_probability", v.mean_target_probability);
}

/// Computes the figures of a victim from its answers; `target` and `true_class` are indices in its
/// labels. Without `true_class` or clean answers, the
/// figures about the clean object stay empty.
void summarize(VictimRecord& victim, int64_t target, std::optional<int64_t> true_class);

/// Similarity to the clean object, means over the views.
struct NaturalnessRecord {
  std::optional<double> psnr, ssim, lpips;              ///< over the frame, background included
  std::optional<double> psnr_box, ssim_box, lpips_box;  ///< over the rectangle around the object
  std::string lpips_net;                                ///< vgg, alex or squeeze; empty: none
};
template <typename V, Is<NaturalnessRecord> S>
void members(V& visit, S& n) {
  visit("psnr", n.psnr);
  visit("ssim", n.ssim);
  visit("lpips", n.lpips);
  visit("lpips_net", n.lpips_net);
  visit("psnr_box", n.psnr_box);
  visit("ssim_box", n.ssim_box);
  visit("lpips_box", n.lpips_box);
}

/// Distances between the adversarial and the clean shape, in the units of the asset.
struct GeometryRecord {
  double chamfer = 0, hausdorff = 0, normal_deviation_deg = 0;
  int64_t self_intersecting_faces = 0, self_intersecting_faces_clean = 0;
};
template <typename V, Is<GeometryRecord> S>
void members(V& visit, S& g) {
  visit("chamfer", g.chamfer);
  visit("hausdorff", g.hausdorff);
  visit("normal_deviation_deg", g.normal_deviation_deg);
  visit("self_intersecting_faces", g.self_intersecting_faces);
  visit("self_intersecting_faces_clean", g.self_intersecting_faces_clean);
}

/// The result of `tt3d evaluate`: FILE.json, and the answers for each view in FILE.csv.
struct EvaluationRecord {
  std::string asset, asset_sha256;
  ClassId target;  ///< of the first victim; each victim has its own
  std::optional<ClassId> true_class;
  RendererRecord renderer;
  std::string background;
  ViewsRecord views;
  std::vector<VictimRecord> victims;
  NaturalnessRecord naturalness;
  std::optional<GeometryRecord> geometry;
  std::string tt3d_version;
  double wall_seconds = 0;
  std::vector<ViewPose> poses;  ///< one per view; stored in the CSV file
};
template <typename V, Is<EvaluationRecord> S>
void members(V& visit, S& r) {
  visit("asset", r.asset);
  visit("asset_sha256", r.asset_sha256);
  visit("target", r.target);
  visit("true_class", r.true_class);
  visit("renderer", r.renderer);
  visit("background", r.background);
  visit("views", r.views);
  visit("victims", r.victims);
  visit("naturalness", r.naturalness);
  visit("geometry", r.geometry);
  visit("tt3d_version", r.tt3d_version);
  visit("wall_seconds", r.wall_seconds);
}

/// Writes FILE.json, and FILE.csv with a row for each victim and view.
void save(const EvaluationRecord& record, const std::filesystem::path& json_path);
/// Reads FILE.json and, if it exists, FILE.csv. Throws InputError if a file is malformed.
[[nodiscard]] EvaluationRecord load_evaluation(const std::filesystem::path& json_path);

// ---- Videos -------------------------------------------------------------------------------

/// Success in some frames of a video.
struct FrameShare {
  int64_t frames = 0;
  double asr = 0;
  Interval asr_ci95;
};
template <typename V, Is<FrameShare> S>
void members(V& visit, S& f) {
  visit("frames", f.frames);
  visit("asr", f.asr);
  visit("asr_ci95", f.asr_ci95);
}

/// The success of one model in the frames of a video.
struct VideoVictim {
  std::string name, sha256;
  std::optional<ClassId> target;  ///< in the labels of this model
  FrameShare all;
  double mean_target_probability = 0;
  std::map<std::string, FrameShare> backgrounds;  ///< by label; "" for frames without a label
};
template <typename V, Is<VideoVictim> S>
void members(V& visit, S& v) {
  visit("name", v.name);
  visit("sha256", v.sha256);
  visit("target", v.target);
  members(visit, v.all);
  visit("mean_target_probability", v.mean_target_probability);
  visit("backgrounds", v.backgrounds);
}

/// The answer of a model for one picture.
struct Answer {
  std::string victim;      ///< name of the model
  std::string answer;      ///< its most probable class
  double probability = 0;  ///< probability of this class
  bool is_target = false;  ///< true if the answer is the target class
};
template <typename V, Is<Answer> S>
void members(V& visit, S& a) {
  visit("victim", a.victim);
  visit("answer", a.answer);
  visit("probability", a.probability);
  visit("is_target", a.is_target);
}

/// A frame that is saved as a picture in FILE.frames, beside the record.
struct StripFrame {
  std::string picture;  ///< file name
  double seconds = 0;
  std::string background;  ///< label; may be empty
  std::vector<Answer> answers;
};
template <typename V, Is<StripFrame> S>
void members(V& visit, S& f) {
  visit("picture", f.picture);
  visit("seconds", f.seconds);
  visit("background", f.background);
  visit("answers", f.answers);
}

/// The result of `tt3d video-score`.
struct VideoRecord {
  std::string video, video_sha256;
  int64_t width = 0, height = 0;  ///< size of the upright frame, pixels
  double duration_seconds = 0;
  ClassId target;  ///< of the first victim; each victim has its own
  int64_t frames = 0;
  std::vector<VideoVictim> victims;
  std::optional<std::vector<StripFrame>> strip;
  std::string tt3d_version;
};
template <typename V, Is<VideoRecord> S>
void members(V& visit, S& r) {
  visit("video", r.video);
  visit("video_sha256", r.video_sha256);
  visit("width", r.width);
  visit("height", r.height);
  visit("duration_seconds", r.duration_seconds);
  visit("target", r.target);
  visit("frames", r.frames);
  visit("victims", r.victims);
  visit("strip", r.strip);
  visit("tt3d_version", r.tt3d_version);
}

// ---- Other tasks --------------------------------------------------------------------------

/// The result of `tt3d judge`.
struct JudgeRecord {
  std::string task;                       ///< detect, caption or zeroshot
  std::string model;                      ///< folder of the model
  std::map<std::string, double> shares;   ///< share of views in which each phrase was found
  std::optional<nlohmann::json> answers;  ///< the unchanged answer of the model for each view
  std::string asset;
  RendererRecord renderer;
  std::string background;
  ViewsRecord views;
};
template <typename V, Is<JudgeRecord> S>
void members(V& visit, S& r) {
  visit("task", r.task);
  visit("model", r.model);
  visit("shares", r.shares);
  visit("answers", r.answers);
  visit("asset", r.asset);
  visit("renderer", r.renderer);
  visit("background", r.background);
  visit("views", r.views);
}

// ---- Curves -------------------------------------------------------------------------------

/// One step of an attack.
struct CurvePoint {
  int64_t step = 0;
  double loss = 0, objective = 0, rgb = 0, chamfer = 0, laplacian = 0, edge = 0;
  double success = 0;  ///< share of pictures on which the attack succeeds, mean over the surrogates
};

/// A column of a log: its name, its member, and its number format in the CSV file.
template <typename Row>
struct Column {
  const char* name;
  double Row::*member;
  const char* format;
};
/// The columns of a log after `step`. Charts, files and checkpoints use this list.
[[nodiscard]] const std::vector<Column<CurvePoint>>& columns(const CurvePoint* = nullptr);

/// The log of an attack, one row per step.
using Curves = std::vector<CurvePoint>;

/// One epoch of an attack.
struct Epoch {
  int64_t step = 0;                   ///< steps so far
  double objective = 0, success = 0;  ///< means over the epoch's steps
  double held_out = 0;                ///< success on held-out views, mean over the surrogates
};
[[nodiscard]] const std::vector<Column<Epoch>>& columns(const Epoch*);

/// Writes a log as CSV text, and reads it.
[[nodiscard]] std::string curves_csv(const Curves& curves);
[[nodiscard]] std::string epochs_csv(const std::vector<Epoch>& epochs);
[[nodiscard]] Curves load_curves(const std::filesystem::path& csv);

// ---- Stages -------------------------------------------------------------------------------

/// A finished stage of a run.
struct StageRecord {
  std::string name;
  double seconds = 0;
  int64_t peak_rss_bytes = 0;
  std::optional<uint64_t> seed;               ///< absent in runs before version 0.3
  std::map<std::string, std::string> inputs;  ///< SHA-256 by file, of the files that it read
};
template <typename V, Is<StageRecord> S>
void members(V& visit, S& s) {
  visit("name", s.name);
  visit("seconds", s.seconds);
  visit("peak_rss_bytes", s.peak_rss_bytes);
  visit("seed", s.seed);
  visit.optional("inputs", s.inputs);
}

/// Quality of a field compared with the photographs: field/metrics.json.
struct FieldMetrics {
  double psnr_test = 0;
  int64_t test_views = 0;
};
template <typename V, Is<FieldMetrics> S>
void members(V& visit, S& m) {
  visit("psnr_test", m.psnr_test);
  visit("test_views", m.test_views);
}

/// A mesh and its quality compared with the photographs: mesh/metrics.json.
struct MeshMetrics {
  int64_t faces = 0, vertices = 0, components = 0, non_manifold_edges = 0, euler = 0;
  bool closed = false;
  std::optional<double> psnr_test;  ///< absent for an imported asset
};
template <typename V, Is<MeshMetrics> S>
void members(V& visit, S& m) {
  visit("faces", m.faces);
  visit("vertices", m.vertices);
  visit("closed", m.closed);
  visit("non_manifold_edges", m.non_manifold_edges);
  visit("components", m.components);
  visit("euler", m.euler);
  visit("psnr_test", m.psnr_test);
}

/// Quality of the exported clean asset compared with the photographs: asset/metrics.json.
struct AssetMetrics {
  double psnr_test = 0;
};
template <typename V, Is<AssetMetrics> S>
void members(V& visit, S& m) {
  visit("psnr_test", m.psnr_test);
}

/// run.json: the configuration of a run and its finished stages.
struct RunRecord {
  std::map<std::string, nlohmann::json> config;  ///< every key with its typed value
  std::set<std::string> given;                   ///< keys that a file or the user set
  uint64_t seed = 0;
  std::map<std::string, std::string> versions;
  std::optional<int64_t> threads;
  std::optional<std::string> device;
  std::map<std::string, std::string> inputs;  ///< SHA-256 by file, of all stages
  std::vector<StageRecord> stages;            ///< finished
  std::optional<StageRecord> unfinished;      ///< the stage that runs or was interrupted
  /// Names of the attack's surrogates, without folder and extension.
  [[nodiscard]] std::vector<std::string> surrogates() const;
};
template <typename V, Is<RunRecord> S>
void members(V& visit, S& r) {
  visit("config", r.config);
  visit.optional("given", r.given);
  visit("seed", r.seed);
  visit("versions", r.versions);
  visit("threads", r.threads);
  visit("device", r.device);
  visit("inputs", r.inputs);
  visit("stages", r.stages);
  visit("unfinished", r.unfinished);
}

// ---- Folders ------------------------------------------------------------------------------

/// The records of a folder by kind, sorted by file name.
struct Records {
  std::vector<EvaluationRecord> evaluations;
  std::vector<JudgeRecord> judges;
  std::vector<std::pair<std::filesystem::path, VideoRecord>> videos;
};
/// Reads the records of a folder, except the file named `without`. The members decide the kind of a
/// record: `renderer` and `victims`, `task` and `shares`, or `video` and `victims`. Ignores other
/// JSON files. Throws InputError if a record is malformed.
[[nodiscard]] Records load_records(const std::filesystem::path& folder,
                                   const std::string& without = "");

}  // namespace tt3d::record
