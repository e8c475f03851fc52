#include "probe.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/variable.h>

#include <cmath>
#include <numbers>

namespace tt3d::model {
namespace {

/// The largest differences that rounding alone may cause.
struct Bounds {
  double logit_error, cosine, norm_error;
};

Bounds bounds_of(Precision precision) {
  // Another summation order of float32 convolutions stays a hundred times below these bounds.
  if (precision == Precision::kFloat32) return {1e-3, 0.999, 1e-2};
  return {5e-2, 0.95, 0.2};
}

/// The finaliser of MurmurHash3 over index and seed.
uint32_t mix(uint64_t index, uint64_t seed) {
  auto h = static_cast<uint32_t>(index + seed * 0x9E3779B9U);
  h ^= h >> 16;
  h *= 0x85EBCA6BU;
  h ^= h >> 13;
  h *= 0xC2B2AE35U;
  return h ^ (h >> 16);
}

double logit_error(const at::Tensor& logits, const ProbeCase& expected) {
  const at::Tensor actual = logits.detach().to(at::kDouble).contiguous();
  const double* value = actual.const_data_ptr<double>();
  double low = INFINITY, high = -INFINITY, worst = 0;
  for (const auto& row : expected.logits) {
    for (const double want : row) {
      low = std::min(low, want);
      high = std::max(high, want);
      const double difference = std::abs(*value++ - want);
      // NaN counts as an infinite error.
      worst = difference >= 0 ? std::max(worst, difference) : INFINITY;
    }
  }
  return worst / std::max(high - low, 1e-30);
}

/// Updates `report` if this gradient is worse than the worst so far.
void compare_gradient(const at::Tensor& gradient, const ProbeCase& expected, uint64_t seed,
                      ProbeReport& report) {
  const at::Tensor flat = gradient.detach().to(at::kDouble).contiguous().reshape(-1);
  const double* value = flat.const_data_ptr<double>();
  const auto where = probe_positions(flat.numel(), expected.gradient.size(), seed);
  double dot = 0, own = 0, other = 0;
  for (size_t i = 0; i < where.size(); ++i) {
    const double have = value[where[i]], want = expected.gradient[i];
    dot += have * want;
    own += have * have;
    other += want * want;
  }
  const double cosine = own + other == 0 ? 1 : dot / std::max(std::sqrt(own * other), 1e-300);
  const double norm = flat.norm().item<double>();
  const double ratio = norm == expected.gradient_norm ? 1 : norm / expected.gradient_norm;
  // NaN counts as an infinite error.
  if (!(cosine >= report.gradient_cosine)) report.gradient_cosine = cosine;
  if (!(std::abs(ratio - 1) <= std::abs(report.gradient_ratio - 1))) report.gradient_ratio = ratio;
}

at::Tensor images_of(const ProbeCase& expected, const CardFile& file) {
  return probe_images(expected.batch, file.card.height, file.card.width, file.probe.seed);
}

}  // namespace

at::Tensor probe_images(int64_t batch, int64_t height, int64_t width, uint64_t seed) {
  at::Tensor images = at::empty({batch, 3, height, width}, at::kFloat);
  auto* out = images.data_ptr<float>();
  uint64_t index = 0;
  for (int64_t n = 0; n < batch; ++n) {
    for (int64_t c = 0; c < 3; ++c) {
      for (int64_t y = 0; y < height; ++y) {
        for (int64_t x = 0; x < width; ++x, ++index) {
          const double across = static_cast<double>((2 + c + n) * x) / static_cast<double>(width);
          const double down = static_cast<double>((3 - c + n) * y) / static_cast<double>(height);
          const double phase = 2 * std::numbers::pi * (across + down) + static_cast<double>(n + c);
          const double noise = static_cast<double>(mix(index, seed)) / 4294967296.0 - 0.5;
          out[index] = static_cast<float>(0.5 + 0.3 * std::sin(phase) + 0.3 * noise);
        }
      }
    }
  }
  return images;
}

std::vector<int64_t> probe_positions(int64_t total, size_t count, uint64_t seed) {
  std::vector<int64_t> positions;
  for (size_t i = 0; i < count; ++i) positions.push_back(mix(i, seed + 1) % total);
  return positions;
}

ProbeReport probe_logits(const CardFile& file, const Logits& logits) {
  const at::NoGradGuard no_gradients;
  ProbeReport report;
  for (const ProbeCase& expected : file.probe.cases) {
    report.present = true;
    std::vector<at::Tensor> answers;  // one image at a time, to save memory
    for (const at::Tensor& image : images_of(expected, file).split(1)) {
      answers.push_back(logits(image));
    }
    const double error = logit_error(at::cat(answers), expected);
    report.logit_error = std::max(report.logit_error, error);
  }
  return report;
}

void probe_gradients(const CardFile& file, const Logits& logits, ProbeReport& report) {
  const at::AutoGradMode with_gradients(true);
  for (const ProbeCase& expected : file.probe.cases) {
    const at::Tensor images = images_of(expected, file).requires_grad_(true);
    const at::Tensor classes = at::tensor(expected.classes, at::kLong).unsqueeze(1);
    const at::Tensor answer = logits(images);
    report.logit_error = std::max(report.logit_error, logit_error(answer, expected));
    const auto gradient = torch::autograd::grad({answer.gather(1, classes).sum()}, {images});
    compare_gradient(gradient[0], expected, file.probe.seed, report);
    report.gradients = true;
  }
}

bool probe_holds(const ProbeReport& report, Precision precision) {
  const Bounds bounds = bounds_of(precision);
  return report.logit_error <= bounds.logit_error && report.gradient_cosine >= bounds.cosine &&
         std::abs(report.gradient_ratio - 1) <= bounds.norm_error;
}

}  // namespace tt3d::model
