#include "plan.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "malformed.h"

namespace tt3d::model {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

struct PlannedPass : torch::CustomClassHolder {
  PlannedPass(std::shared_ptr<const Plan> used, std::shared_ptr<PlanPass> done)
      : plan(std::move(used)), pass(std::move(done)) {}
  std::shared_ptr<const Plan> plan;
  std::shared_ptr<PlanPass> pass;
};

/// A plan as a differentiable function of its images.
struct PlanLogits : torch::autograd::Function<PlanLogits> {
  static at::Tensor forward(AutogradContext* context, const at::Tensor& images,
                            const std::shared_ptr<const Plan>& plan, MemoryMeter* meter) {
    const auto pass = plan->forward(images, true, *meter);
    context->saved_data["pass"] =
        c10::IValue::make_capsule(c10::make_intrusive<PlannedPass>(plan, pass));
    const at::Tensor logits = pass->value(plan->graph().output).detach();
    pass->release(plan->graph().output);
    return logits;
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto holder = context->saved_data["pass"].toCapsule();
    const auto& held = static_cast<PlannedPass&>(*holder);
    return {held.plan->backward(*held.pass, gradients[0]), at::Tensor(), at::Tensor()};
  }
};

}  // namespace

PlanPass::PlanPass(const Graph& graph, size_t nodes, bool keeps, MemoryMeter& meter)
    : keeps_(keeps),
      gradients_(graph.names.size()),
      kept_(nodes),
      held_(meter),
      passing_(meter.limit(), false),
      runner_(graph, at::kCPU, values_, passing_) {}

bool PlanPass::is_tensor(Slot slot) const { return values_[static_cast<size_t>(slot)].isTensor(); }

const at::Tensor& PlanPass::value(Slot slot) const {
  const c10::IValue& value = values_[static_cast<size_t>(slot)];
  if (!value.isTensor()) throw Malformed("a value is not a tensor");
  return value.toTensor();
}

void PlanPass::set(Slot slot, at::Tensor tensor) {
  passing_.add(tensor);
  replace(slot, std::move(tensor));
}

void PlanPass::replace(Slot slot, at::Tensor tensor) {
  values_[static_cast<size_t>(slot)] = std::move(tensor);
}

void PlanPass::release(Slot slot) {
  c10::IValue& value = values_[static_cast<size_t>(slot)];
  if (value.isTensor()) passing_.release(value.toTensor());
  value = c10::IValue();
}

void PlanPass::count_kept(const at::Tensor& tensor) { held_.add(tensor); }

at::Tensor PlanPass::take_gradient(Slot slot) {
  return std::move(gradients_[static_cast<size_t>(slot)]);
}

void PlanPass::add_gradient(Slot slot, at::Tensor gradient) {
  at::Tensor& sum = gradients_[static_cast<size_t>(slot)];
  sum = sum.defined() ? own(std::move(sum)).add_(gradient) : std::move(gradient);
}

at::Tensor in_plan_layout(const at::Tensor& tensor) {
  return tensor.contiguous(tensor.dim() == 4 ? at::MemoryFormat::ChannelsLast
                                             : at::MemoryFormat::Contiguous);
}

at::Tensor own(at::Tensor tensor) {
  const bool alone = tensor.use_count() == 1 && tensor.storage().use_count() == 1 &&
                     tensor.is_non_overlapping_and_dense();
  return alone ? std::move(tensor) : tensor.clone();
}

Plan::Plan(Graph graph, std::vector<std::unique_ptr<PlanNode>> nodes)
    : graph_(std::move(graph)), nodes_(std::move(nodes)) {}

std::shared_ptr<PlanPass> Plan::forward(const at::Tensor& images, bool keeps,
                                        MemoryMeter& meter) const {
  auto pass = std::make_shared<PlanPass>(graph_, nodes_.size(), keeps, meter);
  pass->replace(graph_.input, images);
  for (size_t i = 0; i < nodes_.size(); ++i) {
    nodes_[i]->forward(*pass, i);
    for (const Slot slot : nodes_[i]->release) pass->release(slot);
  }
  return pass;
}

at::Tensor Plan::backward(PlanPass& pass, const at::Tensor& gradient) const {
  const at::NoGradGuard none;
  pass.add_gradient(graph_.output, gradient);
  for (size_t i = nodes_.size(); i-- > 0;) nodes_[i]->backward(pass, i);
  at::Tensor images = pass.take_gradient(graph_.input);
  if (!images.defined()) throw Malformed("no gradient reaches the images");
  return images.to(at::kFloat);
}

at::Tensor Plan::logits(const at::Tensor& images, MemoryMeter& meter) const {
  if (at::GradMode::is_enabled() && images.requires_grad()) {
    return PlanLogits::apply(images, shared_from_this(), &meter);
  }
  const at::NoGradGuard none;
  return forward(images, false, meter)->value(graph_.output);
}

bool Plan::weights_hold() const {
  for (const auto& node : nodes_) {
    if (!node->weights_hold()) return false;
  }
  return true;
}

}  // namespace tt3d::model
