#pragma once

#include <torch/headeronly/util/Half.h>

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of the small MLPs in half precision, with fused layers, in the tiles that tensor cores
/// multiply (Mueller et al., "Real-time neural radiance caching for path tracing", TOG 2021,
/// section 4.3). Factors are float16, sums float32. A warp takes a tile of points through all
/// layers in its registers: the output of a product has the layout of the next product's input. A
/// team of warps holds the weights in its shared memory. In the backward pass, gradients and inputs
/// go through that memory too, to sum the weights' gradients over points. On the GPU a team is a
/// block (half_mlp.cu). On the CPU it is one thread, i.e. one warp with one lane: the same code
/// gives the same roundings, but slowly.

/// Unrolls the loop that follows, on the GPU, so that the arrays it indexes stay in registers. A
/// macro, because the CPU's compiler warns about an unknown #pragma unroll.
#ifdef __CUDA_ARCH__
#define TT3D_UNROLL _Pragma("unroll")
#else
#define TT3D_UNROLL
#endif

namespace tt3d::field {

using c10::Half;

constexpr int kTile = 16;     ///< side of a tile: points, or units of a layer
constexpr int kMaxTiles = 4;  ///< maximum for a layer's inputs or outputs
constexpr int kMaxHalfLayers = 4;
/// Padding of rows in a team's memory, in numbers: consecutive rows then begin in different banks.
constexpr int kRowGap = 8;
/// Row length of the memory that gradients and inputs go through.
constexpr int kPassRow = kMaxTiles * kTile + kRowGap;
/// Maximum number of teams. Each team has its own sums over points, so their order does not depend
/// on the executor.
constexpr int64_t kMaxTeams = 264;

TT3D_HD int tiles_of(int n) { return (n + kTile - 1) / kTile; }
TT3D_HD int in_tiles(int n) { return tiles_of(n) * kTile; }

/// Clamps to the range of float16; NaN stays NaN.
TT3D_HD float clamp_to_half(float v) {
  constexpr float kLargest = 65504;
  return v > kLargest ? kLargest : v < -kLargest ? -kLargest : v;
}

/// The power of two that brings the largest gradient near 2^8: far above float16's smallest number,
/// while sums within a layer stay below its largest (Micikevicius et al., "Mixed precision
/// training", ICLR 2018, section 3.2).
TT3D_HD float gradient_scale(float largest) {
  constexpr float kSmallest = 1e-30F;
  int exponent = 0;
  (void)std::frexp(256 / (largest > kSmallest ? largest : kSmallest), &exponent);
  return std::ldexp(1.0F, exponent - 1);
}

/// The network's layers: float32 weights [out,in].
struct HalfNetwork {
  struct Layer {
    const float* weights;
    int in, out;
    TT3D_HD int row() const { return in_tiles(in) + kRowGap; }
    TT3D_HD int turned_row() const { return in_tiles(out) + kRowGap; }
    TT3D_HD int tiles() const { return tiles_of(in) * tiles_of(out); }
  };
  Layer layer[kMaxHalfLayers];
  int count;

  /// Size of all weight gradients, stored tile by tile.
  TT3D_HD int64_t sums() const {
    int64_t total = 0;
    for (int k = 0; k < count; ++k) total += layer[k].tiles() * kTile * kTile;
    return total;
  }
};

/// A team's memory. Weights are padded with zeros to whole tiles.
struct HalfBuffers {
  Half* weights[kMaxHalfLayers];  ///< [out, row()]
  Half* turned[kMaxHalfLayers];   ///< backward: transposed weights [in, turned_row()]
  Half *grads, *inputs;           ///< backward: of one layer, [points, kPassRow]

  /// Divides the memory into buffers; returns their total size in bytes. With null it only counts.
  TT3D_HD int64_t lay_out(const HalfNetwork& net, bool backward, int warps, char* memory) {
    int64_t used = 0;
    const auto take = [&](int64_t numbers) {
      char* piece = memory ? memory + used : nullptr;
      used += 2 * numbers;
      return reinterpret_cast<Half*>(piece);
    };
    for (int k = 0; k < net.count; ++k) {
      const HalfNetwork::Layer& layer = net.layer[k];
      weights[k] = take(in_tiles(layer.out) * layer.row());
      if (backward) turned[k] = take(in_tiles(layer.in) * layer.turned_row());
    }
    if (!backward) return used;
    grads = take(warps * kTile * kPassRow);
    inputs = take(warps * kTile * kPassRow);
    return used;
  }
};

template <typename Team>
TT3D_HD void load_weights(const Team& team, const HalfNetwork& net, bool backward,
                          const HalfBuffers& work) {
  for (int k = 0; k < net.count; ++k) {
    const HalfNetwork::Layer& layer = net.layer[k];
    const int width = in_tiles(layer.in);
    for (int e = team.thread(); e < in_tiles(layer.out) * width; e += team.threads()) {
      const int o = e / width, i = e % width;
      const bool inside = o < layer.out && i < layer.in;
      const Half w = clamp_to_half(inside ? layer.weights[o * layer.in + i] : 0.0F);
      work.weights[k][o * layer.row() + i] = w;
      if (backward) work.turned[k][i * layer.turned_row() + o] = w;
    }
  }
}

/// Loads points [begin, begin + kTile) of x [rows,count] times `factor`; zeros outside.
template <typename Factors>
TT3D_HD void load_points(const float* x, int rows, int64_t count, int64_t begin, float factor,
                         Factors (&into)[kMaxTiles]) {
  TT3D_UNROLL
  for (int t = 0; t < kMaxTiles; ++t) {
    if (t * kTile >= rows) continue;
    into[t].set([&](int point, int column) {
      const int row = t * kTile + column;
      const bool inside = row < rows && begin + point < count;
      return clamp_to_half(inside ? x[row * count + begin + point] * factor : 0.0F);
    });
  }
}

/// Multiplies the points' inputs x (`in` numbers per point) with weights [out, stride]. Calls
/// use(tile, sums) for every tile of outputs.
template <typename Sums, typename Factors, typename Use>
TT3D_HD void multiply(const Factors (&x)[kMaxTiles], int in, const Half* weights, int stride,
                      int out, const Use& use) {
  TT3D_UNROLL
  for (int o = 0; o < kMaxTiles; ++o) {
    if (o * kTile >= out) continue;
    Sums sums;
    sums.clear();
    TT3D_UNROLL
    for (int i = 0; i < kMaxTiles; ++i) {
      if (i * kTile >= in) continue;
      sums.add_product(x[i], weights + o * kTile * stride + i * kTile, stride);
    }
    use(o, sums);
  }
}

/// A layer followed by a ReLU.
template <typename Sums, typename Factors>
TT3D_HD void rectified_layer(const HalfNetwork::Layer& layer, const Half* weights,
                             const Factors (&x)[kMaxTiles], Factors (&y)[kMaxTiles]) {
  multiply<Sums>(x, layer.in, weights, layer.row(), layer.out,
                 [&](int tile, const Sums& sums) { y[tile].set_rectified(sums); });
}

/// Writes a tile of a result [rows,count] for the points from `begin` on.
template <typename Sums>
TT3D_HD void write_points(const Sums& sums, int tile, int rows, int64_t count, int64_t begin,
                          float factor, float* out) {
  sums.each([&](int point, int column, float v) {
    const int row = tile * kTile + column;
    if (row < rows && begin + point < count) out[row * count + begin + point] = v * factor;
  });
}

/// A team's part of the forward pass: x [in,count] to out [out,count].
template <int kLayers>
struct HalfForward {
  HalfNetwork net;
  const float* x;
  float* out;
  int64_t count;

  TT3D_HD int64_t bytes(int warps) const {
    HalfBuffers work;
    return work.lay_out(net, false, warps, nullptr);
  }

  template <typename Team>
  TT3D_HD void operator()(const Team& team, char* memory, int64_t first, int64_t teams) const {
    using Sums = typename Team::Sums;
    HalfBuffers work;
    work.lay_out(net, false, team.warps(), memory);
    load_weights(team, net, false, work);
    team.sync();
    const int64_t stride = teams * team.warps() * kTile;
    const HalfNetwork::Layer& last = net.layer[kLayers - 1];
    for (int64_t begin = (first * team.warps() + team.warp()) * kTile; begin < count;
         begin += stride) {
      typename Team::Factors y[kLayers][kMaxTiles];
      load_points(x, net.layer[0].in, count, begin, 1, y[0]);
      TT3D_UNROLL
      for (int k = 0; k + 1 < kLayers; ++k) {
        rectified_layer<Sums>(net.layer[k], work.weights[k], y[k], y[k + 1]);
      }
      multiply<Sums>(y[kLayers - 1], last.in, work.weights[kLayers - 1], last.row(), last.out,
                     [&](int tile, const Sums& sums) {
                       write_points(sums, tile, last.out, count, begin, 1, out);
                     });
    }
  }
};

/// A team's part of the backward pass. Gradients are scaled by gradient_scale(*largest) inside.
template <int kLayers>
struct HalfBackward {
  HalfNetwork net;
  const float *x, *grad_out;  ///< [in,count], [out,count]
  const float* largest;       ///< largest absolute value of grad_out
  float* grad_x;              ///< [in,count], or null
  float* sums;                ///< [teams, net.sums()]
  int64_t count;

  TT3D_HD int64_t bytes(int warps) const {
    HalfBuffers work;
    return work.lay_out(net, true, warps, nullptr);
  }

  template <typename Team>
  TT3D_HD void operator()(const Team& team, char* memory, int64_t first, int64_t teams) const {
    using Sums = typename Team::Sums;
    using Factors = typename Team::Factors;
    HalfBuffers work;
    work.lay_out(net, true, team.warps(), memory);
    load_weights(team, net, true, work);
    const float scale = gradient_scale(*largest), back = 1 / scale;
    Sums own[kLayers][Team::kShare];  // the tiles of the weights' gradients that this warp sums
    for (auto& layer : own) {
      for (Sums& tile : layer) tile.clear();
    }
    const int64_t points = static_cast<int64_t>(team.warps()) * kTile;
    team.sync();
    for (int64_t begin = first * points; begin < count; begin += teams * points) {
      const int64_t warp_begin = begin + team.warp() * kTile;
      Factors y[kLayers][kMaxTiles], grad[kMaxTiles], next[kMaxTiles];
      load_points(x, net.layer[0].in, count, warp_begin, 1, y[0]);
      load_points(grad_out, net.layer[kLayers - 1].out, count, warp_begin, scale, grad);
      TT3D_UNROLL
      for (int k = 0; k + 1 < kLayers; ++k) {
        rectified_layer<Sums>(net.layer[k], work.weights[k], y[k], y[k + 1]);
      }
      TT3D_UNROLL
      for (int k = kLayers - 1; k >= 0; --k) {
        const HalfNetwork::Layer& layer = net.layer[k];
        pass_points(team, grad, layer.out, work.grads);
        pass_points(team, y[k], layer.in, work.inputs);
        team.sync();
        add_weight_gradient(team, layer, work, own[k]);
        if (k > 0) {
          multiply<Sums>(grad, layer.out, work.turned[k], layer.turned_row(), layer.in,
                         [&](int tile, const Sums& s) { next[tile].set_masked(s, y[k][tile]); });
          TT3D_UNROLL
          for (int t = 0; t < kMaxTiles; ++t) grad[t] = next[t];
        } else if (grad_x) {
          multiply<Sums>(grad, layer.out, work.turned[0], layer.turned_row(), layer.in,
                         [&](int tile, const Sums& s) {
                           write_points(s, tile, layer.in, count, warp_begin, back, grad_x);
                         });
        }
        team.sync();
      }
    }
    write_sums(team, own, back, sums + first * net.sums());
  }

 private:
  /// Stores a warp's points in the team's memory, row by row.
  template <typename Team, typename Factors>
  TT3D_HD static void pass_points(const Team& team, const Factors (&x)[kMaxTiles], int numbers,
                                  Half* memory) {
    TT3D_UNROLL
    for (int t = 0; t < kMaxTiles; ++t) {
      if (t * kTile >= numbers) continue;
      x[t].store(memory + team.warp() * kTile * kPassRow + t * kTile, kPassRow);
    }
  }

  /// own += grads^T inputs over the team's points, for the warp's tiles of the layer.
  template <typename Team, typename Sums>
  TT3D_HD static void add_weight_gradient(const Team& team, const HalfNetwork::Layer& layer,
                                          const HalfBuffers& work, Sums (&own)[Team::kShare]) {
    const int columns = tiles_of(layer.in);
    TT3D_UNROLL
    for (int j = 0; j < Team::kShare; ++j) {
      const int tile = team.warp() + j * team.warps();
      if (tile >= layer.tiles()) continue;
      const Half* g = work.grads + tile / columns * kTile;
      const Half* x = work.inputs + tile % columns * kTile;
      for (int p = 0; p < team.warps() * kTile; p += kTile) {
        own[j].add_turned_product(g + p * kPassRow, x + p * kPassRow, kPassRow);
      }
    }
  }

  template <typename Team, typename Sums>
  TT3D_HD void write_sums(const Team& team, const Sums (&own)[kLayers][Team::kShare], float factor,
                          float* to) const {
    TT3D_UNROLL
    for (int k = 0; k < kLayers; ++k) {
      TT3D_UNROLL
      for (int j = 0; j < Team::kShare; ++j) {
        const int tile = team.warp() + j * team.warps();
        if (tile >= net.layer[k].tiles()) continue;
        own[k][j].each([&](int row, int column, float v) {
          to[(tile * kTile + row) * kTile + column] = v * factor;
        });
      }
      to += net.layer[k].tiles() * kTile * kTile;
    }
  }
};

/// The CPU's team: one thread, whose single lane holds whole tiles.
struct OneThread {
  struct Sums;

  /// Factors of a product: row i, column j at [i * kTile + j].
  struct Factors {
    Half value[kTile * kTile];
    template <typename Get>
    void set(const Get& get) {
      for (int e = 0; e < kTile * kTile; ++e) value[e] = get(e / kTile, e % kTile);
    }
    /// Sets the factors to ReLU(sums).
    void set_rectified(const Sums& sums) {
      for (int e = 0; e < kTile * kTile; ++e) {
        value[e] = clamp_to_half(sums.value[e] < 0 ? 0.0F : sums.value[e]);
      }
    }
    /// Sets the factors to the sums where `positive` > 0, and to 0 elsewhere.
    void set_masked(const Sums& sums, const Factors& positive) {
      for (int e = 0; e < kTile * kTile; ++e) {
        const bool open = static_cast<float>(positive.value[e]) > 0;
        value[e] = clamp_to_half(open ? sums.value[e] : 0.0F);
      }
    }
    void store(Half* to, int stride) const {
      for (int e = 0; e < kTile * kTile; ++e) to[e / kTile * stride + e % kTile] = value[e];
    }
  };

  struct Sums {
    float value[kTile * kTile];
    void clear() {
      for (float& v : value) v = 0;
    }
    /// this += a b^T; b is a tile of a matrix with row length `stride`.
    void add_product(const Factors& a, const Half* b, int stride) {
      float fb[kTile * kTile];
      for (int j = 0; j < kTile; ++j) {
        for (int k = 0; k < kTile; ++k) fb[k * kTile + j] = b[j * stride + k];
      }
      for (int i = 0; i < kTile; ++i) {
        for (int k = 0; k < kTile; ++k) {
          const float factor = a.value[i * kTile + k];
          for (int j = 0; j < kTile; ++j) value[i * kTile + j] += factor * fb[k * kTile + j];
        }
      }
    }
    /// this += a^T b; both are tiles of matrices with row length `stride`.
    void add_turned_product(const Half* a, const Half* b, int stride) {
      for (int k = 0; k < kTile; ++k) {
        float row[kTile];
        for (int j = 0; j < kTile; ++j) row[j] = b[k * stride + j];
        for (int i = 0; i < kTile; ++i) {
          const float factor = a[k * stride + i];
          for (int j = 0; j < kTile; ++j) value[i * kTile + j] += factor * row[j];
        }
      }
    }
    /// Calls use(row, column, value) for the numbers in the lane, here all of the tile.
    template <typename Use>
    void each(const Use& use) const {
      for (int e = 0; e < kTile * kTile; ++e) use(e / kTile, e % kTile, value[e]);
    }
  };

  /// Maximum number of weight gradient tiles per layer that one warp sums.
  static constexpr int kShare = kMaxTiles * kMaxTiles;
  static int thread() { return 0; }
  static int threads() { return 1; }
  static int warp() { return 0; }
  static int warps() { return 1; }
  static void sync() {}
};

/// Runs `share` on each of `teams` teams: on the CPU's threads, or one block per team on the GPU.
template <typename Share>
void run_teams(const Cpu&, int64_t teams, const Share& share);
template <typename Share>
void run_teams(const Cuda& on, int64_t teams, const Share& share);
/// Points that a team of this executor processes together.
TT3D_HD int64_t team_points(const Cpu&) { return kTile; }
constexpr int kTeamWarps = 8;  ///< on the GPU
TT3D_HD int64_t team_points(const Cuda&) { return kTeamWarps * kTile; }

/// Expands DEFINE(layers) for each number of layers. A macro, for lists of explicit instantiations.
#define TT3D_FOR_EACH_DEPTH(DEFINE) DEFINE(1) DEFINE(2) DEFINE(3) DEFINE(4)

}  // namespace tt3d::field
