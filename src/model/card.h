#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/model_card.h"

namespace tt3d::model {

/// The model's results for `batch` probe images at export.
struct ProbeCase {
  int64_t batch = 0;
  std::vector<std::vector<double>> logits;  ///< [batch][classes]
  std::vector<int64_t> classes;             ///< per image, the class of the gradient
  double gradient_norm = 0;
  std::vector<double> gradient;  ///< at probe_positions()
};

/// The probe of a card: rule "waves-1" (docs/model.md), computed by probe_images().
struct Probe {
  uint64_t seed = 0;
  std::vector<ProbeCase> cases;  ///< empty if the card has no probe
};

/// A card with its probe, for the reader.
struct CardFile {
  ModelCard card;
  Probe probe;
};

/// Reads and validates NAME.json. Throws InputError that names the missing or wrong key.
[[nodiscard]] CardFile read_card(const std::filesystem::path& path, const ModelLimits& limits);

/// One ImageNet class: WordNet id and names.
struct ImagenetClass {
  std::string wnid;
  std::vector<std::string> names;
};
/// The 1000 classes of ImageNet-1k in order of the logits.
[[nodiscard]] const std::vector<ImagenetClass>& imagenet_classes();

}  // namespace tt3d::model
