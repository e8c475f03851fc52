#include "card.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "json_numbers.h"

namespace tt3d::model {
namespace {

using Json = nlohmann::json;

constexpr int64_t kMaxSide = 8192;
constexpr int64_t kMaxProbeBatch = 64;
constexpr const char* kImagenet = "imagenet-1k";
constexpr const char* kProbeRule = "waves-1";

/// True for the 80 classes of COCO, or its 91 ids, in their order.
bool are_coco(const std::vector<std::string>& labels) {
  return (labels.size() == 80 || labels.size() == 90 || labels.size() == 91) &&
         labels[0] == "person" && labels[1] == "bicycle" && labels.back() == "toothbrush";
}

/// Typed access to a card's keys; errors name the file and the key.
class CardReader {
 public:
  CardReader(const std::filesystem::path& path, const ModelLimits& limits) : path_(path) {
    const std::string content = read_file(path);
    const auto shallow = [&](int depth, Json::parse_event_t, Json&) {
      if (depth > limits.json_depth) fail("is nested too deeply");
      return true;
    };
    try {
      document_ = Json::parse(content, shallow);
    } catch (const Json::exception& error) {
      fail(fmt::format("is not valid JSON: {}", error.what()));
    }
    if (!document_.is_object()) fail("is not a JSON object");
  }

  CardFile read() {
    CardFile file;
    read_texts(file.card);
    read_picture(file.card);
    read_labels(file.card);
    if (document_.contains("probe") && !document_["probe"].is_null()) read_probe(file);
    return file;
  }

 private:
  [[noreturn]] void fail(const std::string& problem) const { throw InputError(path_, problem); }

  const Json& need(const char* key, const char* expected) const {
    if (!document_.contains(key) || document_[key].is_null()) {
      fail(
          fmt::format("has no '{}', expected {}; without it pictures cannot be prepared as the "
                      "model was trained",
                      key, expected));
    }
    return document_[key];
  }

  std::string text(const char* key) const {
    if (!document_.contains(key) || document_[key].is_null()) return "";
    if (!document_[key].is_string()) fail(fmt::format("'{}' must be a string", key));
    return document_[key].get<std::string>();
  }

  void read_texts(ModelCard& card) const {
    card.name = text("name");
    if (card.name.empty()) card.name = path_.stem().string();
    card.architecture = text("architecture");
    card.source = text("source");
    card.licence = text("licence");
    card.sha256 = text("sha256");
    if (card.sha256.size() != 64) {
      fail("'sha256' must be the 64 hex digits of the .pt2 file's SHA-256");
    }
  }

  int64_t side(const Json& value, const char* key) const {
    if (!value.is_number_integer() || value.get<int64_t>() < 1 || value.get<int64_t>() > kMaxSide) {
      fail(fmt::format("'{}' must be an integer number of pixels from 1 to {}", key, kMaxSide));
    }
    return value.get<int64_t>();
  }

  std::vector<double> channels(const char* key, bool positive) const {
    const Json& list = need(key, "three numbers, one per channel");
    std::vector<double> values;
    for (const Json& item : list) {
      if (item.is_number()) values.push_back(item.get<double>());
    }
    bool fine = list.is_array() && list.size() == 3 && values.size() == 3;
    for (const double value : values) fine &= std::isfinite(value) && (!positive || value > 0);
    if (!fine) {
      fail(fmt::format("'{}' must be three {} numbers, for pictures in [0,1]", key,
                       positive ? "positive" : "finite"));
    }
    return values;
  }

  void read_picture(ModelCard& card) const {
    const Json& size = need("input_size", "[height, width]");
    if (!size.is_array() || size.size() != 2) fail("'input_size' must be [height, width]");
    card.height = side(size[0], "input_size");
    card.width = side(size[1], "input_size");
    card.resize = std::max(card.height, card.width);
    if (document_.contains("resize") && !document_["resize"].is_null()) {
      card.resize = side(document_["resize"], "resize");
    }
    if (card.resize < std::max(card.height, card.width)) {
      fail("'resize' must be at least the input size, which is cropped from it");
    }
    card.interpolation = text("interpolation");
    if (card.interpolation.empty()) card.interpolation = "bilinear";
    if (card.interpolation != "bilinear" && card.interpolation != "bicubic") {
      fail(
          fmt::format("'interpolation' is '{}', expected bilinear or bicubic", card.interpolation));
    }
    card.mean = channels("mean", false);
    card.std = channels("std", true);
    check_unit_range(card);
    const std::string scores = text("scores");
    if (!scores.empty()) card.scores = read_scores(scores);
  }

  /// Pictures have values in [0,1], so neither their mean nor their spread can be larger.
  void check_unit_range(const ModelCard& card) const {
    constexpr double kLargest = 2;  // some networks take pictures in [-1,1]: mean and std of 0.5
    for (const auto* values : {&card.mean, &card.std}) {
      for (const double value : *values) {
        if (std::abs(value) <= kLargest) continue;
        const auto unit = [](const std::vector<double>& v) {
          return fmt::format("[{:.6g}, {:.6g}, {:.6g}]", v[0] / 255, v[1] / 255, v[2] / 255);
        };
        fail(fmt::format(
            "'{}' is for pictures in [0,255], expected values for pictures in [0,1]; divide both "
            "by 255: \"mean\": {}, \"std\": {}",
            values == &card.mean ? "mean" : "std", unit(card.mean), unit(card.std)));
      }
    }
  }

  Scores read_scores(const std::string& name) const {
    try {
      return parse_enum<Scores>(name);
    } catch (const InputError& error) {
      fail(fmt::format("'scores': {}", error.what()));
    }
  }

  void read_labels(ModelCard& card) const {
    card.label_set = text("label_set");
    const Json& labels = need("labels", "\"imagenet-1k\" or a list of names");
    if (labels.is_string() && labels.get<std::string>() == kImagenet) {
      for (const ImagenetClass& one : imagenet_classes()) {
        card.labels.push_back(one.names.front());
        card.wnids.push_back(one.wnid);
      }
      card.label_set = kImagenet;
      return;
    }
    if (!labels.is_array()) fail("'labels' must be \"imagenet-1k\" or a list of names");
    for (const Json& label : labels) {
      if (!label.is_string()) fail("'labels' must contain strings");
      card.labels.push_back(label.get<std::string>());
    }
    if (card.label_set.empty() && are_coco(card.labels)) card.label_set = "coco";
  }

  void read_probe(CardFile& file) const {
    const Json& probe = document_["probe"];
    try {
      if (probe.at("rule") != kProbeRule) {
        fail(
            fmt::format("'probe' follows a rule this version does not know (expected '{}'); "
                        "export the model again",
                        kProbeRule));
      }
      file.probe.seed = static_cast<uint64_t>(read_integer(probe.at("seed")));
      for (const Json& one : probe.at("cases")) file.probe.cases.push_back(read_case(one, file));
    } catch (const Json::exception& error) {
      fail(fmt::format("'probe' is malformed: {}", error.what()));
    } catch (const Malformed& error) {
      fail(fmt::format("'probe' is malformed: {}", error.what()));
    }
  }

  ProbeCase read_case(const Json& json, const CardFile& file) const {
    ProbeCase one;
    one.batch = read_integer(json.at("batch"));
    one.logits = json.at("logits").get<std::vector<std::vector<double>>>();
    for (const Json& index : json.at("classes")) one.classes.push_back(read_integer(index));
    one.gradient_norm = json.at("gradient_norm").get<double>();
    one.gradient = json.at("gradient").get<std::vector<double>>();
    const auto batch = static_cast<size_t>(one.batch);
    const auto labels = file.card.labels.size();
    bool fine = json.at("classes").is_array() && one.batch >= 1 && one.batch <= kMaxProbeBatch &&
                one.logits.size() == batch && one.classes.size() == batch && !one.gradient.empty();
    for (const auto& row : one.logits) fine &= row.size() == labels;
    for (const int64_t index : one.classes) {
      fine &= index >= 0 && index < static_cast<int64_t>(labels);
    }
    if (!fine) fail("'probe' contains lists of different lengths");
    return one;
  }

  std::filesystem::path path_;
  Json document_;
};

}  // namespace

CardFile read_card(const std::filesystem::path& path, const ModelLimits& limits) {
  return CardReader(path, limits).read();
}

}  // namespace tt3d::model
