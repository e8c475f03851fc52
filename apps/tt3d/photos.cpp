#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>

#include "commands.h"
#include "tt3d/capture.h"
#include "tt3d/json.h"
#include "tt3d/scene.h"
#include "tt3d/tool.h"

/// Command photos: from photographs or a video to a capture.
namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

constexpr double kPhotosSeconds = 6 * 3600;
constexpr double kPageSeconds = 600;

struct PhotosArguments {
  std::string source, out, up = "auto", floor = "auto";
  bool restart = false;
};

/// Checks that --floor is auto, none or a number.
std::string check_floor(const std::string& text) {
  if (text == "auto" || text == "none" || CLI::Number(text).empty()) return "";
  return "expected auto, none or a height in the units of the capture";
}

/// The facts of capture.json that the page shows, and the height of the floor in the world.
struct CaptureFacts {
  json rows = json::array();
  std::optional<double> floor;
};

CaptureFacts read_facts(const fs::path& folder) {
  CaptureFacts facts;
  const json record = read_json(folder / "capture.json");
  const auto step = [&](const char* name) {
    const json steps = record.value("steps", json::object());
    return steps.value(name, json::object()).value("facts", json::object());
  };
  if (const json cameras = step("cameras"); cameras.contains("registered")) {
    facts.rows.push_back(
        {"photographs with a camera", fmt::format("{} of {}", cameras["registered"].get<int>(),
                                                  cameras["photographs"].get<int>())});
  }
  facts.rows.push_back({"up direction", step("upright").value("method", "your own cameras")});
  const json masks = step("masks");
  if (masks.contains("floor") && masks["floor"].is_number()) {
    facts.floor = masks["floor"].get<double>();
    facts.rows.push_back({"support plane (--floor)", fmt::format("{:.4g}", *facts.floor)});
  } else {
    facts.rows.push_back({"support plane (--floor)", "none"});
  }
  return facts;
}

/// Measures the capture, writes capture.html and prints the figures.
void draw_page(const fs::path& folder, const Common& common, Progress& progress) {
  capture::CaptureOptions options;
  options.path = folder;
  const capture::Capture capture = capture::load_capture(options, progress);
  const capture::CaptureQuality quality = capture::assess_capture(capture, progress);
  const CaptureFacts facts = read_facts(folder);
  json views = json::array();
  size_t i = 0;
  for (const auto* list : {&capture.train, &capture.test}) {
    for (const capture::View& view : *list) {
      const auto& pose = view.camera.camera_to_world;
      views.push_back({{"name", view.name},
                       {"position", view.camera.position()},
                       {"forward", {-pose[2], -pose[6], -pose[10]}},
                       {"problem", quality.views[i++].problem}});
    }
  }
  const scene::Normalization& n = capture.normalization;
  const json floor = facts.floor ? json(n.scale * (*facts.floor - n.centre[2])) : json(nullptr);
  const ExchangeFolder exchange;
  const json job = {{"capture", folder.string()},
                    {"quality", quality_json(quality)},
                    {"views", views},
                    {"facts", facts.rows},
                    {"floor", floor},
                    {"out", (folder / "capture.html").string()}};
  write_file_atomic(exchange / "job.json", job.dump());
  (void)run_tool("photos/page.py", {(exchange / "job.json").string()}, "page", kPageSeconds,
                 progress);
  if (common.json) {
    std::cout << quality_json(quality).dump(1) << "\n";
    return;
  }
  for (const std::string& line : quality.advice) std::cout << "advice: " << line << "\n";
  std::cout << fmt::format(
      "{} photographs, agreement of the masks {:.3f}, {:.0f} % of the directions above the "
      "horizon\npage: {}\n",
      quality.views.size(), quality.hull_overlap, 100 * quality.coverage,
      (folder / "capture.html").string());
}

void make_capture(const PhotosArguments& a, const Common& common) {
  const auto progress = make_progress(common);
  const ExchangeFolder folder;
  const json job = {{"source", fs::absolute(a.source).lexically_normal().string()},
                    {"out", fs::absolute(a.out).lexically_normal().string()},
                    {"up", a.up},
                    {"floor", a.floor},
                    {"restart", a.restart}};
  write_file_atomic(folder / "job.json", job.dump());
  (void)run_tool("photos/main.py", {(folder / "job.json").string()}, "photos", kPhotosSeconds,
                 *progress);
  draw_page(fs::absolute(a.out).lexically_normal(), common, *progress);
}

}  // namespace

void add_photos_command(CLI::App& app, Common& common) {
  auto a = std::make_shared<PhotosArguments>();
  CLI::App* command = app.add_subcommand(
      "photos", "find cameras and masks of photographs or a video; run again to resume");
  command->add_option("SOURCE", a->source, "folder of photographs, or a video")->required();
  command->add_option("--out", a->out, "folder of the capture")->required();
  command
      ->add_option("--up", a->up,
                   "up direction: auto, or an axis of the world that the cameras were found in")
      ->check(CLI::IsMember({"auto", "x", "y", "z", "-x", "-y", "-z"}))
      ->capture_default_str();
  command
      ->add_option("--floor", a->floor,
                   "height of the plane on which the object stands: auto, none or a number")
      ->check(CLI::Validator(check_floor, "auto|none|NUMBER"))
      ->capture_default_str();
  command->add_flag("--restart", a->restart, "make everything again; your own files are kept");
  add_common_options(*command, common);
  command->callback([a, &common] { make_capture(*a, common); });
}

}  // namespace tt3d::cli
