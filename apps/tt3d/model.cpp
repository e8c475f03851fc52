#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <fmt/format.h>

#include <algorithm>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <unordered_map>

#include "commands.h"
#include "tt3d/device.h"
#include "tt3d/image.h"
#include "tt3d/memory.h"
#include "tt3d/model.h"
#include "tt3d/pictures.h"

namespace tt3d::cli {
namespace fs = std::filesystem;
namespace {

using Json = nlohmann::json;

/// Arguments of the subcommands of `tt3d model`.
struct ModelArguments {
  std::string model;
  std::vector<std::string> images;
  int top = 5;
  int batch = 8;
  bool no_fold = false, no_channels_last = false, no_compile = false, no_probe = false;
  model::Precision precision = model::Precision::kFloat32;
};

/// Prints warnings of the library on stderr.
class Warnings : public Progress {
 public:
  void note(const std::string& line) override { std::cerr << "warning: " << line << "\n"; }
};

std::shared_ptr<model::Classifier> load(const ModelArguments& arguments, const Common& common) {
  apply_common(common);
  model::ModelOptions options;
  options.fold_batch_norm = !arguments.no_fold;
  options.channels_last = !arguments.no_channels_last;
  options.compile = !arguments.no_compile;
  options.check_probe = !arguments.no_probe;
  options.precision = arguments.precision;
  Warnings warnings;
  return model::Classifier::load(arguments.model, {}, &warnings, options);
}

Json card_json(const model::Classifier& model) {
  const model::ModelCard& card = model.card();
  return {{"name", card.name},
          {"architecture", card.architecture},
          {"path", model.path().string()},
          {"source", card.source},
          {"licence", card.licence},
          {"input_size", {card.height, card.width}},
          {"resize", card.resize},
          {"interpolation", card.interpolation},
          {"kind", model.is_detector() ? "detector" : "classifier"},
          {"anchors", model.is_detector() ? Json(model.anchors()) : Json()},
          {"classes", card.labels.size()},
          {"label_set", card.label_set},
          {"scores", name_of(model.scores())},
          {"sha256", card.sha256},
          {"weights_hash", model.weights_hash()}};
}

std::string kind_of(const model::Classifier& model) {
  if (!model.is_detector()) return "classifier";
  return model.anchors() == 0 ? "detector"
                              : fmt::format("detector with {} anchors", model.anchors());
}

void check(const ModelArguments& arguments, const Common& common) {
  if (common.device == "cuda") {
    throw InputError("model check runs on the CPU; remove --device");
  }
  reset_peak_memory();
  const int64_t before = peak_memory_bytes();
  const double start = now_seconds();
  const auto model = load(arguments, common);
  const double seconds = now_seconds() - start;
  const int64_t load_peak = peak_memory_bytes() - before;
  model->check_gradients();
  const model::ProbeReport& probe = model->probe();
  if (common.json) {
    Json result = card_json(*model);
    result["load_seconds"] = seconds;
    result["load_peak_bytes"] = load_peak;
    result["archive_bytes"] = fs::file_size(model->path());
    result["probe"] = nullptr;
    if (probe.present) {
      result["probe"] = {{"logit_error", probe.logit_error},
                         {"gradient_cosine", probe.gradient_cosine},
                         {"gradient_ratio", probe.gradient_ratio}};
    }
    std::cout << result.dump(2) << "\n";
    return;
  }
  const model::ModelCard& card = model->card();
  std::cout << fmt::format("{}: {}, {}, {} classes, {}x{} pixels, read in {:.2f} s\n", card.name,
                           card.architecture, kind_of(*model), card.labels.size(), card.height,
                           card.width, seconds);
  std::cout << (probe.present
                    ? fmt::format("probe: logits within {:.1e} of their range, cosine of the input "
                                  "gradient {:.7f}\n",
                                  probe.logit_error, probe.gradient_cosine)
                    : "probe: none; the outputs were not checked\n");
}

void list(const Common& common) {
  const auto entries = model::list_models();
  if (common.json) {
    Json result = Json::array();
    for (const auto& entry : entries) {
      result.push_back({{"name", entry.name}, {"path", entry.path.string()}});
    }
    std::cout << result.dump(2) << "\n";
    return;
  }
  for (const auto& entry : entries) std::cout << entry.name << "\t" << entry.path.string() << "\n";
  if (!entries.empty()) return;
  std::cout << "no models found; searched";
  for (const fs::path& folder : model::model_folders()) std::cout << " " << folder.string();
  std::cout << "; make one with 'python -m tt3d_tools.export efficientnet_lite0'\n";
}

/// Image files on the command line, and those in folders on the command line, sorted by name.
std::vector<fs::path> image_files(const std::vector<std::string>& names) {
  std::vector<fs::path> files;
  for (const std::string& name : names) {
    if (!fs::is_directory(name)) {
      files.emplace_back(name);
      continue;
    }
    const std::vector<fs::path> inside = image::list_pictures(name);
    if (inside.empty()) throw InputError(name, "has no JPEG or PNG files");
    files.insert(files.end(), inside.begin(), inside.end());
  }
  return files;
}

/// The input picture [1,3,H,W], upright and composited over white.
at::Tensor picture(const fs::path& path, const model::ModelCard& card) {
  const at::Tensor rgba = image::read_upright_image(path).to(at::kFloat).div(255);
  const at::Tensor alpha = rgba.slice(2, 3, 4);
  const at::Tensor rgb = rgba.slice(2, 0, 3) * alpha + (1 - alpha);
  return model::preprocess(rgb.permute({2, 0, 1}).unsqueeze(0).contiguous(), card);
}

/// Top classes of one image.
struct Answer {
  fs::path path;
  std::vector<int64_t> classes;
  std::vector<double> probabilities;
};

std::vector<Answer> answers(const model::Classifier& model, const std::vector<fs::path>& files,
                            int top, int batch, at::Device device) {
  const at::NoGradGuard no_gradients;
  const int64_t count =
      std::min<int64_t>(std::max(top, 5), static_cast<int64_t>(model.card().labels.size()));
  std::vector<Answer> result;
  for (size_t start = 0; start < files.size(); start += static_cast<size_t>(batch)) {
    const size_t end = std::min(files.size(), start + static_cast<size_t>(batch));
    std::vector<at::Tensor> images;
    for (size_t i = start; i < end; ++i) images.push_back(picture(files[i], model.card()));
    const at::Tensor probabilities =
        model::probabilities(model, model.logits(at::cat(images, 0).to(device))).cpu();
    const auto [values, indices] = probabilities.topk(count, 1);
    for (size_t i = start; i < end; ++i) {
      Answer answer{files[i], {}, {}};
      for (int64_t k = 0; k < count; ++k) {
        const auto row = static_cast<int64_t>(i - start);
        answer.classes.push_back(indices[row][k].item<int64_t>());
        answer.probabilities.push_back(values[row][k].item<double>());
      }
      result.push_back(std::move(answer));
    }
  }
  return result;
}

/// Counts correct answers for images whose file name is a WordNet id of the model.
struct Accuracy {
  int64_t n = 0, top1 = 0, top5 = 0;
  [[nodiscard]] double share(int64_t hits) const {
    return static_cast<double>(hits) / static_cast<double>(n);
  }
};

Accuracy accuracy_of(const std::vector<Answer>& answers, const model::ModelCard& card) {
  std::unordered_map<std::string, int64_t> index;
  for (size_t i = 0; i < card.wnids.size(); ++i) index[card.wnids[i]] = static_cast<int64_t>(i);
  Accuracy accuracy;
  for (const Answer& answer : answers) {
    const auto truth = index.find(answer.path.stem().string());
    if (truth == index.end()) continue;
    const auto end = answer.classes.begin() + std::min<int64_t>(5, answer.classes.size());
    ++accuracy.n;
    accuracy.top1 += answer.classes.front() == truth->second ? 1 : 0;
    accuracy.top5 += std::find(answer.classes.begin(), end, truth->second) != end ? 1 : 0;
  }
  return accuracy;
}

Json answer_json(const Answer& answer, const model::ModelCard& card, int top) {
  Json best = Json::array();
  for (size_t k = 0; k < answer.classes.size() && k < static_cast<size_t>(top); ++k) {
    const auto index = static_cast<size_t>(answer.classes[k]);
    best.push_back({{"index", index},
                    {"wnid", card.wnids.empty() ? "" : card.wnids[index]},
                    {"name", card.labels[index]},
                    {"probability", answer.probabilities[k]}});
  }
  return {{"file", answer.path.string()}, {"top", best}};
}

void print_answer(const Answer& answer, const model::ModelCard& card, int top) {
  std::cout << answer.path.string() << ":";
  for (size_t k = 0; k < answer.classes.size() && k < static_cast<size_t>(top); ++k) {
    std::cout << fmt::format("{} {} ({:.1f} %)", k == 0 ? "" : ",",
                             card.labels[static_cast<size_t>(answer.classes[k])],
                             100 * answer.probabilities[k]);
  }
  std::cout << "\n";
}

void classify(const ModelArguments& arguments, const Common& common) {
  const auto model = load(arguments, common);
  const auto files = image_files(arguments.images);
  const auto found =
      answers(*model, files, arguments.top, arguments.batch, device_named(common.device));
  const Accuracy accuracy = accuracy_of(found, model->card());
  if (common.json) {
    Json result = {{"model", model->card().name}, {"images", Json::array()}, {"n", accuracy.n}};
    for (const Answer& one : found) {
      result["images"].push_back(answer_json(one, model->card(), arguments.top));
    }
    result["top1"] = accuracy.n == 0 ? Json() : Json(accuracy.share(accuracy.top1));
    result["top5"] = accuracy.n == 0 ? Json() : Json(accuracy.share(accuracy.top5));
    std::cout << result.dump(2) << "\n";
    return;
  }
  const bool summary = accuracy.n > 1 && common.verbosity <= 0;
  for (const Answer& one : found) {
    if (!summary) print_answer(one, model->card(), arguments.top);
  }
  if (accuracy.n == 0) return;
  std::cout << fmt::format("{} images named by WordNet id: top-1 {:.3f}, top-5 {:.3f}\n",
                           accuracy.n, accuracy.share(accuracy.top1),
                           accuracy.share(accuracy.top5));
}

void add_speed_options(CLI::App& command, ModelArguments& arguments) {
  command.add_flag("--no-fold", arguments.no_fold,
                   "do not fold batch normalisation into convolutions");
  command.add_flag("--no-channels-last", arguments.no_channels_last,
                   "keep the channels-first layout; implies --no-compile");
  command.add_flag("--no-compile", arguments.no_compile,
                   "run the graph step by step, not as a compiled plan");
  static const std::map<std::string, model::Precision> names = {
      {"float32", model::Precision::kFloat32},
      {"bf16", model::Precision::kBfloat16},
      {"tf32", model::Precision::kTf32}};
  command
      .add_option("--precision", arguments.precision,
                  "of convolutions and matrix products: float32, bf16 where the processor has it, "
                  "tf32 on CUDA")
      ->transform(CLI::CheckedTransformer(names).description(""))
      ->option_text("NAME");
}

}  // namespace

void add_model_command(CLI::App& app, Common& common) {
  const auto arguments = std::make_shared<ModelArguments>();
  CLI::App* model = app.add_subcommand("model", "check, run and list classifier packages");
  model->require_subcommand(1);

  CLI::App* check_command = model->add_subcommand("check", "read a package and run its probe");
  check_command->add_option("MODEL", arguments->model, "path to a .pt2 or a name")->required();
  check_command->add_flag("--no-probe", arguments->no_probe, "only read the package");
  add_speed_options(*check_command, *arguments);
  check_command->callback([arguments, &common] { check(*arguments, common); });

  CLI::App* classify_command = model->add_subcommand(
      "classify", "classify images; for files named by WordNet id, also top-1 and top-5 accuracy");
  classify_command->add_option("MODEL", arguments->model, "path to a .pt2 or a name")->required();
  classify_command->add_option("IMAGE", arguments->images, "JPEG or PNG files, or folders of them")
      ->required();
  classify_command->add_option("--top", arguments->top, "number of labels per image")
      ->check(CLI::Range(1, 1000));
  classify_command->add_option("--batch", arguments->batch, "images per batch")
      ->check(CLI::Range(1, 1024));
  add_speed_options(*classify_command, *arguments);
  classify_command->callback([arguments, &common] { classify(*arguments, common); });

  CLI::App* list_command =
      model->add_subcommand("list", "list the packages that can be used by name");
  list_command->callback([&common] { list(common); });

  for (CLI::App* command : {check_command, classify_command, list_command}) {
    add_common_options(*command, common);
  }
}

}  // namespace tt3d::cli
