// Program of bench/step.py: runs attack steps of a configuration on a run's mesh, on the CPU. It
// times the classifier's passes inside the steps, where caches and memory are as in an attack.
//
//   step_bench CONFIG RUN MODEL STEPS THREADS
//
// Prints {"step": milliseconds, "classifier": milliseconds}: medians over all steps but the first.
#include <ATen/ATen.h>
#include <ATen/Parallel.h>

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/attack.h"
#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/model.h"
#include "tt3d/run.h"
#include "tt3d/tool.h"

namespace tt3d {
namespace {

using at::Tensor;

/// A classifier that sums the seconds of its passes. Forward: the duration of the call. Backward:
/// from the gradient of the logits to the gradient of the pictures.
class TimedClassifier : public model::Classifier {
 public:
  explicit TimedClassifier(std::shared_ptr<const model::Classifier> model)
      : model_(std::move(model)) {}
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    const double start = now_seconds();
    const Tensor answer = model_->logits(images);
    seconds_ += now_seconds() - start;
    if (answer.requires_grad()) {
      answer.register_hook([this](const Tensor&) { begin_ = now_seconds(); });
      images.register_hook([this](const Tensor&) { seconds_ += now_seconds() - begin_; });
    }
    return answer;
  }
  [[nodiscard]] const model::ModelCard& card() const override { return model_->card(); }
  [[nodiscard]] std::string weights_hash() const override { return model_->weights_hash(); }
  [[nodiscard]] const model::ProbeReport& probe() const override { return model_->probe(); }
  [[nodiscard]] const std::filesystem::path& path() const override { return model_->path(); }
  /// Seconds since the last call.
  double take() const { return std::exchange(seconds_, 0); }

 private:
  std::shared_ptr<const model::Classifier> model_;
  mutable double seconds_ = 0, begin_ = 0;
};

/// Records the duration of each step, and the classifier's part of it.
struct StepTimes : Progress {
  explicit StepTimes(const TimedClassifier& classifier) : model(classifier) {}
  void update(int64_t, const Metrics&) override {
    const double now = now_seconds(), passes = model.take();
    if (last > 0) {
      steps.push_back(1e3 * (now - last));
      classifiers.push_back(1e3 * passes);
    }
    last = now;
  }
  const TimedClassifier& model;
  double last = 0;
  std::vector<double> steps, classifiers;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<int64_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

void measure(char** argv) {
  run::RunConfig config = run::load_config(argv[1]);
  const std::filesystem::path run = argv[2];
  config.attack.options.schedule.steps = std::atoll(argv[4]);
  if (config.attack.options.schedule.steps < 2) throw InputError("STEPS: expected 2 or more");
  at::set_num_threads(std::atoi(argv[5]));

  const auto model = std::make_shared<TimedClassifier>(model::Classifier::load(argv[3]));
  attack::AttackInput input;
  input.object = object::load_object(run / "mesh/mesh.safetensors");
  Progress quiet;
  input.frame = capture::capture_view_frame(capture::load_capture(config.capture, quiet));
  input.surrogates = {model};
  input.classes = {model::find_class(config.attack.target, model->card()).index};
  StepTimes times(*model);
  const ExchangeFolder folder;
  (void)attack::run_attack(input, config.attack.options, config.seed, folder.path() / "checkpoint",
                           times);
  const nlohmann::json medians = {{"step", median(times.steps)},
                                  {"classifier", median(times.classifiers)}};
  std::cout << medians.dump() << "\n";
}

}  // namespace
}  // namespace tt3d

int main(int argc, char** argv) {
  if (argc != 6) {
    std::cerr << "usage: step_bench CONFIG RUN MODEL STEPS THREADS\n";
    return 2;
  }
  try {
    tt3d::measure(argv);
  } catch (const tt3d::Error& error) {
    std::cerr << "step_bench: " << error.what() << "\n";
    return error.exit_code();
  }
  return 0;
}
