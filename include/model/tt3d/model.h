#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/model_card.h"

/// Classifiers as data: a torch.export archive (.pt2) and its card (.json), read without executing
/// anything in them and run through the ATen dispatcher with gradients.
namespace tt3d {

/// Number format of convolutions and matrix products. Weights, images and logits are float32 all
/// the same.
enum class Precision {
  kFloat32,
  kBfloat16,  ///< both factors rounded to bfloat16, as torch's autocast does it
  kTf32,      ///< on CUDA: factors rounded to 10 bits; holds for the whole process once used
};

/// How a graph is run. The defaults are the fast way; the probe of the card is checked with them,
/// and a model whose probe only holds without them is run without.
struct ModelOptions {
  bool fold_batch_norm = true;  ///< into the convolution before it, else a multiply-add
  bool channels_last = true;    ///< run convolutions channels-last where the graph allows it
  bool check_probe = true;      ///< compare with the card's probe
  /// Below float32 the probe's bounds are wider: docs/model.md, "Speed".
  Precision precision = Precision::kFloat32;
  bool allow_slow = false;  ///< a reduced precision also where float32 is faster
};

/// What the probe of the card found.
struct ProbeReport {
  bool present = false;        ///< the card has a probe and the logits were compared
  bool gradients = false;      ///< the gradients were compared, too
  double logit_error = 0;      ///< largest difference over the range of the expected logits
  double gradient_cosine = 1;  ///< smallest cosine of the input gradient, over the cases
  double gradient_ratio = 1;   ///< norm over expected norm, the case furthest from 1
};

/// Competition for pictures on their way through a network: some of its layers see a share of what
/// other pictures make of them (clean feature mixup; Byun et al., CVPR 2023). No gradient flows to
/// the other pictures.
struct FeatureMix {
  at::Tensor images;  ///< [N,3,H,W], the competitor of each picture
  /// With which a layer mixes: a convolution or a linear one, all but the last.
  double probability = 0;
  double share = 0.75;  ///< each channel of each picture takes U(0, share) of its competitor's
  uint64_t seed = 0, step = 0;  ///< key of the draws
};

/// An image classifier whose weights cannot change. Safe to call from one thread at a time.
class Classifier {
 public:
  /// `model` is a path to a .pt2 or a name found in models/ or $TT3D_MODELS.
  /// Throws InputError for anything wrong with archive, card or probe, and for a precision that
  /// the machine lacks; ResourceError where memory does not suffice. `warn` receives warnings (a
  /// card without a probe). The archive stays mapped: replace it only by renaming another over it.
  static std::shared_ptr<Classifier> load(const std::string& model, const ModelLimits& limits = {},
                                          Progress* warn = nullptr,
                                          const ModelOptions& options = {});
  virtual ~Classifier() = default;

  [[nodiscard]] virtual const ModelCard& card() const = 0;
  /// images [N,3,H,W] float32, RGB sRGB in [0,1], of the card's input size; returns logits
  /// float32 [N,classes]. Normalises by the card; differentiable with respect to the images. A
  /// batch that does not fit in memory runs in parts; with gradients its backward then runs
  /// forward again, so that one part's intermediate results are held at a time. Throws InputError
  /// for other images, ResourceError where not even one image fits.
  [[nodiscard]] virtual at::Tensor logits(const at::Tensor& images) const = 0;
  /// The same with mixed features; `mix.images` are like `images`. A classifier without layers of
  /// its own has nothing to mix.
  [[nodiscard]] virtual at::Tensor mixed_logits(const at::Tensor& images,
                                                const FeatureMix& mix) const {
    static_cast<void>(mix);
    return logits(images);
  }
  /// SHA-256 over all parameters and buffers as they are used (after folding): the same before
  /// and after any use.
  [[nodiscard]] virtual std::string weights_hash() const = 0;
  /// How well the model agreed with its card's probe, as far as it was compared.
  [[nodiscard]] virtual const ProbeReport& probe() const = 0;
  /// Compares the gradients of the card's probe, once. Loading compares the logits; this holds all
  /// activations and costs more than loading, so it waits until logits() is first asked for a
  /// gradient, or for this call. Throws InputError if they differ.
  virtual void check_gradients() const {}
  /// The archive this was read from.
  [[nodiscard]] virtual const std::filesystem::path& path() const = 0;
};

/// Folders that model names are looked up in, in order: ./models, those of $TT3D_MODELS
/// (separated by ':'), and the source tree's models/ if it exists.
[[nodiscard]] std::vector<std::filesystem::path> model_folders();

/// A package found by name.
struct ModelEntry {
  std::string name;            ///< file name without .pt2
  std::filesystem::path path;  ///< of the .pt2
};
/// All packages of model_folders(), by name; the first folder wins.
[[nodiscard]] std::vector<ModelEntry> list_models();

/// Path of the archive for a path or a name. Throws InputError that says where it looked.
[[nodiscard]] std::filesystem::path find_model(const std::string& model);

/// The picture a classifier sees of an image, as its users would make it: resize the shorter side
/// to the card's `resize` (antialiased, as Pillow does it), then centre crop to the input size.
/// images [N,3,h,w] float32 in [0,1]; returns [N,3,H,W]; differentiable.
[[nodiscard]] at::Tensor preprocess(const at::Tensor& images, const ModelCard& card);

}  // namespace tt3d
