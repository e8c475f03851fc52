#pragma once

#include <ATen/core/Tensor.h>

#include <memory>
#include <vector>

#include "graph.h"
#include "memory.h"
#include "program.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// What a node keeps of its forward pass for its backward pass.
struct Kept {
  at::Tensor mask;             ///< bits, one per element of the result: 1 where it has slope 1
  std::vector<int64_t> sizes;  ///< of the input
  std::vector<at::Tensor> inputs, outputs;  ///< of steps that autograd records
};

/// Values and gradients of one pass, by slot of the graph.
class PlanPass {
 public:
  /// `meter` counts what is kept for the backward pass, and its limit holds for the whole pass.
  PlanPass(const Graph& graph, size_t nodes, bool keeps, MemoryMeter& meter);

  [[nodiscard]] bool keeps() const { return keeps_; }  ///< a backward pass will follow
  /// Runs a step through the dispatcher.
  void run(const Step& step) { runner_.run(step); }
  [[nodiscard]] const at::Tensor& value(Slot slot) const;
  [[nodiscard]] bool is_tensor(Slot slot) const;
  void set(Slot slot, at::Tensor tensor);
  /// Puts a tensor in the place of a value, without counting it.
  void replace(Slot slot, at::Tensor tensor);
  void release(Slot slot);

  [[nodiscard]] Kept& kept(size_t node) { return kept_[node]; }
  /// Counts a tensor that is kept beyond its slot.
  void count_kept(const at::Tensor& tensor);

  /// Takes the gradient of a value; undefined if nothing has reached it.
  [[nodiscard]] at::Tensor take_gradient(Slot slot);
  /// Adds to the gradient of a value. The tensor may be shared: see `own`.
  void add_gradient(Slot slot, at::Tensor gradient);

 private:
  bool keeps_;
  std::vector<c10::IValue> values_;
  std::vector<at::Tensor> gradients_;
  std::vector<Kept> kept_;
  MemoryMeter& held_;
  MemoryMeter passing_;
  StepRunner runner_;
};

/// `tensor` in the layout of compiled nodes: channels-last if it has four dimensions.
[[nodiscard]] at::Tensor in_plan_layout(const at::Tensor& tensor);

/// `tensor`, or a copy if anything else uses its memory; the result may be written to.
[[nodiscard]] at::Tensor own(at::Tensor tensor);

/// One step of a plan.
class PlanNode {
 public:
  virtual ~PlanNode() = default;
  /// Computes its results. `index`: its place in the plan, for pass.kept().
  virtual void forward(PlanPass& pass, size_t index) const = 0;
  /// Takes the gradients of its results and adds those of its inputs.
  virtual void backward(PlanPass& pass, size_t index) const = 0;
  /// True if the weights it has made ready still equal those of the graph.
  [[nodiscard]] virtual bool weights_hold() const { return true; }

  std::vector<Slot> reads;    ///< values that it reads, without constants
  std::vector<Slot> gives;    ///< values that it computes and others read
  std::vector<Slot> release;  ///< values that no later node reads
};

/// A graph compiled for the CPU: convolutions with bias, sum and activation as one node, their
/// weights made ready once for the forward pass and once, transposed and flipped, for the gradient;
/// everything else through the dispatcher, step by step, recorded by autograd.
class Plan : public std::enable_shared_from_this<Plan> {
 public:
  Plan(Graph graph, std::vector<std::unique_ptr<PlanNode>> nodes);

  /// Logits of normalised images [N,3,H,W] float32 on the CPU; differentiable with respect to the
  /// images if autograd is on. Throws as run_graph does.
  [[nodiscard]] at::Tensor logits(const at::Tensor& images, MemoryMeter& meter) const;
  [[nodiscard]] bool weights_hold() const;

  [[nodiscard]] std::shared_ptr<PlanPass> forward(const at::Tensor& images, bool keeps,
                                                  MemoryMeter& meter) const;
  [[nodiscard]] at::Tensor backward(PlanPass& pass, const at::Tensor& gradient) const;
  [[nodiscard]] const Graph& graph() const { return graph_; }

 private:
  Graph graph_;
  std::vector<std::unique_ptr<PlanNode>> nodes_;
};

/// Compiles the graph; null if that brings nothing (few convolutions) or the graph writes into its
/// values in ways that the plan does not follow. `graph` has channels-last float32 weights. With
/// bfloat16 the forward pass stays in float32, and the gradient's products are in bfloat16:
/// rounding in the forward pass would switch activations, which changes the gradient far more.
/// `memory`: limit in bytes for the results of one small batch, which is run to learn their shapes.
[[nodiscard]] std::shared_ptr<const Plan> compile_plan(const Graph& graph, Precision precision,
                                                       int64_t memory);

}  // namespace tt3d::model
