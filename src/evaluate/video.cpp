#include <ATen/ATen.h>
#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tt3d/evaluate.h"
#include "tt3d/tool.h"
#include "tt3d/version.h"

namespace tt3d {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

/// A line of the backgrounds table.
struct Labelled {
  double begin = 0, end = 0;
  std::string label;
};

std::vector<Labelled> read_backgrounds(const fs::path& path) {
  std::vector<Labelled> table;
  if (path.empty()) return table;
  std::istringstream stream(read_file(path));
  long line = 0;
  for (std::string text; std::getline(stream, text);) {
    ++line;
    if (!text.empty() && text.back() == '\r') text.pop_back();
    if (text.empty() || text.starts_with("#") || (line == 1 && text.starts_with("start"))) continue;
    Labelled row;
    std::istringstream words(text);
    char first = 0, second = 0;
    words >> row.begin >> first >> row.end >> second;
    std::getline(words >> std::ws, row.label);
    if (!words || first != ',' || second != ',' || row.label.empty() || !(row.end > row.begin)) {
      throw InputError(path, line, "expected start_seconds,end_seconds,label with start < end");
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

/// Runs the extraction; its JSON.
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
  return json::parse(read_file(folder / "frames.json"));
}

/// ASR over the answers of some frames.
json share(const VictimRecord& victim, const std::vector<size_t>& frames, int64_t target) {
  int64_t hits = 0;
  for (const size_t i : frames) hits += victim.answers[i].top1 == target;
  const auto n = static_cast<int64_t>(frames.size());
  const Interval interval = wilson_interval(hits, n);
  return {{"frames", n},
          {"asr", n == 0 ? 0 : static_cast<double>(hits) / static_cast<double>(n)},
          {"asr_ci95", {interval.low, interval.high}}};
}

/// Frames that become pictures: as many as a page can show, evenly.
std::vector<size_t> strip_frames(size_t count) {
  constexpr size_t kStrip = 60;
  std::vector<size_t> chosen;
  for (size_t i = 0; i < std::min(kStrip, count); ++i) {
    chosen.push_back(i * count / std::min(kStrip, count));
  }
  return chosen;
}

/// Writes the pictures into `folder`; a line for each with its answers.
json write_strip(const VideoRecord& r, const fs::path& folder) {
  make_folder(folder);
  json strip = json::array();
  for (const size_t i : strip_frames(r.frames.size())) {
    const VideoFrame& f = r.frames[i];
    const std::string name = fmt::format("{:05}.jpg", i);
    write_file_atomic(folder / name, encode_jpeg(f.picture));
    json answers = json::array();
    for (const VictimRecord& v : r.victims) {
      const ViewAnswer& a = v.answers[i];
      answers.push_back({{"victim", v.name},
                         {"answer", a.top1_name},
                         {"probability", a.p_top1},
                         {"is_target", a.top1 == r.target.index}});
    }
    strip.push_back({{"picture", name},
                     {"seconds", f.seconds},
                     {"background", f.background},
                     {"answers", answers}});
  }
  return strip;
}

}  // namespace

VideoRecord score_video(const VideoOptions& options, Progress& progress) {
  at::NoGradGuard guard;
  if (options.victims.empty()) throw InputError("--victims: name at least one model");
  if (!fs::is_regular_file(options.video)) throw InputError(options.video, "no such video file");
  const std::vector<Labelled> table = read_backgrounds(options.backgrounds);
  VideoRecord record;
  record.options = options;
  std::vector<std::shared_ptr<Classifier>> models;
  for (const std::string& name : options.victims) {
    models.push_back(Classifier::load(name, {}, &progress));
    VictimRecord victim;
    victim.name = models.back()->card().name;
    victim.sha256 = models.back()->card().sha256;
    record.victims.push_back(victim);
    record.target = find_class(options.target, models.back()->card());
    if (!options.true_class.empty()) {
      record.true_class = find_class(options.true_class, models.back()->card());
    }
  }
  const ExchangeFolder folder;
  const json found = extract(options, folder, progress);
  record.video_sha256 = sha256_file(options.video);
  record.width = found.at("width");
  record.height = found.at("height");
  record.duration_seconds = found.at("duration");
  for (const json& f : found.at("frames")) {
    VideoFrame frame;
    frame.index = f.at("index");
    frame.seconds = f.at("seconds");
    const auto box = f.at("box").get<std::vector<int64_t>>();
    frame.box = {box.at(0), box.at(1), box.at(2), box.at(3)};
    frame.background = label_at(table, frame.seconds);
    frame.picture = read_image(f.at("file").get<std::string>()).narrow(2, 0, 3).contiguous();
    record.frames.push_back(frame);
  }
  progress.begin("classify", static_cast<int64_t>(record.frames.size()), 0);
  for (size_t i = 0; i < record.frames.size(); ++i) {
    const Tensor picture =
        (record.frames[i].picture.to(at::kFloat) / 255).permute({2, 0, 1}).unsqueeze(0);
    for (size_t m = 0; m < models.size(); ++m) {
      const ModelCard& card = models[m]->card();
      answer(*models[m], picture.to(options.device), {}, find_class(options.target, card).index,
             options.true_class.empty() ? -1 : find_class(options.true_class, card).index,
             record.victims[m].answers);
    }
    progress.update(static_cast<int64_t>(i + 1), {});
    progress.check();
  }
  progress.end();
  for (VictimRecord& v : record.victims) summarize(v, record.target.index, -1, false);
  return record;
}

std::string video_json(const VideoRecord& r) {
  std::map<std::string, std::vector<size_t>> groups;
  std::vector<size_t> all;
  for (size_t i = 0; i < r.frames.size(); ++i) {
    all.push_back(i);
    if (!r.options.backgrounds.empty()) groups[r.frames[i].background].push_back(i);
  }
  json victims = json::array();
  for (const VictimRecord& v : r.victims) {
    json one = share(v, all, r.target.index);
    one["name"] = v.name;
    one["sha256"] = v.sha256;
    one["mean_target_probability"] = v.mean_target_probability;
    one["backgrounds"] = json::object();
    for (const auto& [label, frames] : groups) {
      one["backgrounds"][label] = share(v, frames, r.target.index);
    }
    victims.push_back(one);
  }
  const json j = {{"video", r.options.video.string()},
                  {"video_sha256", r.video_sha256},
                  {"width", r.width},
                  {"height", r.height},
                  {"duration_seconds", r.duration_seconds},
                  {"target", {{"index", r.target.index}, {"name", r.target.name}}},
                  {"frames", r.frames.size()},
                  {"victims", victims},
                  {"tt3d_version", kVersion}};
  return j.dump(1) + "\n";
}

std::string video_csv(const VideoRecord& r) {
  const auto quoted = [](const std::string& text) {
    std::string out = "\"";
    for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
    return out + "\"";
  };
  std::string text =
      "victim,frame,seconds,background,left,top,right,bottom,top1_index,top1_name,p_top1,p_target,"
      "p_true\n";
  for (const VictimRecord& v : r.victims) {
    for (size_t i = 0; i < r.frames.size(); ++i) {
      const VideoFrame& f = r.frames[i];
      const ViewAnswer& a = v.answers[i];
      text +=
          fmt::format("{},{},{:.3f},{},{},{},{},{},{},{},{:.6f},{:.6f},{}\n", quoted(v.name),
                      f.index, f.seconds, quoted(f.background), f.box.left, f.box.top, f.box.right,
                      f.box.bottom, a.top1, quoted(a.top1_name), a.p_top1, a.p_target,
                      r.true_class.index >= 0 ? fmt::format("{:.6f}", a.p_true) : "");
    }
  }
  return text;
}

void write_video_record(const VideoRecord& record, const fs::path& json_path) {
  fs::path beside = json_path;
  write_file_atomic(beside.replace_extension(".csv"), video_csv(record));
  json j = json::parse(video_json(record));
  j["strip"] = write_strip(record, beside.replace_extension(".frames"));
  write_file_atomic(json_path, j.dump(1) + "\n");
}

}  // namespace tt3d
