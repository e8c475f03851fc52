#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "field_kernels.h"
#include "tt3d/kernel.h"

/// Bodies of the small MLPs on the CPU: a block of kBlock points goes through all layers while its
/// activations are in the cache.
namespace tt3d::field {

constexpr int kBlock = 128;
/// Row length of a block: an odd number of cache lines, so that rows map to different cache sets.
constexpr int kRow = kBlock + 16;

/// n rounded up to whole vectors of any processor.
constexpr int64_t padded(int64_t n) { return (n + 15) / 16 * 16; }

/// The vector width of an instruction set, and the tiles of a product that its registers can hold.
/// If a vector is wider than a register, the compiler keeps it in memory; the loop is then fifty
/// times slower.
template <int kVectorBytes>
struct Processor {
  template <typename T>
  struct LanesOf {
    typedef T type __attribute__((vector_size(kVectorBytes), aligned(sizeof(T))));
  };
  template <typename T>
  static constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(T));
  static constexpr bool kWide = kVectorBytes == 64;  ///< 32 registers instead of 16
  static constexpr int kProductRows = kWide ? 8 : 6;
  static constexpr int kSumRows = 6, kSumColumns = kWide ? 4 : 2;
};
template <typename P, typename T>
using Lanes = typename P::template LanesOf<T>::type;

template <typename P, typename T>
TT3D_HD Lanes<P, T>& lanes_at(T* numbers) {
  return *reinterpret_cast<Lanes<P, T>*>(numbers);
}
template <typename P, typename T>
TT3D_HD const Lanes<P, T>& lanes_at(const T* numbers) {
  return *reinterpret_cast<const Lanes<P, T>*>(numbers);
}

/// y[out,kBlock] = w[out,in] x[in,kBlock]. A tile is some rows of y by two vectors of points. With
/// a gate [out,kBlock], y is zero where the gate is not positive; gate == y gives ReLU. The points
/// are the outermost loop, so that the columns of x stay in the L1 cache for all rows.
template <typename P, typename T>
TT3D_HD void multiply(const T* w, const T* x, T* y, int64_t in, int64_t out, const T* gate) {
  constexpr int kRows = P::kProductRows, kLanes = P::template kLanes<T>;
  for (int v = 0; v < kBlock; v += 2 * kLanes) {
    for (int64_t o = 0; o < out; o += kRows) {
      const int64_t rows = std::min<int64_t>(kRows, out - o);
      const T* row[kRows];
      for (int r = 0; r < kRows; ++r) row[r] = w + (o + std::min<int64_t>(r, rows - 1)) * in;
      Lanes<P, T> sum[kRows][2] = {};
      for (int64_t i = 0; i < in; ++i) {
        const T* xi = x + v + i * kRow;
        const Lanes<P, T> a = lanes_at<P>(xi), b = lanes_at<P>(xi + kLanes);
        for (int r = 0; r < kRows; ++r) {
          sum[r][0] += row[r][i] * a;
          sum[r][1] += row[r][i] * b;
        }
      }
      // The bound is kRows, not `rows`: a variable index would move the sums out of registers.
      for (int64_t r = 0; r < kRows; ++r) {
        if (r >= rows) break;
        for (int k = 0; k < 2; ++k) {
          const Lanes<P, T> rest = {};
          const int64_t at = (o + r) * kRow + v + k * kLanes;
          if (gate == y)
            sum[r][k] = sum[r][k] > rest ? sum[r][k] : rest;
          else if (gate)
            sum[r][k] = lanes_at<P>(gate + at) > rest ? sum[r][k] : rest;
          lanes_at<P>(y + at) = sum[r][k];
        }
      }
    }
  }
}

/// Stages of a transposition: in rows r and r + kStep, swaps every other group of kStep lanes.
template <typename P, typename T, int kStep, int... kLane>
TT3D_HD void exchange(Lanes<P, T>* rows, std::integer_sequence<int, kLane...> lanes) {
  constexpr int kLanes = sizeof...(kLane);
  for (int r = 0; r < kLanes; ++r) {
    if (r & kStep) continue;
    const Lanes<P, T> a = rows[r], b = rows[r + kStep];
    rows[r] = __builtin_shufflevector(a, b, (kLane & kStep ? kLanes + (kLane ^ kStep) : kLane)...);
    rows[r + kStep] =
        __builtin_shufflevector(a, b, (kLane & kStep ? kLanes + kLane : kLane ^ kStep)...);
  }
  if constexpr (kStep > 1) exchange<P, T, kStep / 2>(rows, lanes);
}

/// turned[kBlock,width] = x[in,kBlock]^T, zeros from `in` to `width`.
template <typename P, typename T>
TT3D_HD void turn(const T* x, int64_t in, int64_t width, T* turned) {
  constexpr int kLanes = P::template kLanes<T>;
  for (int64_t i = 0; i < width; i += kLanes) {
    for (int v = 0; v < kBlock; v += kLanes) {
      Lanes<P, T> rows[kLanes];
      for (int r = 0; r < kLanes; ++r) {
        rows[r] = i + r < in ? lanes_at<P>(x + (i + r) * kRow + v) : Lanes<P, T>{};
      }
      exchange<P, T, kLanes / 2>(rows, std::make_integer_sequence<int, kLanes>());
      for (int r = 0; r < kLanes; ++r) lanes_at<P>(turned + (v + r) * width + i) = rows[r];
    }
  }
}

/// grad[out,width] += gy[out,kBlock] turned[kBlock,width], for kColumns vectors from column i on.
template <typename P, int kColumns, typename T>
TT3D_HD void accumulate_columns(const T* gy, const T* turned, T* grad, int64_t i, int64_t width,
                                int64_t out) {
  constexpr int kRows = P::kSumRows, kLanes = P::template kLanes<T>;
  for (int64_t o = 0; o < out; o += kRows) {
    const int64_t rows = std::min<int64_t>(kRows, out - o);
    const T* row[kRows];
    for (int r = 0; r < kRows; ++r) row[r] = gy + (o + std::min<int64_t>(r, rows - 1)) * kRow;
    Lanes<P, T> sum[kRows][kColumns] = {};
    for (int64_t k = 0; k < kBlock; ++k) {
      Lanes<P, T> a[kColumns];
      for (int c = 0; c < kColumns; ++c) a[c] = lanes_at<P>(turned + k * width + i + c * kLanes);
      for (int r = 0; r < kRows; ++r) {
        for (int c = 0; c < kColumns; ++c) sum[r][c] += row[r][k] * a[c];
      }
    }
    for (int64_t r = 0; r < kRows; ++r) {
      if (r >= rows) break;
      for (int c = 0; c < kColumns; ++c) {
        lanes_at<P>(grad + (o + r) * width + i + c * kLanes) += sum[r][c];
      }
    }
  }
}

/// grad[out,padded(in)] += gy[out,kBlock] x[in,kBlock]^T; `turned` holds x transposed.
template <typename P, typename T>
TT3D_HD void accumulate_weights(const T* gy, const T* x, T* turned, T* grad, int64_t in,
                                int64_t out) {
  constexpr int kLanes = P::template kLanes<T>, kColumns = P::kSumColumns;
  const int64_t width = padded(in);
  turn<P>(x, in, width, turned);
  int64_t i = 0;
  for (; i + kColumns * kLanes <= width; i += kColumns * kLanes) {
    accumulate_columns<P, kColumns>(gy, turned, grad, i, width, out);
  }
  for (; i + 2 * kLanes <= width; i += 2 * kLanes) {
    accumulate_columns<P, 2>(gy, turned, grad, i, width, out);
  }
  for (; i < width; i += kLanes) accumulate_columns<P, 1>(gy, turned, grad, i, width, out);
}

/// Copies points [begin, begin + kBlock) of x [rows,count] into a block; zeros past the end.
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

/// The network as an argument of the loops.
template <typename T>
struct Layers {
  const Layer<T>* layer;
  const T* const* transposed;  ///< the weights as [in,out]; only the backward pass reads them
  size_t count;
};

/// Working memory of the loops.
template <typename T>
struct Buffers {
  T* const* activations;  ///< [k] is the input of layer k, the last one the output
  T *grad_a, *grad_b;
  T* turned;  ///< the transposed input of a layer, [points, padded(in)]
};

/// Deleter for memory aligned to cache lines.
struct FreeAligned {
  void operator()(void* memory) const { ::operator delete[](memory, std::align_val_t{64}); }
};
template <typename T>
using Storage = std::unique_ptr<T[], FreeAligned>;

template <typename T>
Storage<T> zeros(int64_t count) {
  return Storage<T>(new (std::align_val_t{64}) T[static_cast<size_t>(count)]());
}

/// The buffers of one thread.
template <typename T>
struct Workspace {
  explicit Workspace(const std::vector<Layer<T>>& layers) {
    int64_t total = layers[0].in, widest = layers[0].in;
    for (const Layer<T>& layer : layers) {
      total += layer.out;
      widest = std::max(widest, layer.out);
    }
    storage = zeros<T>((total + 2 * widest) * kRow + padded(widest) * kBlock);
    T* next = storage.get();
    activations.push_back(next);
    next += layers[0].in * kRow;
    for (const Layer<T>& layer : layers) {
      activations.push_back(next);
      next += layer.out * kRow;
    }
    buffers = {activations.data(), next, next + widest * kRow, next + 2 * widest * kRow};
  }
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  Storage<T> storage;
  std::vector<T*> activations;
  Buffers<T> buffers;
};

template <typename P, typename T>
TT3D_HD void forward_block(const Layers<T>& layers, T* const* activations) {
  for (size_t k = 0; k < layers.count; ++k) {
    const Layer<T>& layer = layers.layer[k];
    T* y = activations[k + 1];
    const T* gate = k + 1 < layers.count ? y : nullptr;
    multiply<P>(layer.weights, activations[k], y, layer.in, layer.out, gate);
  }
}

/// The backward pass of a block; grad_a holds the output's gradient at the start. Returns the
/// input's gradient if it is wanted.
template <typename P, typename T>
TT3D_HD const T* backward_block(const Layers<T>& layers, const Buffers<T>& work,
                                T* const* grad_weights, bool want_input) {
  T *grad = work.grad_a, *next = work.grad_b;
  for (size_t k = layers.count; k-- > 0;) {
    const int64_t in = layers.layer[k].in, out = layers.layer[k].out;
    const T* x = work.activations[k];
    accumulate_weights<P>(grad, x, work.turned, grad_weights[k], in, out);
    if (k == 0 && !want_input) return nullptr;
    multiply<P>(layers.transposed[k], grad, next, out, in, k > 0 ? x : nullptr);
    std::swap(grad, next);
  }
  return grad;
}

/// Forward pass of points [begin, end).
template <typename P, typename T>
TT3D_HD void forward_points(const T* x, const Layers<T>& layers, const Buffers<T>& work, T* out,
                            int64_t begin, int64_t end, int64_t count) {
  for (int64_t b = begin; b < end; b += kBlock) {
    load_block(x, layers.layer[0].in, count, b, work.activations[0]);
    forward_block<P>(layers, work.activations);
    store_block(work.activations[layers.count], layers.layer[layers.count - 1].out, count, b, out);
  }
}

/// Backward pass of points [begin, end): adds to grad_w, writes grad_x if it is wanted.
template <typename P, typename T>
TT3D_HD void backward_points(const T* x, const Layers<T>& layers, const Buffers<T>& work,
                             const T* grad_out, T* grad_x, T* const* grad_w, int64_t begin,
                             int64_t end, int64_t count) {
  for (int64_t b = begin; b < end; b += kBlock) {
    load_block(x, layers.layer[0].in, count, b, work.activations[0]);
    forward_block<P>(layers, work.activations);
    load_block(grad_out, layers.layer[layers.count - 1].out, count, b, work.grad_a);
    const T* grad = backward_block<P>(layers, work, grad_w, grad_x != nullptr);
    if (grad_x) store_block(grad, layers.layer[0].in, count, b, grad_x);
  }
}

}  // namespace tt3d::field
