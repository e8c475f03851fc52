#include <ATen/ATen.h>
#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "tt3d/run.h"
#include "tt3d/tensor_file.h"

namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

json capture_info(const fs::path& path, Progress& progress) {
  CaptureOptions options;
  options.path = path;
  const Capture c = load_capture(options, progress);
  const ViewFrame frame = capture_view_frame(c);
  return {{"kind", "capture"},
          {"format", c.format},
          {"train_views", c.train.size()},
          {"test_views", c.test.size()},
          {"masks", c.has_masks},
          {"width", c.train[0].camera.width},
          {"height", c.train[0].camera.height},
          {"scale", c.normalization.scale},
          {"centre", c.normalization.centre},
          {"distance", frame.distance / c.normalization.scale},
          {"fov_y_deg", frame.fov_y_deg}};
}

json asset_info(const fs::path& path) {
  const TexturedMesh mesh = load_asset(path);
  const MeshFacts facts = inspect({mesh.vertices, mesh.faces});
  const auto bound = [](const at::Tensor& t) {
    return std::vector<float>{t[0].item<float>(), t[1].item<float>(), t[2].item<float>()};
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
  const auto model = Classifier::load(path);
  const ModelCard& card = model->card();
  return {{"kind", "model"},
          {"name", card.name},
          {"input_size", {card.height, card.width}},
          {"classes", card.labels.size()},
          {"licence", card.licence},
          {"sha256", card.sha256}};
}

json info_of(const std::string& text, Progress& progress) {
  const fs::path path = text;
  const std::string extension = path.extension().string();
  if (fs::exists(path / "run.json")) {
    json j = json::parse(read_file(path / "run.json"));
    j["kind"] = "run";
    return j;
  }
  if (fs::is_directory(path)) return capture_info(path, progress);
  if (extension == ".glb" || extension == ".obj") return asset_info(path);
  if (extension == ".safetensors") return tensors_info(path);
  if (extension == ".pt2") return model_info(text);
  if (!fs::exists(path)) throw InputError(path, "does not exist");
  throw InputError(path, "expected a capture or run folder, .glb, .obj, .safetensors or .pt2");
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

void print_keys(const std::string& wanted, const Common& common) {
  json list = json::array();
  std::vector<std::string> names;
  for (const ConfigKey& key : config_keys({})) {
    names.push_back(key.name);
    if (!wanted.empty() && key.name != wanted && !key.name.starts_with(wanted + ".")) continue;
    list.push_back({{"key", key.name},
                    {"meaning", key.meaning},
                    {"unit", key.unit},
                    {"default", key.value},
                    {"range", key.range}});
  }
  if (list.empty()) {
    const std::string near = nearest_name(wanted, names);
    throw InputError("no key '" + wanted + "'" +
                     (near.empty() ? "" : "; did you mean '" + near + "'?"));
  }
  if (common.json) {
    std::cout << list.dump(1) << "\n";
    return;
  }
  for (const json& k : list) {
    std::cout << fmt::format("{:<28} {:<16} {}", k["key"].get<std::string>(),
                             k["default"].get<std::string>(), k["meaning"].get<std::string>());
    const std::string unit = k["unit"], range = k["range"];
    if (!unit.empty()) std::cout << " [" << unit << "]";
    if (!range.empty()) std::cout << " (" << range << ")";
    std::cout << "\n";
  }
}

}  // namespace

void add_info_commands(CLI::App& app, Common& common) {
  auto text = std::make_shared<std::string>();
  CLI::App* info =
      app.add_subcommand("info", "what a capture, field, mesh, asset, model or run holds");
  info->add_option("PATH", *text, "file or folder")->required();
  add_common_options(*info, common);
  info->callback([text, &common] {
    const auto progress = make_progress(common);
    print_json(info_of(*text, *progress), common);
  });
  CLI::App* config = app.add_subcommand("config", "every key: meaning, unit, default, range");
  config->add_option("KEY", *text, "a key or a group of keys");
  add_common_options(*config, common);
  config->callback([text, &common] { print_keys(*text, common); });
}

}  // namespace tt3d::cli
