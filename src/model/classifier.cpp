#include <ATen/ATen.h>
#include <fmt/format.h>

#include <mutex>
#include <new>
#include <optional>

#include "archive.h"
#include "card.h"
#include "graph_reader.h"
#include "malformed.h"
#include "probe.h"
#include "program.h"
#include "rewrite.h"
#include "tt3d/model.h"

namespace tt3d {
namespace fs = std::filesystem;
namespace {

using model::CardFile;
using model::Graph;
using model::Malformed;

at::Tensor channel_tensor(const std::vector<double>& values) {
  return at::tensor(values, at::kDouble).to(at::kFloat).view({1, 3, 1, 1});
}

/// Runs the graph of a package; see tt3d/model.h.
class Pt2Classifier final : public Classifier {
 public:
  Pt2Classifier(fs::path path, const CardFile& file, Graph graph, const ModelLimits& limits,
                bool channels_last)
      : path_(std::move(path)),
        card_(file.card),
        limits_(limits),
        channels_last_(channels_last),
        graph_(std::move(graph)),
        mean_(channel_tensor(card_.mean)),
        std_(channel_tensor(card_.std)) {}

  const ModelCard& card() const override { return card_; }
  const ProbeReport& probe() const override { return probe_; }
  const fs::path& path() const override { return path_; }
  void set_probe(const ProbeReport& report) { probe_ = report; }

  at::Tensor logits(const at::Tensor& images) const override {
    check_images(images);
    const Graph& graph = graph_on(images.device());
    at::Tensor input = (images - mean_.to(images.device())) / std_.to(images.device());
    if (channels_last_) input = input.contiguous(at::MemoryFormat::ChannelsLast);
    try {
      return run_chunks(graph, input);
    } catch (const Malformed& error) {
      throw InputError(path_, error.what());
    }
  }

  std::string weights_hash() const override {
    std::string digests;
    for (const auto& [slot, tensor] : graph_.constants) {
      const at::Tensor bytes = tensor.cpu().contiguous();
      digests += graph_.names[static_cast<size_t>(slot)];
      digests += sha256({static_cast<const char*>(bytes.const_data_ptr()), bytes.nbytes()});
    }
    return sha256(digests);
  }

 private:
  void check_images(const at::Tensor& images) const {
    if (images.dim() == 4 && images.size(0) > 0 && images.size(1) == 3 &&
        images.size(2) == card_.height && images.size(3) == card_.width &&
        images.scalar_type() == at::kFloat) {
      return;
    }
    throw InputError(fmt::format("model {}: expected float32 images [N,3,{},{}]; use preprocess()",
                                 card_.name, card_.height, card_.width));
  }

  /// The graph with its weights on `device`; the last device other than the CPU is kept.
  const Graph& graph_on(at::Device device) const {
    if (device.is_cpu()) return graph_;
    if (!moved_ || moved_device_ != device) {
      moved_ = graph_;
      moved_device_ = device;
      for (auto& [slot, tensor] : moved_->constants) tensor = tensor.to(device);
    }
    return *moved_;
  }

  /// Batches beyond the exported range run in parts.
  at::Tensor run_chunks(const Graph& graph, const at::Tensor& input) const {
    const int64_t total = input.size(0);
    if (total <= graph.max_batch) return run_split(graph, input);
    std::vector<at::Tensor> parts;
    for (int64_t start = 0; start < total; start += graph.max_batch) {
      const int64_t end = std::min(total, start + graph.max_batch);
      parts.push_back(run_split(graph, input.slice(0, start, end)));
    }
    return at::cat(parts, 0);
  }

  /// Halves the batch while it does not fit in memory.
  at::Tensor run_split(const Graph& graph, const at::Tensor& input) const {
    const int64_t count = input.size(0);
    try {
      return run_padded(graph, input);
    } catch (const model::MemoryLimit& error) {
      if (count == 1) throw ResourceError(path_.string() + ": " + error.what());
    } catch (const std::bad_alloc&) {
      if (count == 1) throw ResourceError(path_.string() + ": out of memory at batch 1");
    }
    const at::Tensor first = run_split(graph, input.slice(0, 0, count / 2));
    return at::cat({first, run_split(graph, input.slice(0, count / 2, count))}, 0);
  }

  /// Batches below the exported range are filled up with zeros.
  at::Tensor run_padded(const Graph& graph, const at::Tensor& input) const {
    const int64_t count = input.size(0), missing = graph.min_batch - count;
    if (missing <= 0) return checked(graph, run(graph, input), count);
    const at::Tensor filler = at::zeros({missing, 3, card_.height, card_.width}, input.options());
    const at::Tensor padded = at::cat({input, filler}, 0);
    return checked(graph, run(graph, padded), graph.min_batch).slice(0, 0, count);
  }

  at::Tensor run(const Graph& graph, const at::Tensor& input) const {
    return model::run_graph(graph, input, limits_.intermediate_bytes);
  }

  static at::Tensor checked(const Graph& graph, const at::Tensor& logits, int64_t count) {
    if (logits.dim() != 2 || logits.size(0) != count || logits.size(1) != graph.classes ||
        logits.scalar_type() != at::kFloat) {
      throw Malformed("the graph did not give float32 logits [N,classes]");
    }
    return logits;
  }

  fs::path path_;
  ModelCard card_;
  ModelLimits limits_;
  bool channels_last_;
  Graph graph_;
  at::Tensor mean_, std_;
  ProbeReport probe_;
  mutable std::optional<Graph> moved_;
  mutable at::Device moved_device_ = at::kCPU;
};

void check_sha256(const fs::path& archive, const CardFile& file) {
  const std::string actual = sha256_file(archive);
  if (actual == file.card.sha256) return;
  throw InputError(archive, fmt::format("SHA-256 is {}, its card says {}; the files do not belong "
                                        "together or one is damaged",
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
}

/// Reads the archive and prepares it as `options` say; probes it.
std::shared_ptr<Pt2Classifier> build(const fs::path& path, const CardFile& file,
                                     const ModelLimits& limits, const ModelOptions& options) {
  Graph graph = model::read_graph(model::Archive(path, limits), limits);
  check_against_card(graph, file.card);
  if (options.fold_batch_norm) {
    model::fold_batch_norms(graph);
    model::simplify_batch_norms(graph);
  }
  const bool channels_last = options.channels_last && model::use_channels_last(graph);
  model::find_last_uses(graph);
  auto classifier =
      std::make_shared<Pt2Classifier>(path, file, std::move(graph), limits, channels_last);
  if (!options.check_probe || file.probe.cases.empty()) return classifier;
  classifier->set_probe(
      model::run_probe(file, [&](const at::Tensor& images) { return classifier->logits(images); }));
  return classifier;
}

std::string describe(const ProbeReport& report) {
  return fmt::format(
      "logits off by {:.2g} of their range, cosine of the input gradient {:.6f}, "
      "norm ratio {:.4f}",
      report.logit_error, report.gradient_cosine, report.gradient_ratio);
}

[[noreturn]] void throw_probe(const fs::path& path, const ProbeReport& report) {
  throw InputError(path, fmt::format("the probe of its card disagrees ({}); the card belongs to "
                                     "another model, export it again",
                                     describe(report)));
}

std::shared_ptr<Classifier> load_checked(const fs::path& path, const CardFile& file,
                                         const ModelLimits& limits, Progress* warn,
                                         const ModelOptions& options) {
  const auto classifier = build(path, file, limits, options);
  if (file.probe.cases.empty() && warn != nullptr) {
    warn->note(path.string() + ": its card has no probe, so its answers are not checked");
  }
  if (!classifier->probe().present || model::probe_holds(classifier->probe())) return classifier;
  if (!options.fold_batch_norm && !options.channels_last) throw_probe(path, classifier->probe());
  const auto plain = build(path, file, limits, {false, false, true});
  if (!model::probe_holds(plain->probe())) throw_probe(path, plain->probe());
  if (warn != nullptr) {
    warn->note(path.string() + ": runs without batch-norm folding and channels-last, with which " +
               describe(classifier->probe()));
  }
  return plain;
}

}  // namespace

std::shared_ptr<Classifier> Classifier::load(const std::string& name, const ModelLimits& limits,
                                             Progress* warn, const ModelOptions& options) {
  const fs::path path = find_model(name);
  fs::path card = path;
  card.replace_extension(".json");
  if (!fs::exists(card)) {
    throw InputError(path, "has no card " + card.filename().string() +
                               " beside it; write one with 'python -m tt3d_tools.card'");
  }
  const CardFile file = model::read_card(card, limits);
  check_sha256(path, file);
  try {
    return load_checked(path, file, limits, warn, options);
  } catch (const Malformed& error) {
    throw InputError(path, error.what());
  } catch (const c10::Error& error) {
    const std::string text = error.what_without_backtrace();
    throw InputError(path, text.substr(0, text.find('\n')));
  } catch (const std::bad_alloc&) {
    throw ResourceError(path.string() + ": out of memory");
  }
}

}  // namespace tt3d
