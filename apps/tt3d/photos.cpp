#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "tt3d/json.h"
#include "tt3d/tool.h"

/// Command photos: from photographs or a video to a capture.
namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

constexpr double kPhotosSeconds = 6 * 3600;

struct PhotosArguments {
  std::string source, out, up = "auto", floor = "auto";
  bool restart = false;
};

/// Checks that --floor is auto, none or a number.
std::string check_floor(const std::string& text) {
  if (text == "auto" || text == "none" || CLI::Number(text).empty()) return "";
  return "expected auto, none or a height in the units of the capture";
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
  std::cout << a.out << "\n";
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
