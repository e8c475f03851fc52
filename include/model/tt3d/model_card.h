#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "tt3d/enums.h"
#include "tt3d/record.h"

/// What a model package says about itself, and the limits it is read under. Needs no torch.
namespace tt3d::model {

/// How the numbers that a network gives become probabilities.
enum class Scores {
  kSoftmax,  ///< logits of classes that exclude each other: a classifier
  kSigmoid,  ///< logits of classes that do not, without a class for the background: a detector
  kNone,     ///< the network's last layer makes probabilities itself
};
inline std::array<std::string_view, 3> enum_names(Scores) { return {"softmax", "sigmoid", "none"}; }

/// The card of a model package (docs/model.md).
struct ModelCard {
  std::string name, architecture, source, licence;
  int64_t height = 0, width = 0;    ///< input size in pixels
  int64_t resize = 0;               ///< shorter side before the centre crop
  std::string interpolation;        ///< "bilinear" or "bicubic"
  std::vector<double> mean, std;    ///< per RGB channel, of values in [0,1]
  std::vector<std::string> labels;  ///< one name per class, in order of the logits
  std::vector<std::string> wnids;   ///< WordNet ids when the labels are imagenet-1k, else empty
  std::string label_set;            ///< "imagenet-1k", "coco" or the card's own name; may be empty
  std::optional<Scores> scores;     ///< absent: softmax for a classifier, sigmoid for a detector
  std::string sha256;               ///< of the .pt2
};

/// Limits on what a package may contain.
struct ModelLimits {
  int64_t archive_bytes = int64_t{4} << 30;
  int64_t nodes = 100000;
  int64_t tensor_bytes = int64_t{2} << 30;
  int64_t intermediate_bytes = int64_t{16} << 30;
  int json_depth = 128;
};

using record::ClassId;

/// The class with that index ("849"), WordNet id ("n04398044") or name ("teapot"). A text like
/// "imagenet=hen,coco=bird" names a class for each label set; the part before '=' is a card's
/// label set, its first word, or the name of the model.
/// Throws InputError: unknown (with the nearest names), ambiguous (with the candidates), or no
/// class for the model's label set.
[[nodiscard]] ClassId find_class(const std::string& text, const ModelCard& card);

/// Throws InputError if `text` has a bare index and the models have different labels: the index
/// then means another class in each. `option` names the key or option in the error.
void check_same_class(const std::string& text, const std::vector<const ModelCard*>& cards,
                      const std::string& option);

}  // namespace tt3d::model
