#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/model_card.h"

/// Classifiers as data: a torch.export archive (.pt2) and its card (.json). Nothing in them is
/// executed as code; the graph runs through the ATen dispatcher, with gradients.
namespace tt3d::model {

/// Number format of convolutions and matrix products. Weights, images and logits are float32 in
/// every case.
enum class Precision {
  kFloat32,
  kBfloat16,  ///< both factors rounded to bfloat16, as torch's autocast does
  kTf32,      ///< on CUDA: factors rounded to 10 bits; once used, holds for the whole process
};

/// How a graph is run. The defaults are the fast way. The probe of the card is checked with them;
/// if it fails, the model runs without them, provided that the probe passes then.
struct ModelOptions {
  bool fold_batch_norm = true;  ///< into the preceding convolution, else into a multiply-add
  bool channels_last = true;    ///< run convolutions channels-last if the graph allows it
  bool compile = true;          ///< on the CPU, run convolutional networks as a compiled plan
  bool check_probe = true;      ///< compare with the card's probe
  /// Below float32 the probe's bounds are wider: docs/model.md, "Speed".
  Precision precision = Precision::kFloat32;
  bool allow_slow = false;  ///< use a reduced precision even if float32 is faster
};

/// What the probe of the card found.
struct ProbeReport {
  bool present = false;        ///< the card has a probe and the logits were compared
  bool gradients = false;      ///< the gradients were compared too
  double logit_error = 0;      ///< largest difference over the range of the expected logits
  double gradient_cosine = 1;  ///< smallest cosine of the input gradient over the cases
  double gradient_ratio = 1;   ///< norm / expected norm, of the case furthest from 1
};

/// Clean feature mixup (Byun et al., CVPR 2023): some layers of the network mix the features of a
/// picture with those of another, its competitor. No gradient flows to the competitors.
struct FeatureMix {
  at::Tensor images;  ///< [N,3,H,W], the competitor of each picture
  /// Probability that a layer mixes. All convolutions and linear layers but the last can mix.
  double probability = 0;
  double share = 0.75;          ///< weight of the competitor, U(0, share) per channel and picture
  uint64_t seed = 0, step = 0;  ///< key of the draws
};

/// An image classifier whose weights cannot change. Safe to call from one thread at a time.
class Classifier {
 public:
  /// `model` is a path to a .pt2 or a name found in models/ or $TT3D_MODELS. Throws InputError for
  /// anything wrong with archive, card or probe, and for a precision that the machine does not
  /// support; ResourceError if memory does not suffice. `warn` receives warnings (a card without a
  /// probe). The archive stays mapped: replace it only by renaming another over it.
  static std::shared_ptr<Classifier> load(const std::string& model, const ModelLimits& limits = {},
                                          Progress* warn = nullptr,
                                          const ModelOptions& options = {});
  virtual ~Classifier() = default;

  [[nodiscard]] virtual const ModelCard& card() const = 0;
  /// images [N,3,H,W] float32, RGB sRGB in [0,1], of the card's input size; returns logits float32
  /// [N,classes]. Normalises by the card; differentiable with respect to the images. A batch that
  /// does not fit in memory runs in parts. With gradients, the backward pass then runs each part's
  /// forward pass again, so that memory holds the intermediate results of one part only. Throws
  /// InputError for other images, ResourceError if not even one image fits.
  [[nodiscard]] virtual at::Tensor logits(const at::Tensor& images) const = 0;
  /// How logits become probabilities: what the card says, else by the kind of network.
  [[nodiscard]] virtual Scores scores() const { return card().scores.value_or(Scores::kSoftmax); }
  /// True if the network scores anchors, as detectors do; `logits` gives the best score per class.
  [[nodiscard]] virtual bool is_detector() const { return false; }
  /// Number of a detector's anchors; 0 if the file does not state it.
  [[nodiscard]] virtual int64_t anchors() const { return 0; }
  /// The same with mixed features; `mix.images` are like `images`. A classifier without layers of
  /// its own ignores `mix`.
  [[nodiscard]] virtual at::Tensor mixed_logits(const at::Tensor& images,
                                                const FeatureMix& mix) const {
    static_cast<void>(mix);
    return logits(images);
  }
  /// SHA-256 over all parameters and buffers as they are used: after folding, and on a GPU the copy
  /// there. It never changes.
  [[nodiscard]] virtual std::string weights_hash() const = 0;
  /// How well the model agreed with its card's probe, as far as the two were compared.
  [[nodiscard]] virtual const ProbeReport& probe() const = 0;
  /// Compares the gradients of the card's probe, once. Loading compares only the logits: the
  /// gradients hold all activations and cost more than loading. The comparison therefore waits for
  /// the first logits() with a gradient, or for this call. Throws InputError if they differ.
  virtual void check_gradients() const {}
  /// The archive this was read from.
  [[nodiscard]] virtual const std::filesystem::path& path() const = 0;
};

/// Probabilities [N,classes] for logits [N,classes] of `model`, as its scores() say.
[[nodiscard]] at::Tensor probabilities(const Classifier& model, const at::Tensor& logits);

/// Proves that models stay as they are: takes the hashes of their weights, and compares them later.
class WeightsGuard {
 public:
  explicit WeightsGuard(std::vector<std::shared_ptr<const Classifier>> models);
  /// Throws Error if the weights of a model have changed since construction.
  void check() const;

 private:
  std::vector<std::shared_ptr<const Classifier>> models_;
  std::vector<std::string> hashes_;
};

/// Folders searched for model names, in order: ./models, those of $TT3D_MODELS (separated by ':'),
/// and the source tree's models/ if it exists.
[[nodiscard]] std::vector<std::filesystem::path> model_folders();

/// A package found by name.
struct ModelEntry {
  std::string name;            ///< file name without .pt2
  std::filesystem::path path;  ///< of the .pt2
};
/// All packages of model_folders(), by name; the first folder wins.
[[nodiscard]] std::vector<ModelEntry> list_models();

/// Path of the archive for a path or a name. Throws InputError that lists where it looked.
[[nodiscard]] std::filesystem::path find_model(const std::string& model);

/// The network's input for an image: resizes the shorter side to the card's `resize` (antialiased,
/// as Pillow does), then crops the centre to the input size. images [N,3,h,w] float32 in [0,1];
/// returns [N,3,H,W]; differentiable.
[[nodiscard]] at::Tensor preprocess(const at::Tensor& images, const ModelCard& card);

}  // namespace tt3d::model
