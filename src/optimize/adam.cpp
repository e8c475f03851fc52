#include <ATen/ATen.h>

#include <cmath>

#include "adam_cpu.h"
#include "tt3d/device.h"
#include "tt3d/optimize.h"

namespace tt3d::optimize {

using at::Tensor;

void Adam::step(const Tensor& parameter, const Tensor& gradient, const Tensor& moment1,
                const Tensor& moment2, double rate, int64_t iteration) const {
  const auto t = static_cast<double>(iteration);
  const auto correction =
      static_cast<float>(rate * std::sqrt(1 - std::pow(beta2, t)) / (1 - std::pow(beta1, t)));
  check_same_device("Adam", {parameter, gradient, moment1, moment2});
  const AdamEntry body = {parameter.mutable_data_ptr<float>(),
                          gradient.const_data_ptr<float>(),
                          moment1.mutable_data_ptr<float>(),
                          moment2.mutable_data_ptr<float>(),
                          static_cast<float>(beta1),
                          static_cast<float>(beta2),
                          static_cast<float>(epsilon * std::sqrt(1 - std::pow(beta2, t))),
                          correction};
  for_each_index_on(parameter, parameter.numel(), body);
}

void AdamMoments::restart(const std::vector<Tensor>& parameters) {
  first.clear();
  second.clear();
  for (const Tensor& p : parameters) {
    first.push_back(at::zeros_like(p.detach()));
    second.push_back(at::zeros_like(p.detach()));
  }
}

void AdamMoments::visit(StateVisitor& visit) const {
  visit.tensors("moment1", first);
  visit.tensors("moment2", second);
}

}  // namespace tt3d::optimize
