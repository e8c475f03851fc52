#include <algorithm>

#include "mlp_math.h"
#include "tt3d/device.h"

namespace tt3d::field {
namespace {

constexpr int64_t kChunk = 4096;  ///< points per partial weight gradient
static_assert(kChunk % kBlock == 0);

// One function per type and instruction set; the loader picks the best one for the machine. Macros,
// because a template cannot have its target as a parameter.
#define TT3D_MLP_LOOPS(TARGET, BYTES, T)                                                         \
  TARGET void forward_range(const T* x, const Layers<T>& layers, const Buffers<T>& work, T* out, \
                            int64_t begin, int64_t end, int64_t count) {                         \
    forward_points<Processor<BYTES>>(x, layers, work, out, begin, end, count);                   \
  }                                                                                              \
  TARGET void backward_range(const T* x, const Layers<T>& layers, const Buffers<T>& work,        \
                             const T* grad_out, T* grad_x, T* const* grad_w, int64_t begin,      \
                             int64_t end, int64_t count) {                                       \
    backward_points<Processor<BYTES>>(x, layers, work, grad_out, grad_x, grad_w, begin, end,     \
                                      count);                                                    \
  }
TT3D_FOR_EACH_CPU(TT3D_MLP_LOOPS, float)
TT3D_FOR_EACH_CPU(TT3D_MLP_LOOPS, double)
#undef TT3D_MLP_LOOPS

}  // namespace

template <typename T>
void mlp_cpu(const T* x, const std::vector<Layer<T>>& layers, T* out, int64_t count) {
  const Layers<T> network{layers.data(), nullptr, layers.size()};
  const auto make = [&] { return Workspace<T>(layers); };
  for_each_task((count + kChunk - 1) / kChunk, make, [&](int64_t c, const Workspace<T>& work) {
    forward_range(x, network, work.buffers, out, c * kChunk, std::min(count, (c + 1) * kChunk),
                  count);
  });
}

template <typename T>
void mlp_backward_cpu(const T* x, const std::vector<Layer<T>>& layers, const T* grad_out, T* grad_x,
                      const std::vector<T*>& grad_weights, int64_t count) {
  std::vector<std::vector<T>> transposed(layers.size());
  std::vector<const T*> transposed_data;
  int64_t parameters = 0;
  for (size_t k = 0; k < layers.size(); ++k) {
    const Layer<T>& layer = layers[k];
    transposed[k].resize(layer.in * layer.out);
    for (int64_t o = 0; o < layer.out; ++o) {
      for (int64_t i = 0; i < layer.in; ++i) {
        transposed[k][i * layer.out + o] = layer.weights[o * layer.in + i];
      }
    }
    transposed_data.push_back(transposed[k].data());
    parameters += padded(layer.in) * layer.out;
  }
  const Layers<T> network{layers.data(), transposed_data.data(), layers.size()};
  // One partial weight gradient per chunk, added in chunk order: the sums do not depend on the
  // number of threads.
  const int64_t chunks = (count + kChunk - 1) / kChunk;
  const Storage<T> storage = zeros<T>(chunks * parameters);
  T* partial = storage.get();
  const auto make = [&] { return Workspace<T>(layers); };
  for_each_task(chunks, make, [&](int64_t c, const Workspace<T>& work) {
    std::vector<T*> grad_w;
    T* next = partial + c * parameters;
    for (const Layer<T>& layer : layers) {
      grad_w.push_back(next);
      next += padded(layer.in) * layer.out;
    }
    backward_range(x, network, work.buffers, grad_out, grad_x, grad_w.data(), c * kChunk,
                   std::min(count, (c + 1) * kChunk), count);
  });
  int64_t offset = 0;
  for (size_t k = 0; k < layers.size(); ++k) {
    const int64_t in = layers[k].in, width = padded(in);
    std::fill_n(grad_weights[k], in * layers[k].out, T(0));
    for (int64_t c = 0; c < chunks; ++c) {
      const T* source = partial + c * parameters + offset;
      for (int64_t o = 0; o < layers[k].out; ++o) {
        for (int64_t i = 0; i < in; ++i) grad_weights[k][o * in + i] += source[o * width + i];
      }
    }
    offset += width * layers[k].out;
  }
}

#define TT3D_INSTANTIATE(T)                                                            \
  template void mlp_cpu(const T*, const std::vector<Layer<T>>&, T*, int64_t);          \
  template void mlp_backward_cpu(const T*, const std::vector<Layer<T>>&, const T*, T*, \
                                 const std::vector<T*>&, int64_t);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
