// Program of bench/models.py: loads a package. For every line on stdin it runs one forward and
// backward pass and prints its seconds.
//
//   model_bench MODEL BATCH THREADS [plain|bf16]
//
//   plain   not compiled, step by step through torch's dispatcher
//   bf16    compiled, in bfloat16

#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <torch/csrc/autograd/autograd.h>

#include <cstdlib>
#include <iostream>
#include <string>

#include "tt3d/core.h"
#include "tt3d/model.h"

namespace {

/// Gradient of the cross-entropy with target class 0, as in an attack.
double timed_pass(const tt3d::model::Classifier& model, const at::Tensor& images) {
  const double start = tt3d::now_seconds();
  const at::Tensor leaf = images.detach().requires_grad_(true);
  const at::Tensor loss = -model.logits(leaf).log_softmax(1).select(1, 0).mean();
  const auto gradient = torch::autograd::grad({loss}, {leaf});
  return tt3d::now_seconds() - start;
}

int serve(const std::string& name, int64_t batch, int threads, const std::string& form) {
  at::set_num_threads(threads);
  tt3d::model::ModelOptions options;
  options.compile = form != "plain";
  if (form == "bf16") options.precision = tt3d::model::Precision::kBfloat16;
  const auto model = tt3d::model::Classifier::load(name, {}, nullptr, options);
  at::manual_seed(0);
  const at::Tensor images = at::rand({batch, 3, model->card().height, model->card().width});
  std::cout << "ready" << std::endl;
  for (std::string line; std::getline(std::cin, line);) {
    std::cout << timed_pass(*model, images) << std::endl;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4 && argc != 5) {
    std::cerr << "usage: model_bench MODEL BATCH THREADS [plain|bf16]\n";
    return 2;
  }
  try {
    return serve(argv[1], std::atoll(argv[2]), std::atoi(argv[3]), argc == 5 ? argv[4] : "");
  } catch (const tt3d::Error& error) {
    std::cerr << error.what() << "\n";
    return error.exit_code();
  }
}
