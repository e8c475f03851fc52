#include "batch_runner.h"

#include <ATen/ATen.h>
#include <fmt/format.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/custom_function.h>

#include <limits>
#include <new>

#include "feature_mixer.h"
#include "malformed.h"
#include "memory.h"
#include "precision.h"
#include "program.h"
#include "tt3d/gpu_options.h"
#include "tt3d/memory.h"

namespace tt3d::model {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// Data for the backward pass besides the images.
struct HeldRun : torch::CustomClassHolder {
  HeldRun(std::shared_ptr<BatchRunner> held, Pictures shown)
      : runner(std::move(held)), pictures(std::move(shown)) {
    pictures.images.reset();  // autograd keeps them
  }
  std::shared_ptr<BatchRunner> runner;
  Pictures pictures;
};

/// The logits of a batch whose intermediate results do not fit in memory together. Only the images
/// are kept; the backward pass runs the forward pass again, part by part.
struct LogitsInParts : torch::autograd::Function<LogitsInParts> {
  static at::Tensor forward(AutogradContext* context, const at::Tensor& images,
                            std::shared_ptr<BatchRunner> runner, const Pictures& pictures) {
    context->save_for_backward({images});
    context->saved_data["run"] =
        c10::IValue::make_capsule(c10::make_intrusive<HeldRun>(runner, pictures));
    return runner->logits(pictures);
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto holder = context->saved_data["run"].toCapsule();
    const auto& held = static_cast<HeldRun&>(*holder);
    Pictures pictures = held.pictures;
    pictures.images = context->get_saved_variables()[0];
    return {held.runner->gradient(pictures, gradients[0]), at::Tensor(), at::Tensor()};
  }
};

}  // namespace

BatchRunner::BatchRunner(Graph graph, int64_t intermediate_bytes, Precision precision, bool compile)
    : graph_(std::move(graph)),
      plan_(compile ? compile_plan(graph_, precision, memory_budget(intermediate_bytes)) : nullptr),
      limit_(intermediate_bytes),
      precision_(precision),
      fitting_(graph_.max_batch),
      fitting_with_gradient_(std::numeric_limits<int64_t>::max()) {
  if (plan_ == nullptr && precision == Precision::kBfloat16) use_bfloat16_weights(graph_);
}

at::Tensor BatchRunner::logits(const Pictures& pictures) {
  const int64_t total = pictures.images.size(0);
  if (at::GradMode::is_enabled() && pictures.images.requires_grad()) {
    if (total <= fitting_with_gradient_) {
      try {
        return whole(pictures);
      } catch (const MemoryLimit&) {
        fitting_with_gradient_ = std::max<int64_t>(total / 2, 1);
      }
    }
    return LogitsInParts::apply(pictures.images, shared_from_this(), pictures);
  }
  return in_parts(total, fitting_, [&](int64_t start, int64_t end) {
    MemoryMeter meter(memory_budget(limit_), false);
    return run(pictures.slice(start, end), meter);
  });
}

/// With gradients: keeps all that the backward pass needs.
at::Tensor BatchRunner::whole(const Pictures& pictures) {
  if (is_recorded(pictures)) return played_logits(recorded_pass(pictures.images), pictures.images);
  MemoryMeter meter(memory_budget(limit_), true);
  const int64_t total = pictures.images.size(0);
  if (total <= graph_.max_batch) return run(pictures, meter);
  std::vector<at::Tensor> parts;
  for (int64_t start = 0; start < total; start += graph_.max_batch) {
    const int64_t end = std::min(total, start + graph_.max_batch);
    parts.push_back(run(pictures.slice(start, end), meter));
  }
  return at::cat(parts, 0);
}

/// Mixed features are drawn anew each time, so such passes cannot be replayed.
bool BatchRunner::is_recorded(const Pictures& pictures) const {
  constexpr size_t kMostSizes = 4;  // each recorded pass keeps its memory
  const int64_t total = pictures.images.size(0);
  return gpu_options().graphs && pictures.images.is_cuda() && !pictures.mix &&
         total <= graph_.max_batch && (passes_.size() < kMostSizes || passes_.count(total) != 0);
}

std::shared_ptr<RecordedPass> BatchRunner::recorded_pass(const at::Tensor& images) {
  static_cast<void>(graph_on(images.device()));  // drops the passes of another device
  const auto found = passes_.find(images.size(0));
  if (found != passes_.end()) return found->second;
  const auto forward = [this](const at::Tensor& batch) {
    MemoryMeter meter(memory_budget(limit_), true);
    return run({batch}, meter);
  };
  try {
    const auto pass =
        std::make_shared<RecordedPass>(cuda_graph_recorder(images.device()), forward, images);
    passes_.emplace(images.size(0), pass);
    return pass;
  } catch (const Malformed& error) {
    throw Malformed(std::string(error.what()) + "; leave out --cuda-graphs");
  }
}

at::Tensor BatchRunner::gradient(const Pictures& pictures, const at::Tensor& gradient) {
  const at::AutoGradMode with_gradients(true);
  int64_t fitting = std::min(fitting_with_gradient_, graph_.max_batch);
  const int64_t total = pictures.images.size(0);
  at::Tensor result = in_parts(total, fitting, [&](int64_t start, int64_t end) -> at::Tensor {
    MemoryMeter meter(memory_budget(limit_), true);
    Pictures part = pictures.slice(start, end);
    part.images = part.images.detach().requires_grad_(true);
    const at::Tensor logits = run(part, meter);
    return torch::autograd::grad({logits}, {part.images}, {gradient.slice(0, start, end)})[0];
  });
  fitting_with_gradient_ = std::min(fitting_with_gradient_, fitting);
  return result;
}

/// Runs `part` over [0, total) in ranges of at most `fitting` items; halves `fitting` when a range
/// does not fit in memory.
at::Tensor BatchRunner::in_parts(int64_t total, int64_t& fitting, const Part& part) const {
  std::vector<at::Tensor> parts;
  bool released = false;
  for (int64_t start = 0; start < total;) {
    const int64_t count = std::min(fitting, total - start);
    std::string problem;
    try {
      parts.push_back(part(start, start + count));
      start += count;
      continue;
    } catch (const MemoryLimit& error) {
      problem = error.what();
    } catch (const c10::Error& error) {
      if (!is_out_of_memory(error)) throw;
      problem = "out of memory";
    } catch (const std::bad_alloc&) {
      problem = "out of memory";
    }
    if (count == 1) {
      if (released) throw ResourceError(problem + " with a single image: " + memory_state());
      // Freed memory that the process keeps may be what is missing.
      released = true;
      release_freed_memory();
      continue;
    }
    fitting = count / 2;
  }
  return parts.size() == 1 ? parts[0] : at::cat(parts, 0);
}

/// Pads batches below the exported range with zeros.
at::Tensor BatchRunner::filled_up(const at::Tensor& images) const {
  const int64_t missing = graph_.min_batch - images.size(0);
  if (missing <= 0) return images;
  return at::cat({images, at::zeros({missing, 3, graph_.height, graph_.width}, images.options())});
}

at::Tensor BatchRunner::run(const Pictures& pictures, MemoryMeter& meter) {
  const AllocationLimit allocations(memory_budget(limit_));
  const int64_t count = pictures.images.size(0);
  const at::Tensor images = filled_up(pictures.images);
  at::Tensor logits = plan_ != nullptr && images.is_cpu() && !pictures.mix
                          ? plan_->logits(images, meter)
                          : raw_logits(pictures, images, meter);
  if (logits.dim() == 3) logits = logits.amax(1);  // a detector: best score of each class
  if (logits.dim() != 2 || logits.size(0) != images.size(0) || logits.size(1) != graph_.classes ||
      !logits.is_floating_point()) {
    throw Malformed("the graph did not give logits [N,classes]");
  }
  return logits.to(at::kFloat).slice(0, 0, count);
}

/// The graph's result for `images`, which are those of `pictures`, filled up, step by step.
at::Tensor BatchRunner::raw_logits(const Pictures& pictures, const at::Tensor& images,
                                   MemoryMeter& meter) {
  const PrecisionScope precision(precision_, images.device());
  const Graph& graph = graph_on(images.device());
  if (!pictures.mix) return run_graph(graph, images, meter);
  FeatureMixer mixer(*pictures.mix, pictures.first);
  {
    // Nothing of this run is kept for a backward pass, so it needs a meter of its own.
    MemoryMeter passing(memory_budget(limit_), false);
    const at::NoGradGuard none;
    const int64_t first = pictures.first, last = first + pictures.images.size(0);
    static_cast<void>(
        run_graph(graph, filled_up(pictures.mix->images.slice(0, first, last)), passing, &mixer));
  }
  mixer.begin_mixing();
  return run_graph(graph, images, meter, &mixer);
}

/// The graph with its weights on `device`. Keeps the copy for the last device other than the CPU.
const Graph& BatchRunner::graph_on(at::Device device) {
  if (device.is_cpu()) return graph_;
  if (!moved_ || moved_device_ != device) {
    passes_.clear();
    moved_ = graph_;
    moved_device_ = device;
    for (auto& [slot, tensor] : moved_->constants) tensor = tensor.to(device);
    if (precision_ == Precision::kBfloat16) use_bfloat16_weights(*moved_);
  }
  return *moved_;
}

}  // namespace tt3d::model
