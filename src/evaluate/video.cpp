#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "tt3d/csv.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/tool.h"
#include "tt3d/version.h"

namespace tt3d::evaluate {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

/// A row of the table of backgrounds.
struct Labelled {
  double begin = 0, end = 0;
  std::string label;
};

std::vector<Labelled> read_backgrounds(const fs::path& path) {
  std::vector<Labelled> table;
  if (path.empty()) return table;
  const CsvTable csv = parse_csv(read_file(path), path, {"start_seconds", "end_seconds", "label"});
  for (size_t i = 0; i < csv.rows.size(); ++i) {
    Labelled row = {csv.number(i, 0), csv.number(i, 1), csv.rows[i][2]};
    row.label.erase(0, row.label.find_first_not_of(' '));
    if (row.label.empty() || !(row.end > row.begin)) {
      throw InputError(path, csv.lines[i],
                       "expected start_seconds,end_seconds,label with start < end");
    }
    table.push_back(row);
  }
  return table;
}

std::string label_at(const std::vector<Labelled>& table, double seconds) {
  for (const Labelled& row : table) {
    if (seconds >= row.begin && seconds < row.end) return row.label;
  }
  return "";
}

/// Runs the extraction and returns its JSON.
json extract(const VideoOptions& o, const ExchangeFolder& folder, Progress& progress) {
  const json job = {{"video", fs::absolute(o.video).string()},
                    {"frames", o.frames},
                    {"box", o.box},
                    {"track", o.track},
                    {"mask", o.mask.empty() ? "" : fs::absolute(o.mask).string()},
                    {"folder", folder.path().string()},
                    {"time_limit", o.time_limit_seconds},
                    {"out", (folder / "frames.json").string()}};
  write_file_atomic(folder / "job.json", job.dump());
  (void)run_tool("video_frames.py", {(folder / "job.json").string()}, "video", o.time_limit_seconds,
                 progress);
  return read_json(folder / "frames.json");
}

/// Success in some frames.
record::FrameShare share(const std::vector<record::ViewAnswer>& answers,
                         const std::vector<size_t>& frames, int64_t target) {
  int64_t hits = 0;
  for (const size_t i : frames) hits += answers[i].top1 == target;
  const auto n = static_cast<int64_t>(frames.size());
  return {n, n == 0 ? 0 : static_cast<double>(hits) / static_cast<double>(n),
          record::wilson_interval(hits, n)};
}

/// Indices of the frames that are saved as pictures: evenly spaced, at most as many as a page can
/// show.
std::vector<size_t> strip_frames(size_t count) {
  constexpr size_t kStrip = 60;
  std::vector<size_t> chosen;
  for (size_t i = 0; i < std::min(kStrip, count); ++i) {
    chosen.push_back(i * count / std::min(kStrip, count));
  }
  return chosen;
}

/// Saves some frames as pictures in `folder`; returns them with the answers.
std::vector<record::StripFrame> write_strip(const ScoredVideo& video, const fs::path& folder) {
  make_folder(folder);
  std::vector<record::StripFrame> strip;
  for (const size_t i : strip_frames(video.frames.size())) {
    const VideoFrame& f = video.frames[i];
    record::StripFrame frame = {fmt::format("{:05}.jpg", i), f.seconds, f.background, {}};
    write_file_atomic(folder / frame.picture, image::encode_jpeg(f.picture));
    for (size_t m = 0; m < video.answers.size(); ++m) {
      const record::ViewAnswer& a = video.answers[m][i];
      const record::VideoVictim& victim = video.record.victims[m];
      frame.answers.push_back({victim.name, a.top1_name, a.p_top1, a.top1 == victim.target->index});
    }
    strip.push_back(std::move(frame));
  }
  return strip;
}

std::string frames_csv(const ScoredVideo& video) {
  std::string text =
      csv_line({"victim", "frame", "seconds", "background", "left", "top", "right", "bottom",
                "top1_index", "top1_name", "p_top1", "p_target", "p_true"});
  for (size_t m = 0; m < video.answers.size(); ++m) {
    for (size_t i = 0; i < video.frames.size(); ++i) {
      const VideoFrame& f = video.frames[i];
      const record::ViewAnswer& a = video.answers[m][i];
      text += csv_line({video.record.victims[m].name, std::to_string(f.index),
                        fmt::format("{:.3f}", f.seconds), f.background, std::to_string(f.box.left),
                        std::to_string(f.box.top), std::to_string(f.box.right),
                        std::to_string(f.box.bottom), std::to_string(a.top1), a.top1_name,
                        fmt::format("{:.6f}", a.p_top1), fmt::format("{:.6f}", a.p_target),
                        a.p_true ? fmt::format("{:.6f}", *a.p_true) : ""});
    }
  }
  return text;
}

/// The frames that the extraction returned.
std::vector<VideoFrame> read_frames(const JsonValue& found, const std::vector<Labelled>& table) {
  std::vector<VideoFrame> frames;
  const JsonValue list = found.at("frames");
  for (size_t i = 0; i < list.size(); ++i) {
    const JsonValue f = list.at(i);
    VideoFrame frame;
    frame.index = f.at("index").as<int64_t>();
    frame.seconds = f.at("seconds").as<double>();
    const auto box = f.at("box").as<std::array<int64_t, 4>>();
    frame.box = {box[0], box[1], box[2], box[3]};
    frame.background = label_at(table, frame.seconds);
    frame.picture = image::read_image(f.at("file").as<std::string>()).narrow(2, 0, 3).contiguous();
    frames.push_back(frame);
  }
  return frames;
}

/// Figures of one victim: over all frames and for each background label.
record::VideoVictim summary_of(const model::ModelCard& card,
                               const std::vector<record::ViewAnswer>& answers,
                               const std::vector<VideoFrame>& frames, const record::ClassId& target,
                               bool by_background) {
  std::map<std::string, std::vector<size_t>> groups;
  std::vector<size_t> all;
  double probability = 0;
  for (size_t i = 0; i < frames.size(); ++i) {
    all.push_back(i);
    probability += answers[i].p_target;
    if (by_background) groups[frames[i].background].push_back(i);
  }
  record::VideoVictim victim = {card.name,
                                card.sha256,
                                target,
                                share(answers, all, target.index),
                                probability / static_cast<double>(frames.size()),
                                {}};
  for (const auto& [label, members] : groups) {
    victim.backgrounds[label] = share(answers, members, target.index);
  }
  return victim;
}

/// Answers of a victim for all frames. `true_class`: its index in the labels of this victim.
std::vector<record::ViewAnswer> answers_of(const model::Classifier& model,
                                           const std::vector<VideoFrame>& frames, int64_t target,
                                           std::optional<int64_t> true_class, at::Device device,
                                           Progress& progress) {
  std::vector<record::ViewAnswer> answers;
  progress.begin("classify", static_cast<int64_t>(frames.size()), 0);
  for (const VideoFrame& frame : frames) {
    const Tensor picture =
        (frame.picture.to(at::kFloat) / 255).permute({2, 0, 1}).unsqueeze(0).to(device);
    answer(model, picture, {}, target, true_class, answers);
    progress.update(static_cast<int64_t>(answers.size()), {});
    progress.check();
  }
  progress.end();
  return answers;
}

std::vector<std::shared_ptr<const model::Classifier>> load_models(const VideoOptions& options,
                                                                  Progress& progress) {
  std::vector<std::shared_ptr<const model::Classifier>> models;
  std::vector<const model::ModelCard*> cards;
  for (const std::string& name : options.victims) {
    models.push_back(model::Classifier::load(name, {}, &progress));
    cards.push_back(&models.back()->card());
    (void)model::find_class(options.target, *cards.back());
    if (!options.true_class.empty()) (void)model::find_class(options.true_class, *cards.back());
  }
  model::check_same_class(options.target, cards, "target");
  model::check_same_class(options.true_class, cards, "true class");
  return models;
}

}  // namespace

ScoredVideo score_video(const VideoOptions& options, Progress& progress) {
  at::NoGradGuard guard;
  if (options.victims.empty()) throw InputError("--victims: name at least one model");
  if (!fs::is_regular_file(options.video)) throw InputError(options.video, "no such video file");
  const std::vector<Labelled> table = read_backgrounds(options.backgrounds);
  const auto models = load_models(options, progress);
  const ExchangeFolder folder;
  const json document = extract(options, folder, progress);
  const JsonValue found(document, folder / "frames.json");
  ScoredVideo video;
  video.record.video = options.video.string();
  video.record.video_sha256 = sha256_file(options.video);
  video.record.width = found.at("width").as<int64_t>();
  video.record.height = found.at("height").as<int64_t>();
  video.record.duration_seconds = found.at("duration").as<double>();
  video.record.tt3d_version = kVersion;
  video.frames = read_frames(found, table);
  video.record.frames = static_cast<int64_t>(video.frames.size());
  const model::WeightsGuard weights(models);
  for (const auto& model : models) {
    const model::ModelCard& card = model->card();
    const record::ClassId target = model::find_class(options.target, card);
    if (video.record.victims.empty()) video.record.target = target;
    std::optional<int64_t> true_class;
    if (!options.true_class.empty()) true_class = model::find_class(options.true_class, card).index;
    video.answers.push_back(
        answers_of(*model, video.frames, target.index, true_class, options.device, progress));
    video.record.victims.push_back(
        summary_of(card, video.answers.back(), video.frames, target, !options.backgrounds.empty()));
  }
  weights.check();
  return video;
}

void save(ScoredVideo& video, const fs::path& json_path) {
  fs::path beside = json_path;
  write_file_atomic(beside.replace_extension(".csv"), frames_csv(video));
  video.record.strip = write_strip(video, beside.replace_extension(".frames"));
  write_json(json_path, to_json(video.record));
}

}  // namespace tt3d::evaluate
