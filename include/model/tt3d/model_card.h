#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tt3d/record.h"

/// What a model package says about itself, and the limits it is read under. Needs no torch.
namespace tt3d::model {

/// The card of a model package (docs/model.md).
struct ModelCard {
  std::string name, architecture, source, licence;
  int64_t height = 0, width = 0;    ///< input size in pixels
  int64_t resize = 0;               ///< shorter side before the centre crop
  std::string interpolation;        ///< "bilinear" or "bicubic"
  std::vector<double> mean, std;    ///< per RGB channel, of values in [0,1]
  std::vector<std::string> labels;  ///< one name per class, in order of the logits
  std::vector<std::string> wnids;   ///< WordNet ids when the labels are imagenet-1k, else empty
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

/// The class with that index ("849"), WordNet id ("n04398044") or name ("teapot").
/// Throws InputError: unknown (with the nearest names) or ambiguous (with the candidates).
[[nodiscard]] ClassId find_class(const std::string& text, const ModelCard& card);

}  // namespace tt3d::model
