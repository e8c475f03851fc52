#include <algorithm>
#include <cstring>
#include <memory>
#include <new>

#include "field_kernels.h"
#include "tt3d/device.h"

// A block of kBlock points goes through all layers while its activations are in cache.
namespace tt3d::field {
namespace {

constexpr int kLanes = 16;
constexpr int kBlock = 256;
/// Numbers from a row of a block to the next: an odd number of cache lines, so that the rows spread
/// over the cache.
constexpr int kRow = kBlock + kLanes;
constexpr int kVectors = kBlock / kLanes;
constexpr int64_t kChunk = 8192;  ///< points a partial weight gradient covers
static_assert(kChunk % kBlock == 0);

template <typename T>
struct LanesOf {
  typedef T type __attribute__((vector_size(sizeof(T) * kLanes), aligned(sizeof(T))));
};
template <typename T>
using Lanes = typename LanesOf<T>::type;

/// Sum of the lanes, by halves.
template <typename T>
TT3D_HD T sum_of(const Lanes<T>& v) {
  const auto a = __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7) +
                 __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15);
  const auto b =
      __builtin_shufflevector(a, a, 0, 1, 2, 3) + __builtin_shufflevector(a, a, 4, 5, 6, 7);
  const auto c = __builtin_shufflevector(b, b, 0, 1) + __builtin_shufflevector(b, b, 2, 3);
  return c[0] + c[1];
}

/// y[out,kBlock] = w[out,in] x[in,kBlock]: four rows of y by two vectors of points at a time. The
/// points are outermost, so that what is read of x stays in the first cache for all rows.
template <typename T>
TT3D_HD void multiply(const T* w, const T* x, T* y, int64_t in, int64_t out) {
  for (int v = 0; v < kVectors; v += 2) {
    const T* x_begin = x + v * kLanes;
    for (int64_t o = 0; o < out; o += 4) {
      const int64_t rows = std::min<int64_t>(4, out - o);
      const T* row[4];
      for (int r = 0; r < 4; ++r) row[r] = w + (o + std::min<int64_t>(r, rows - 1)) * in;
      Lanes<T> sum[4][2] = {};
      for (int64_t i = 0; i < in; ++i) {
        const T* xi = x_begin + i * kRow;
        const Lanes<T> a = *reinterpret_cast<const Lanes<T>*>(xi);
        const Lanes<T> b = *reinterpret_cast<const Lanes<T>*>(xi + kLanes);
        for (int r = 0; r < 4; ++r) {
          sum[r][0] += row[r][i] * a;
          sum[r][1] += row[r][i] * b;
        }
      }
      // Up to 4, not to `rows`: sums with an index that varies would not stay in registers.
      for (int64_t r = 0; r < 4; ++r) {
        if (r >= rows) break;
        T* yo = y + (o + r) * kRow + v * kLanes;
        *reinterpret_cast<Lanes<T>*>(yo) = sum[r][0];
        *reinterpret_cast<Lanes<T>*>(yo + kLanes) = sum[r][1];
      }
    }
  }
}

/// grad[out,in] += gy[out,kBlock] x[in,kBlock]^T, four by four dot products at a time.
template <typename T>
TT3D_HD void accumulate_weights(const T* gy, const T* x, T* grad, int64_t in, int64_t out) {
  for (int64_t o = 0; o < out; o += 4) {
    const int64_t rows = std::min<int64_t>(4, out - o);
    for (int64_t i = 0; i < in; i += 4) {
      const int64_t cols = std::min<int64_t>(4, in - i);
      Lanes<T> sum[4][4] = {};
      for (int v = 0; v < kVectors; ++v) {
        Lanes<T> a[4], b[4];
        for (int r = 0; r < 4; ++r) {
          a[r] = *reinterpret_cast<const Lanes<T>*>(
              gy + (o + std::min<int64_t>(r, rows - 1)) * kRow + v * kLanes);
          b[r] = *reinterpret_cast<const Lanes<T>*>(
              x + (i + std::min<int64_t>(r, cols - 1)) * kRow + v * kLanes);
        }
        for (int r = 0; r < 4; ++r) {
          for (int c = 0; c < 4; ++c) sum[r][c] += a[r] * b[c];
        }
      }
      for (int64_t r = 0; r < 4; ++r) {
        for (int64_t c = 0; c < 4; ++c) {
          if (r < rows && c < cols) grad[(o + r) * in + i + c] += sum_of<T>(sum[r][c]);
        }
      }
    }
  }
}

/// Copies points [begin, begin + kBlock) of x [rows,count] into a block, zeros past the end.
template <typename T>
TT3D_HD void load_block(const T* x, int64_t rows, int64_t count, int64_t begin, T* block) {
  const int64_t n = std::min<int64_t>(kBlock, count - begin);
  for (int64_t r = 0; r < rows; ++r) {
    for (int64_t k = 0; k < n; ++k) block[r * kRow + k] = x[r * count + begin + k];
    for (int64_t k = n; k < kBlock; ++k) block[r * kRow + k] = T(0);
  }
}

template <typename T>
TT3D_HD void store_block(const T* block, int64_t rows, int64_t count, int64_t begin, T* x) {
  const int64_t n = std::min<int64_t>(kBlock, count - begin);
  for (int64_t r = 0; r < rows; ++r) {
    for (int64_t k = 0; k < n; ++k) x[r * count + begin + k] = block[r * kRow + k];
  }
}

/// Buffers of one thread: activations[k] is the input of layer k, the last one the output.
template <typename T>
struct Workspace {
  explicit Workspace(const std::vector<Layer<T>>& layers) {
    int64_t total = layers[0].in, widest = layers[0].in;
    for (const Layer<T>& layer : layers) {
      total += layer.out;
      widest = std::max(widest, layer.out);
    }
    storage.reset(new (std::align_val_t{64}) T[static_cast<size_t>((total + 2 * widest) * kRow)]());
    T* next = storage.get();
    activations.push_back(next);
    next += layers[0].in * kRow;
    for (const Layer<T>& layer : layers) {
      activations.push_back(next);
      next += layer.out * kRow;
    }
    grad_a = next;
    grad_b = next + widest * kRow;
  }
  /// Frees what was allocated in whole cache lines.
  struct Free {
    void operator()(T* memory) const { ::operator delete[](memory, std::align_val_t{64}); }
  };
  std::unique_ptr<T[], Free> storage;
  std::vector<T*> activations;
  T *grad_a, *grad_b;
};

template <typename T>
TT3D_HD void forward_block(const Layer<T>* layers, size_t layer_count, T* const* activations) {
  for (size_t k = 0; k < layer_count; ++k) {
    multiply(layers[k].weights, activations[k], activations[k + 1], layers[k].in, layers[k].out);
    if (k + 1 == layer_count) break;
    T* y = activations[k + 1];
    for (int64_t i = 0; i < layers[k].out * kRow; ++i) y[i] = y[i] > T(0) ? y[i] : T(0);
  }
}

/// Walks the layers backward; grad_a holds the output's gradient at the start, the input's at the
/// end (if wanted).
template <typename T>
TT3D_HD void backward_block(const Layer<T>* layers, const T* const* transposed, size_t layer_count,
                            T* const* activations, T* grad_a, T* grad_b, T* const* grad_weights,
                            bool want_input, T** grad_input) {
  for (size_t k = layer_count; k-- > 0;) {
    accumulate_weights(grad_a, activations[k], grad_weights[k], layers[k].in, layers[k].out);
    if (k == 0 && !want_input) break;
    multiply(transposed[k], grad_a, grad_b, layers[k].out, layers[k].in);
    if (k > 0) {
      const T* x = activations[k];
      for (int64_t i = 0; i < layers[k].in * kRow; ++i) grad_b[i] = x[i] > T(0) ? grad_b[i] : T(0);
    }
    std::swap(grad_a, grad_b);
  }
  *grad_input = grad_a;
}

// target_clones needs plain functions: one for each type.
#define TT3D_MLP_LOOPS(T)                                                                       \
  TT3D_CPU_LOOP void forward_range(const T* x, const Layer<T>* layers, size_t layer_count,      \
                                   T* const* activations, T* out, int64_t begin, int64_t end,   \
                                   int64_t count) {                                             \
    for (int64_t b = begin; b < end; b += kBlock) {                                             \
      load_block(x, layers[0].in, count, b, activations[0]);                                    \
      forward_block(layers, layer_count, activations);                                          \
      store_block(activations[layer_count], layers[layer_count - 1].out, count, b, out);        \
    }                                                                                           \
  }                                                                                             \
  TT3D_CPU_LOOP void backward_range(const T* x, const Layer<T>* layers, const T* const* turned, \
                                    size_t layer_count, T* const* activations, T* grad_a,       \
                                    T* grad_b, const T* grad_out, T* grad_x, T* const* grad_w,  \
                                    int64_t begin, int64_t end, int64_t count) {                \
    for (int64_t b = begin; b < end; b += kBlock) {                                             \
      load_block(x, layers[0].in, count, b, activations[0]);                                    \
      forward_block(layers, layer_count, activations);                                          \
      load_block(grad_out, layers[layer_count - 1].out, count, b, grad_a);                      \
      T* grad_input = nullptr;                                                                  \
      backward_block(layers, turned, layer_count, activations, grad_a, grad_b, grad_w,          \
                     grad_x != nullptr, &grad_input);                                           \
      if (grad_x) store_block(grad_input, layers[0].in, count, b, grad_x);                      \
    }                                                                                           \
  }
TT3D_MLP_LOOPS(float)
TT3D_MLP_LOOPS(double)
#undef TT3D_MLP_LOOPS

}  // namespace

template <typename T>
void mlp_cpu(const T* x, const std::vector<Layer<T>>& layers, T* out, int64_t count) {
  at::parallel_for(0, (count + kChunk - 1) / kChunk, 1, [&](int64_t first, int64_t last) {
    Workspace<T> work(layers);
    forward_range(x, layers.data(), layers.size(), work.activations.data(), out, first * kChunk,
                  std::min(count, last * kChunk), count);
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
    parameters += layer.in * layer.out;
  }
  // Partial weight gradients by chunk, added in chunk order: the same sums with any threads.
  const int64_t chunks = (count + kChunk - 1) / kChunk;
  std::vector<T> partial(chunks * parameters, T(0));
  at::parallel_for(0, chunks, 1, [&](int64_t first, int64_t last) {
    Workspace<T> work(layers);
    for (int64_t c = first; c < last; ++c) {
      std::vector<T*> grad_w;
      T* next = partial.data() + c * parameters;
      for (const Layer<T>& layer : layers) {
        grad_w.push_back(next);
        next += layer.in * layer.out;
      }
      backward_range(x, layers.data(), transposed_data.data(), layers.size(),
                     work.activations.data(), work.grad_a, work.grad_b, grad_out, grad_x,
                     grad_w.data(), c * kChunk, std::min(count, (c + 1) * kChunk), count);
    }
  });
  int64_t offset = 0;
  for (size_t k = 0; k < layers.size(); ++k) {
    const int64_t n = layers[k].in * layers[k].out;
    std::fill_n(grad_weights[k], n, T(0));
    for (int64_t c = 0; c < chunks; ++c) {
      const T* source = partial.data() + c * parameters + offset;
      for (int64_t i = 0; i < n; ++i) grad_weights[k][i] += source[i];
    }
    offset += n;
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
