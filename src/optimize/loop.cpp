#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <cmath>
#include <new>
#include <optional>

#include "tt3d/memory.h"
#include "tt3d/optimize.h"
#include "tt3d/tensor_file.h"

namespace tt3d::optimize {
namespace {

using at::Tensor;
namespace fs = std::filesystem;

/// Writes the state to a checkpoint.
class StateWriter final : public StateVisitor {
 public:
  void tensor(const std::string& name, const Tensor& value) override {
    tensors_.emplace_back(name, value.detach());
  }
  void replace(const std::string& name, Tensor& value) override { tensor(name, value); }
  void integer(const std::string& name, int64_t& value) override {
    tensor(name, at::tensor({value}, at::kLong));
  }
  void number(const std::string& name, double& value) override {
    tensor(name, at::tensor({value}, at::kDouble));
  }
  [[nodiscard]] bool reading() const override { return false; }

  void save(const fs::path& path, const std::string& stage) const {
    save_tensors(path, tensors_, {{"format", "tt3d checkpoint: " + stage}});
  }

 private:
  std::vector<std::pair<std::string, Tensor>> tensors_;
};

/// Reads the state from a checkpoint.
class StateReader final : public StateVisitor {
 public:
  explicit StateReader(const fs::path& path) : file_(load_tensors(path)) {}

  void tensor(const std::string& name, const Tensor& value) override {
    at::NoGradGuard guard;
    value.copy_(file_.get(name, value.sizes(), value.scalar_type()));
  }
  void replace(const std::string& name, Tensor& value) override {
    std::vector<int64_t> shape(value.sizes().begin(), value.sizes().end());
    if (!shape.empty()) shape[0] = -1;
    value = file_.get(name, shape, value.scalar_type()).to(value.device());
  }
  void integer(const std::string& name, int64_t& value) override {
    value = file_.get(name, {1}, at::kLong).item<int64_t>();
  }
  void number(const std::string& name, double& value) override {
    value = file_.get(name, {1}, at::kDouble).item<double>();
  }
  [[nodiscard]] bool reading() const override { return true; }

 private:
  TensorFile file_;
};

/// The state of the loop itself.
struct LoopState {
  int64_t step = 0;
  int64_t rollbacks = 0;
  double rate_scale = 1;
  double magnitude = 0;  ///< sum of |loss| over the steps so far
};

class Loop {
 public:
  Loop(Optimization& optimization, const LoopOptions& options, Progress& progress)
      : optimization_(optimization), options_(options), progress_(progress) {}

  void run() {
    optimization_.restart();
    resume();
    progress_.begin(options_.stage, options_.steps, state_.step);
    while (state_.step < options_.steps && !optimization_.finished()) {
      const StepLoss result = compute();
      if (diverged(result.loss)) {
        roll_back();
        continue;
      }
      optimization_.apply(state_.step, state_.rate_scale);
      state_.magnitude += std::abs(result.loss);
      ++state_.step;
      progress_.update(state_.step, result.metrics);
      optimization_.after_step(state_.step - 1);
      trimmer_.after_step();
      if (checkpoint_due()) save();
      progress_.check();
    }
    progress_.end();
  }

 private:
  /// Computes a step. If memory runs out, this and all later steps use smaller batches.
  StepLoss compute() {
    for (;;) {
      try {
        return optimization_.compute(state_.step);
      } catch (const c10::OutOfMemoryError&) {
        halve_batch();
      } catch (const std::bad_alloc&) {
        halve_batch();
      }
    }
  }

  void halve_batch() {
    if (!optimization_.halve_batch()) {
      throw ResourceError(options_.stage + ": out of memory with the smallest batch; " +
                          options_.on_memory);
    }
    progress_.note(options_.stage + ": out of memory, continuing with half the batch");
  }

  [[nodiscard]] bool diverged(double loss) const {
    constexpr double kExplosion = 1000;
    if (!std::isfinite(loss)) return true;
    const double mean = state_.step == 0 ? 0 : state_.magnitude / static_cast<double>(state_.step);
    return state_.step > 0 && std::abs(loss) > kExplosion * (1 + mean);
  }

  void roll_back() {
    constexpr int64_t kMaxRollbacks = 3;
    const std::string what = options_.stage + " diverged at step " + std::to_string(state_.step);
    if (state_.rollbacks == kMaxRollbacks) {
      throw NumericError(what + " after three roll-backs; " + options_.on_divergence);
    }
    const LoopState before = state_;
    state_ = {};
    optimization_.restart();
    resume();
    state_.rollbacks = before.rollbacks + 1;
    state_.rate_scale = before.rate_scale / 2;
    progress_.note(what + ": rolling back, learning rates x " + std::to_string(state_.rate_scale));
  }

  void visit(StateVisitor& visitor) {
    visitor.integer("loop.step", state_.step);
    visitor.integer("loop.rollbacks", state_.rollbacks);
    visitor.number("loop.rate_scale", state_.rate_scale);
    visitor.number("loop.magnitude", state_.magnitude);
    optimization_.visit_state(visitor);
  }

  void resume() {
    if (options_.checkpoint.empty() || !fs::exists(options_.checkpoint)) return;
    StateReader reader(options_.checkpoint);
    visit(reader);
  }

  [[nodiscard]] bool checkpoint_due() const {
    return !options_.checkpoint.empty() && options_.checkpoint_every > 0 &&
           state_.step % options_.checkpoint_every == 0;
  }

  void save() {
    StateWriter writer;
    visit(writer);
    writer.save(options_.checkpoint, options_.stage);
  }

  Optimization& optimization_;
  const LoopOptions& options_;
  Progress& progress_;
  LoopState state_;
  MemoryTrimmer trimmer_;
};

}  // namespace

void StateVisitor::tensors(const std::string& name, const std::vector<Tensor>& values) {
  for (size_t i = 0; i < values.size(); ++i) tensor(name + "." + std::to_string(i), values[i]);
}

void run_loop(Optimization& optimization, const LoopOptions& options, Progress& progress) {
  Loop(optimization, options, progress).run();
}

}  // namespace tt3d::optimize
