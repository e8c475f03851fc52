#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tt3d/core.h"

/// Common parts of the optimisations of field, mesh, appearance and attack: Adam, and a loop that
/// resumes, recovers from divergence and from a lack of memory, and reports progress.
namespace tt3d::optimize {

/// One Adam step (Kingma & Ba 2015) on a tensor and its moments. If the gradient of an entry is
/// exactly zero, its value and moments stay unchanged, so hash entries that no sample touched do
/// not drift (as in instant-ngp).
struct Adam {
  double beta1 = 0.9, beta2 = 0.99, epsilon = 1e-15;
  void step(const at::Tensor& parameter, const at::Tensor& gradient, const at::Tensor& moment1,
            const at::Tensor& moment2, double rate, int64_t iteration) const;
};

/// Visits all state that changes during an optimisation, to write it to a checkpoint or to read it.
/// One function `visit_state` of an optimisation does both.
class StateVisitor {
 public:
  virtual ~StateVisitor() = default;
  /// A tensor of a fixed shape; reading copies into it.
  virtual void tensor(const std::string& name, const at::Tensor& value) = 0;
  /// A tensor whose shape depends on the state, [-1,...]; reading replaces it, on its old device.
  virtual void replace(const std::string& name, at::Tensor& value) = 0;
  virtual void integer(const std::string& name, int64_t& value) = 0;
  virtual void number(const std::string& name, double& value) = 0;
  /// Tensors of fixed shapes, named NAME.0, NAME.1, ...
  void tensors(const std::string& name, const std::vector<at::Tensor>& values);
  /// True while a checkpoint is read.
  [[nodiscard]] virtual bool reading() const = 0;
};

/// The moments that Adam keeps of a list of parameters.
struct AdamMoments {
  std::vector<at::Tensor> first, second;  ///< one tensor per parameter, in its shape
  /// Zeros for `parameters`.
  void restart(const std::vector<at::Tensor>& parameters);
  void visit(StateVisitor& visit) const;
};

/// The result of a step, before it is applied.
struct StepLoss {
  double loss = 0;
  Metrics metrics;  ///< shown beside the progress bar
};

/// An optimisation that `run_loop` drives.
class Optimization {
 public:
  virtual ~Optimization() = default;
  /// Returns to the state before the first step.
  virtual void restart() = 0;
  /// Visits all state that a checkpoint holds. After reading, the state is that of the checkpoint.
  virtual void visit_state(StateVisitor& visit) = 0;
  /// Computes loss and gradients of step `step`.
  [[nodiscard]] virtual StepLoss compute(int64_t step) = 0;
  /// Moves the parameters; `rate_scale` multiplies the learning rates.
  virtual void apply(int64_t step, double rate_scale) = 0;
  /// Called after step `step` was applied.
  virtual void after_step(int64_t step) { static_cast<void>(step); }
  /// True ends the loop before all steps are done.
  [[nodiscard]] virtual bool finished() const { return false; }
  /// Halves the batch; false if it cannot be halved.
  virtual bool halve_batch() { return false; }
};

/// Options of `run_loop`.
struct LoopOptions {
  std::string stage;                 ///< name for progress and messages
  int64_t steps = 0;                 ///< steps in total
  int64_t checkpoint_every = 0;      ///< steps between checkpoints; 0: never
  std::filesystem::path checkpoint;  ///< file of the state; empty: none
  std::string on_divergence;         ///< advice in the error if roll-backs do not help
  std::string on_memory;             ///< advice in the error if the smallest batch does not fit
};

/// Runs all steps. Resumes from the checkpoint if it exists; the result has the same bytes as
/// without the stop. If a loss is not finite or explodes (its magnitude exceeds 1000 times the
/// sum of 1 and the mean magnitude so far), rolls back to the last checkpoint with half the
/// learning rates, at most three times. If memory runs out, halves the batch. Throws NumericError,
/// ResourceError, Interrupted.
void run_loop(Optimization& optimization, const LoopOptions& options, Progress& progress);

}  // namespace tt3d::optimize
