#include <ATen/ATen.h>
#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "tt3d/asset.h"
#include "tt3d/capture.h"
#include "tt3d/input_files.h"
#include "tt3d/json.h"
#include "tt3d/mesh.h"
#include "tt3d/run.h"
#include "tt3d/scene.h"
#include "tt3d/tensor_file.h"

namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;

json quality_json(const capture::CaptureQuality& q) {
  json views = json::array();
  for (const capture::ViewQuality& v : q.views) {
    views.push_back({{"name", v.name},
                     {"hull_overlap", v.hull_overlap},
                     {"mask_share", v.mask_share},
                     {"sharpness", v.sharpness},
                     {"brightness", v.brightness},
                     {"azimuth_deg", v.azimuth_deg},
                     {"elevation_deg", v.elevation_deg},
                     {"problem", v.problem}});
  }
  return {{"hull_overlap", q.hull_overlap},
          {"coverage", q.coverage},
          {"largest_gap_deg", q.largest_gap_deg},
          {"elevations_deg", {q.lowest_deg, q.highest_deg}},
          {"sharpness", q.sharpness},
          {"exposure_spread", q.exposure_spread},
          {"advice", q.advice},
          {"views", views}};
}

namespace {

json capture_info(const fs::path& path, Progress& progress) {
  capture::CaptureOptions options;
  options.path = path;
  const capture::Capture c = capture::load_capture(options, progress);
  const scene::ViewFrame frame = capture::capture_view_frame(c);
  const json judged = quality_json(capture::assess_capture(c, progress));
  json j = {{"kind", "capture"},
            {"format", name_of(c.format)},
            {"train_views", c.train.size()},
            {"test_views", c.test.size()},
            {"masks", c.has_masks},
            {"width", c.train[0].camera.width},
            {"height", c.train[0].camera.height},
            {"scale", c.normalization.scale},
            {"centre", c.normalization.centre},
            {"distance", frame.distance / c.normalization.scale},
            {"fov_y_deg", frame.fov_y_deg},
            {"up", c.normalization.up}};
  for (const auto& [key, value] : judged.items()) {
    if (key != "views") j[key] = value;
  }
  return j;
}

json asset_info(const fs::path& path, Progress& progress) {
  const asset::TexturedMesh mesh = asset::load_asset(path, &progress);
  const mesh::MeshFacts facts = mesh::inspect({mesh.vertices, mesh.faces});
  const bool moved = mesh.origin != std::array{0.0, 0.0, 0.0};
  const auto bound = [&](const at::Tensor& t) -> json {
    if (!moved) return {t[0].item<float>(), t[1].item<float>(), t[2].item<float>()};
    json world = json::array();
    for (size_t k = 0; k < 3; ++k) {
      world.push_back(mesh.origin[k] + t[static_cast<int64_t>(k)].item<double>());
    }
    return world;
  };
  return {{"kind", "asset"},
          {"vertices", facts.vertices},
          {"faces", facts.faces},
          {"closed", facts.closed()},
          {"components", facts.components},
          {"texture", {mesh.texture.size(1), mesh.texture.size(0)}},
          {"low", bound(std::get<0>(mesh.vertices.min(0)))},
          {"high", bound(std::get<0>(mesh.vertices.max(0)))}};
}

json tensors_info(const fs::path& path) {
  const TensorFile file = load_tensors(path);
  json tensors = json::object();
  for (const auto& [name, t] : file.tensors) {
    tensors[name] = std::vector<int64_t>(t.sizes().begin(), t.sizes().end());
  }
  const auto format = file.metadata.find("format");
  return {{"kind", format == file.metadata.end() ? "tensors" : format->second},
          {"tensors", tensors}};
}

json model_info(const std::string& path) {
  const auto model = model::Classifier::load(path);
  const model::ModelCard& card = model->card();
  return {{"kind", model->is_detector() ? "detector" : "model"},
          {"name", card.name},
          {"anchors", model->is_detector() ? json(model->anchors()) : json()},
          {"scores", name_of(model->scores())},
          {"label_set", card.label_set},
          {"input_size", {card.height, card.width}},
          {"classes", card.labels.size()},
          {"licence", card.licence},
          {"sha256", card.sha256}};
}

json info_of(const std::string& text, Progress& progress) {
  const fs::path path = text;
  if (fs::exists(path / "run.json")) {
    json j = to_json(read_json_as<record::RunRecord>(path / "run.json"));
    j["kind"] = "run";
    return j;
  }
  if (fs::is_directory(path)) return capture_info(path, progress);
  if (has_extension(path, {".glb", ".gltf", ".obj"})) return asset_info(path, progress);
  if (has_extension(path, {".safetensors"})) return tensors_info(path);
  if (has_extension(path, {".pt2"})) return model_info(text);
  if (!fs::exists(path)) throw InputError(path, "no such file or folder");
  if (has_extension(path, {".json", ".bin", ".txt"})) return capture_info(path, progress);
  throw InputError(path,
                   "expected a capture or its camera file, a run folder, .glb, .gltf, .obj, "
                   ".safetensors or .pt2");
}

void print_json(const json& j, const Common& common) {
  if (common.json) {
    std::cout << j.dump(1) << "\n";
    return;
  }
  for (const auto& [key, value] : j.items()) {
    std::cout << fmt::format("{:<16} {}\n", key,
                             value.is_string() ? value.get<std::string>() : value.dump());
  }
}

/// The key or the group of keys with this name. Throws InputError if there are none.
std::vector<Key> keys_named(const KeyList& keys, const std::string& wanted) {
  std::vector<Key> found;
  for (const Key& key : keys.all()) {
    if (wanted.empty() || key.name == wanted || key.name.starts_with(wanted + ".")) {
      found.push_back(key);
    }
  }
  if (found.empty()) (void)keys.find(wanted);  // throws InputError with the nearest name
  return found;
}

json key_json(const Key& key) {
  json j = {{"key", key.name}, {"meaning", key.meaning}, {"unit", key.unit}, {"range", key.range}};
  std::visit([&](const auto& value) { j["default"] = value; }, key.get());
  return j;
}

void print_key(const Key& key) {
  std::cout << fmt::format("{:<28} {:<16} {}", key.name, run::toml_of(key.get()), key.meaning);
  if (!key.unit.empty()) std::cout << " [" << key.unit << "]";
  if (!key.range.empty()) std::cout << " (" << key.range << ")";
  std::cout << "\n";
}

/// A row of a table in docs/.
void print_markdown(const Key& key) {
  const std::string unit = key.unit.empty() ? "" : " [" + key.unit + "]";
  std::cout << fmt::format("| `{}` | `{}` | {}{} | {} |\n", key.name, run::toml_of(key.get()),
                           key.meaning, unit, key.range);
}

void print_keys(const std::string& wanted, bool markdown, const Common& common) {
  run::RunConfig defaults;
  const std::vector<Key> keys = keys_named(run::keys_of(defaults), wanted);
  if (common.json) {
    json list = json::array();
    for (const Key& key : keys) list.push_back(key_json(key));
    std::cout << list.dump(1) << "\n";
    return;
  }
  if (markdown) std::cout << "| key | default | meaning | range |\n|---|---|---|---|\n";
  for (const Key& key : keys) markdown ? print_markdown(key) : print_key(key);
}

}  // namespace

void add_info_commands(CLI::App& app, Common& common) {
  auto text = std::make_shared<std::string>();
  CLI::App* info =
      app.add_subcommand("info", "print facts about a capture, field, mesh, asset, model or run");
  info->add_option("PATH", *text, "file or folder")->required();
  add_common_options(*info, common);
  info->callback([text, &common] {
    const auto progress = make_progress(common);
    print_json(info_of(*text, *progress), common);
  });
  CLI::App* config =
      app.add_subcommand("config", "list the configuration keys: meaning, unit, default, range");
  auto markdown = std::make_shared<bool>(false);
  config->add_option("KEY", *text, "key or group of keys; default: all");
  config->add_flag("--markdown", *markdown, "print the tables of the documentation");
  add_common_options(*config, common);
  config->callback([text, markdown, &common] { print_keys(*text, *markdown, common); });
}

}  // namespace tt3d::cli
