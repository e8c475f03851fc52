#include <ATen/ATen.h>
#include <fmt/format.h>

#include <new>

#include "archive.h"
#include "batch_runner.h"
#include "card.h"
#include "graph_reader.h"
#include "malformed.h"
#include "precision.h"
#include "probe.h"
#include "rewrite.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace fs = std::filesystem;
namespace {

at::Tensor channel_tensor(const std::vector<double>& values) {
  return at::tensor(values, at::kDouble).to(at::kFloat).view({1, 3, 1, 1});
}

std::string describe(const ProbeReport& report) {
  std::string logits = fmt::format("logits off by {:.2g} of their range", report.logit_error);
  if (!report.gradients) return logits;
  return logits + fmt::format(", cosine of the input gradient {:.6f}, norm ratio {:.4f}",
                              report.gradient_cosine, report.gradient_ratio);
}

[[noreturn]] void throw_probe(const fs::path& path, const ProbeReport& report,
                              Precision precision) {
  const char* advice = precision == Precision::kBfloat16
                           ? "run it in float32"
                           : "the card belongs to another model, export it again";
  throw InputError(
      path, fmt::format("the probe of its card disagrees ({}); {}", describe(report), advice));
}

/// Runs the graph of a package; see tt3d/model.h.
class Pt2Classifier final : public Classifier {
 public:
  Pt2Classifier(fs::path path, CardFile file, std::shared_ptr<BatchRunner> runner,
                bool channels_last, const ModelOptions& options)
      : path_(std::move(path)),
        file_(std::move(file)),
        runner_(std::move(runner)),
        channels_last_(channels_last),
        precision_(options.precision),
        mean_(channel_tensor(card().mean)),
        std_(channel_tensor(card().std)) {
    if (!options.check_probe) return;
    probe_ = model::probe_logits(file_, [&](const at::Tensor& images) { return run({images}); });
  }

  const ModelCard& card() const override { return file_.card; }
  const ProbeReport& probe() const override { return probe_; }
  const fs::path& path() const override { return path_; }

  Scores scores() const override {
    return card().scores.value_or(is_detector() ? Scores::kSigmoid : Scores::kSoftmax);
  }
  bool is_detector() const override { return runner_->graph().detector; }
  int64_t anchors() const override { return runner_->graph().anchors; }

  void check_gradients() const override {
    if (!probe_.present) return;
    if (!probe_.gradients) {
      model::probe_gradients(
          file_, [&](const at::Tensor& images) { return run({images}); }, probe_);
    }
    if (!model::probe_holds(probe_, precision_)) throw_probe(path_, probe_, precision_);
  }

  at::Tensor logits(const at::Tensor& images) const override {
    check_images(images);
    if (images.requires_grad() && at::GradMode::is_enabled()) check_gradients();
    return run({images});
  }

  at::Tensor mixed_logits(const at::Tensor& images, const FeatureMix& mix) const override {
    check_images(images);
    check_images(mix.images);
    if (mix.images.size(0) != images.size(0)) {
      throw InputError("FeatureMix::images: expected one for each picture");
    }
    if (images.requires_grad() && at::GradMode::is_enabled()) check_gradients();
    return run({images, mix, 0});
  }

  std::string weights_hash() const override {
    const Graph& graph = runner_->used_graph();
    std::string digests;
    for (const auto& [slot, tensor] : graph.constants) {
      const at::Tensor bytes = tensor.cpu().contiguous();
      digests += graph.names[static_cast<size_t>(slot)];
      digests += sha256({static_cast<const char*>(bytes.const_data_ptr()), bytes.nbytes()});
    }
    if (runner_->plan() != nullptr && !runner_->plan()->weights_hold()) digests += "changed";
    return sha256(digests);
  }

 private:
  at::Tensor normalized(const at::Tensor& images) const {
    const at::Tensor input = (images - mean_.to(images.device())) / std_.to(images.device());
    return channels_last_ ? input.contiguous(at::MemoryFormat::ChannelsLast) : input;
  }

  at::Tensor run(Pictures pictures) const {
    pictures.images = normalized(pictures.images);
    if (pictures.mix) pictures.mix->images = normalized(pictures.mix->images.detach());
    try {
      return runner_->logits(pictures);
    } catch (const Malformed& error) {
      throw InputError(path_, error.what());
    } catch (const ResourceError& error) {
      throw ResourceError(path_.string() + ": " + error.what());
    }
  }

  void check_images(const at::Tensor& images) const {
    if (images.dim() == 4 && images.size(0) > 0 && images.size(1) == 3 &&
        images.size(2) == card().height && images.size(3) == card().width &&
        images.scalar_type() == at::kFloat) {
      return;
    }
    throw InputError(fmt::format("model {}: expected float32 images [N,3,{},{}]; use preprocess()",
                                 card().name, card().height, card().width));
  }

  fs::path path_;
  CardFile file_;
  std::shared_ptr<BatchRunner> runner_;
  bool channels_last_;
  Precision precision_;
  at::Tensor mean_, std_;
  mutable ProbeReport probe_;  // check_gradients() stores its result here
};

void check_sha256(const MappedFile& archive, const CardFile& file) {
  const std::string actual = sha256(archive.bytes());
  if (actual == file.card.sha256) return;
  throw Malformed(
      fmt::format("SHA-256 is {}, its card says {}; the files do not belong together "
                  "or one is damaged",
                  actual, file.card.sha256));
}

void check_against_card(const Graph& graph, const ModelCard& card) {
  if (graph.height != card.height || graph.width != card.width) {
    throw Malformed(fmt::format("takes {}x{} pictures, its card says {}x{}", graph.height,
                                graph.width, card.height, card.width));
  }
  if (graph.classes != static_cast<int64_t>(card.labels.size())) {
    throw Malformed(
        fmt::format("gives {} classes, its card has {} labels", graph.classes, card.labels.size()));
  }
  const std::string last = probability_layer(graph);
  if (!last.empty() && card.scores != Scores::kNone) {
    throw Malformed(
        fmt::format("ends in a {}, so it gives probabilities where logits are expected; export it "
                    "without that layer, or write \"scores\": \"none\" in its card",
                    last));
  }
}

/// The parts of a package before it becomes a classifier.
struct Package {
  fs::path path;
  CardFile card;
  std::shared_ptr<const MappedFile> archive;
  ModelLimits limits;
};

/// The graph prepared as `options` ask, and whether its images should be channels-last.
std::pair<Graph, bool> prepare(const Package& package, const ModelOptions& options) {
  Graph graph = model::read_graph(model::Archive(package.archive, package.limits), package.limits);
  check_against_card(graph, package.card.card);
  model::fold_paddings(graph);
  const bool channels_last = options.channels_last && model::can_use_channels_last(graph);
  if (options.fold_batch_norm) {
    model::fold_batch_norms(
        graph, channels_last ? at::MemoryFormat::ChannelsLast : at::MemoryFormat::Contiguous);
    model::simplify_batch_norms(graph);
  }
  if (channels_last) model::use_channels_last(graph);
  model::find_last_uses(graph);
  return {std::move(graph), channels_last};
}

/// Prepares the package and runs its probe.
std::shared_ptr<Pt2Classifier> build(const Package& package, const ModelOptions& options) {
  auto [graph, channels_last] = prepare(package, options);
  auto runner = std::make_shared<BatchRunner>(std::move(graph), package.limits.intermediate_bytes,
                                              options.precision, options.compile && channels_last);
  return std::make_shared<Pt2Classifier>(package.path, package.card, std::move(runner),
                                         channels_last, options);
}

std::shared_ptr<Classifier> load_checked(const Package& package, Progress* warn,
                                         const ModelOptions& options) {
  const fs::path& path = package.path;
  const auto classifier = build(package, options);
  const ProbeReport& report = classifier->probe();
  if (package.card.probe.cases.empty() && warn != nullptr) {
    warn->note(path.string() + ": its card has no probe, so its answers are not checked");
  }
  if (!report.present || model::probe_holds(report, options.precision)) return classifier;
  if (!options.fold_batch_norm && !options.channels_last && !options.compile) {
    throw_probe(path, report, options.precision);
  }
  ModelOptions careful = options;
  careful.fold_batch_norm = careful.channels_last = careful.compile = false;
  const auto plain = build(package, careful);
  if (!model::probe_holds(plain->probe(), options.precision)) {
    throw_probe(path, plain->probe(), options.precision);
  }
  if (warn != nullptr) {
    warn->note(path.string() +
               ": runs without batch-norm folding, channels-last and compilation, with which " +
               describe(report));
  }
  return plain;
}

/// Reads the card, maps the archive, and checks that they belong together.
Package open_package(const fs::path& path, const ModelLimits& limits) {
  fs::path card = path;
  card.replace_extension(".json");
  if (!fs::exists(card)) {
    throw InputError(path, "has no card " + card.filename().string() +
                               " beside it; write one with 'python -m tt3d_tools.card'");
  }
  Package package{path, model::read_card(card, limits), nullptr, limits};
  package.archive = MappedFile::open(path, limits.archive_bytes);
  check_sha256(*package.archive, package.card);
  return package;
}

}  // namespace

at::Tensor probabilities(const Classifier& model, const at::Tensor& logits) {
  switch (model.scores()) {
    case Scores::kSoftmax:
      return logits.softmax(1);
    case Scores::kSigmoid:
      return logits.sigmoid();
    case Scores::kNone:
      return logits;
  }
  return logits;
}

WeightsGuard::WeightsGuard(std::vector<std::shared_ptr<const Classifier>> models)
    : models_(std::move(models)) {
  for (const auto& model : models_) hashes_.push_back(model->weights_hash());
}

void WeightsGuard::check() const {
  for (size_t m = 0; m < models_.size(); ++m) {
    if (models_[m]->weights_hash() == hashes_[m]) continue;
    throw Error(models_[m]->path().string() +
                ": its weights changed while it was used, so the result is not valid; please "
                "report this fault of tt3d with the model's name");
  }
}

std::shared_ptr<Classifier> Classifier::load(const std::string& name, const ModelLimits& limits,
                                             Progress* warn, const ModelOptions& options) {
  if (!options.allow_slow) model::check_precision(options.precision);
  const fs::path path = find_model(name);
  try {
    return load_checked(open_package(path, limits), warn, options);
  } catch (const Malformed& error) {
    throw InputError(path, error.what());
  } catch (const c10::Error& error) {
    const std::string text = error.what_without_backtrace();
    throw InputError(path, text.substr(0, text.find('\n')));
  } catch (const std::bad_alloc&) {
    throw ResourceError(path.string() + ": out of memory");
  }
}

}  // namespace tt3d::model
