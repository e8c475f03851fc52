#pragma once

#include <torch/headeronly/util/Half.h>

#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of the small networks in half precision, fused layer to layer, in the tiles that tensor
/// cores multiply (Mueller et al., "Real-time neural radiance caching for path tracing", TOG 2021,
/// section 4.3). Factors are float16, sums float32. A team of threads takes a few points at a time
/// through all layers within its own memory: the warps of a block with shared memory on the GPU
/// (half_mlp.cu), one thread on the CPU, where the same text gives the same roundings, slowly.
namespace tt3d::field {

using c10::Half;

constexpr int kTile = 16;        ///< side of a tile
constexpr int kTeamPoints = 64;  ///< points that a team takes through the layers at once
/// Numbers from a row of points to the next: rows that lie apart fall into different banks.
constexpr int kTeamRow = kTeamPoints + 8;
constexpr int kMaxHalfLayers = 4;
/// Teams at most. The sums over points are made a team at a time, whatever runs them.
constexpr int64_t kMaxTeams = 512;
constexpr int kTeamWarps = 4;  ///< on the GPU
/// Shared memory of a block on the smallest GPU that this is compiled for (sm_80), less a reserve.
constexpr int64_t kTeamBytes = 160 << 10;

TT3D_HD int tiles_of(int n) { return (n + kTile - 1) / kTile; }
TT3D_HD int in_tiles(int n) { return tiles_of(n) * kTile; }

/// Rounds to the nearest; what float16 cannot hold becomes its largest number.
TT3D_HD Half to_half(float v) {
  constexpr float kLargest = 65504;
  return {v > kLargest ? kLargest : v < -kLargest ? -kLargest : v};
}

/// The network: float32 weights [out,in].
struct HalfNetwork {
  struct Layer {
    const float* weights;
    int in, out;
  };
  Layer layer[kMaxHalfLayers];
  int count;

  /// Numbers of all weight gradients, tile after tile.
  TT3D_HD int64_t sums() const {
    int64_t total = 0;
    for (int k = 0; k < count; ++k) total += in_tiles(layer[k].in) * in_tiles(layer[k].out);
    return total;
  }
};

/// A team's memory. Rows are filled up with zeros to whole tiles.
struct HalfBuffers {
  Half* weights[kMaxHalfLayers];          ///< [out, in + 8]
  Half* activations[kMaxHalfLayers + 1];  ///< [k]: input of layer k, [in, kTeamRow]
  Half *grad, *next;                      ///< gradients of a layer's output and input
  float* sums;                            ///< weight gradients so far
  float* staging;                         ///< a tile for each warp

  /// Cuts the memory into buffers; returns the bytes they take. With null it only counts.
  TT3D_HD int64_t lay_out(const HalfNetwork& net, bool backward, int warps, char* memory) {
    int64_t used = 0;
    const auto take = [&](int64_t bytes) {
      char* piece = memory ? memory + used : nullptr;
      used += bytes;
      return piece;
    };
    const auto take_half = [&](int64_t n) { return reinterpret_cast<Half*>(take(2 * n)); };
    const auto take_float = [&](int64_t n) { return reinterpret_cast<float*>(take(4 * n)); };
    int widest = in_tiles(net.layer[0].in);
    activations[0] = take_half(widest * kTeamRow);
    for (int k = 0; k < net.count; ++k) {
      const int in = in_tiles(net.layer[k].in), out = in_tiles(net.layer[k].out);
      weights[k] = take_half(out * (in + 8));
      activations[k + 1] = k + 1 < net.count ? take_half(out * kTeamRow) : nullptr;
      widest = out > widest ? out : widest;
    }
    staging = take_float(warps * kTile * kTile);
    if (!backward) return used;
    grad = take_half(widest * kTeamRow);
    next = take_half(widest * kTeamRow);
    sums = take_float(net.sums());
    return used;
  }
};

/// Calls `use(row, point, sum)` for every number of the product of a matrix [rows,inner] with
/// x [inner,kTeamPoints]. The matrix's row length is `stride`; `kTurned` says that it is stored
/// as [inner,rows].
template <bool kTurned, typename Team, typename Use>
TT3D_HD void each_of_product(const Team& team, const Half* matrix, int stride, const Half* x,
                             int rows, int inner, float* staging, const Use& use) {
  constexpr int kColumns = kTeamPoints / kTile;
  float* own = staging + team.warp() * kTile * kTile;
  for (int t = team.warp(); t < tiles_of(rows) * kColumns; t += team.warps()) {
    const int r = t / kColumns * kTile, c = t % kColumns * kTile;
    typename Team::Tile sum;
    sum.clear();
    for (int i = 0; i < inner; i += kTile) {
      const Half* a = kTurned ? matrix + i * stride + r : matrix + r * stride + i;
      sum.template add_product<kTurned, false>(a, stride, x + i * kTeamRow + c, kTeamRow);
    }
    sum.store(own);
    team.sync_warp();
    for (int e = team.lane(); e < kTile * kTile; e += team.lanes()) {
      use(r + e / kTile, c + e % kTile, own[e]);
    }
    team.sync_warp();
  }
}

/// sums[out,in] += grad[out,kTeamPoints] x[in,kTeamPoints]^T, tile after tile.
template <typename Team>
TT3D_HD void add_weight_gradient(const Team& team, const Half* grad, const Half* x, int out, int in,
                                 float* sums) {
  const int columns = tiles_of(in);
  for (int t = team.warp(); t < tiles_of(out) * columns; t += team.warps()) {
    const Half* g = grad + t / columns * kTile * kTeamRow;
    const Half* a = x + t % columns * kTile * kTeamRow;
    typename Team::Tile sum;
    sum.load(sums + t * kTile * kTile);
    for (int p = 0; p < kTeamPoints; p += kTile) {
      sum.template add_product<false, true>(g + p, kTeamRow, a + p, kTeamRow);
    }
    sum.store(sums + t * kTile * kTile);
  }
}

/// Points [begin, begin + kTeamPoints) of x [rows,count] times `factor`, zeros outside.
template <typename Team>
TT3D_HD void load_points(const Team& team, const float* x, int rows, int64_t count, int64_t begin,
                         float factor, Half* into) {
  for (int e = team.thread(); e < in_tiles(rows) * kTeamPoints; e += team.threads()) {
    const int row = e / kTeamPoints, p = e % kTeamPoints;
    const bool inside = row < rows && begin + p < count;
    into[row * kTeamRow + p] = to_half(inside ? x[row * count + begin + p] * factor : 0.0F);
  }
}

template <typename Team>
TT3D_HD void load_weights(const Team& team, const HalfNetwork& net, const HalfBuffers& work) {
  for (int k = 0; k < net.count; ++k) {
    const HalfNetwork::Layer& layer = net.layer[k];
    const int width = in_tiles(layer.in);
    for (int e = team.thread(); e < in_tiles(layer.out) * width; e += team.threads()) {
      const int o = e / width, i = e % width;
      const bool inside = o < layer.out && i < layer.in;
      work.weights[k][o * (width + 8) + i] =
          to_half(inside ? layer.weights[o * layer.in + i] : 0.0F);
    }
  }
}

/// A layer with a rectifier behind it.
template <typename Team>
TT3D_HD void rectified_layer(const Team& team, const HalfNetwork& net, const HalfBuffers& work,
                             int k) {
  const int in = in_tiles(net.layer[k].in);
  Half* y = work.activations[k + 1];
  each_of_product<false>(
      team, work.weights[k], in + 8, work.activations[k], net.layer[k].out, in, work.staging,
      [&](int row, int p, float v) { y[row * kTeamRow + p] = to_half(v < 0 ? 0.0F : v); });
}

/// A team's share of the forward pass: x [in,count] to out [out,count].
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
    HalfBuffers work;
    work.lay_out(net, false, team.warps(), memory);
    load_weights(team, net, work);
    const int last = net.count - 1, rows = net.layer[last].out;
    const int in = in_tiles(net.layer[last].in);
    for (int64_t begin = first * kTeamPoints; begin < count; begin += teams * kTeamPoints) {
      load_points(team, x, net.layer[0].in, count, begin, 1, work.activations[0]);
      team.sync();
      for (int k = 0; k < last; ++k) {
        rectified_layer(team, net, work, k);
        team.sync();
      }
      each_of_product<false>(team, work.weights[last], in + 8, work.activations[last], rows, in,
                             work.staging, [&](int row, int p, float v) {
                               if (row < rows && begin + p < count)
                                 out[row * count + begin + p] = v;
                             });
      team.sync();
    }
  }
};

/// A team's share of the backward pass. Gradients are carried times *scale, a power of two that
/// keeps them in float16's range (Micikevicius et al., "Mixed precision training", ICLR 2018,
/// section 3.2).
struct HalfBackward {
  HalfNetwork net;
  const float *x, *grad_out;  ///< [in,count], [out,count]
  const float* scale;         ///< one number
  float* grad_x;              ///< [in,count], or null
  float* sums;                ///< [teams, net.sums()], times *scale
  int64_t count;

  TT3D_HD int64_t bytes(int warps) const {
    HalfBuffers work;
    return work.lay_out(net, true, warps, nullptr);
  }

  template <typename Team>
  TT3D_HD void operator()(const Team& team, char* memory, int64_t first, int64_t teams) const {
    HalfBuffers work;
    work.lay_out(net, true, team.warps(), memory);
    load_weights(team, net, work);
    const int64_t numbers = net.sums();
    for (int64_t e = team.thread(); e < numbers; e += team.threads()) work.sums[e] = 0;
    for (int64_t begin = first * kTeamPoints; begin < count; begin += teams * kTeamPoints) {
      load_points(team, x, net.layer[0].in, count, begin, 1, work.activations[0]);
      load_points(team, grad_out, net.layer[net.count - 1].out, count, begin, *scale, work.grad);
      team.sync();
      for (int k = 0; k + 1 < net.count; ++k) {
        rectified_layer(team, net, work, k);
        team.sync();
      }
      walk_back(team, work, begin);
    }
    for (int64_t e = team.thread(); e < numbers; e += team.threads()) {
      sums[first * numbers + e] = work.sums[e];
    }
  }

 private:
  template <typename Team>
  TT3D_HD void walk_back(const Team& team, const HalfBuffers& work, int64_t begin) const {
    Half *grad = work.grad, *next = work.next;
    float* layer_sums = work.sums + net.sums();
    for (int k = net.count - 1; k >= 0; --k) {
      const int in = net.layer[k].in, out = net.layer[k].out;
      const int width = in_tiles(in);
      layer_sums -= width * in_tiles(out);
      add_weight_gradient(team, grad, work.activations[k], out, in, layer_sums);
      if (k > 0) {
        const Half* y = work.activations[k];
        each_of_product<true>(team, work.weights[k], width + 8, grad, in, in_tiles(out),
                              work.staging, [&](int row, int p, float v) {
                                const int at = row * kTeamRow + p;
                                next[at] = to_half(static_cast<float>(y[at]) > 0 ? v : 0.0F);
                              });
      } else if (grad_x) {
        const float back = 1 / *scale;
        each_of_product<true>(team, work.weights[0], width + 8, grad, in, in_tiles(out),
                              work.staging, [&](int row, int p, float v) {
                                if (row < in && begin + p < count)
                                  grad_x[row * count + begin + p] = v * back;
                              });
      }
      team.sync();
      Half* const done = grad;
      grad = next;
      next = done;
    }
  }
};

/// The CPU's team: one thread.
struct OneThread {
  /// What a tensor core does in its registers.
  struct Tile {
    float sum[kTile * kTile];
    void clear() {
      for (float& s : sum) s = 0;
    }
    void load(const float* from) {
      for (int e = 0; e < kTile * kTile; ++e) sum[e] = from[e];
    }
    void store(float* to) const {
      for (int e = 0; e < kTile * kTile; ++e) to[e] = sum[e];
    }
    /// += a b; a turned matrix is stored column by column.
    template <bool kTurnedA, bool kTurnedB>
    void add_product(const Half* a, int stride_a, const Half* b, int stride_b) {
      float fa[kTile * kTile], fb[kTile * kTile];
      for (int i = 0; i < kTile; ++i) {
        for (int k = 0; k < kTile; ++k) {
          fa[i * kTile + k] = kTurnedA ? a[k * stride_a + i] : a[i * stride_a + k];
          fb[i * kTile + k] = kTurnedB ? b[k * stride_b + i] : b[i * stride_b + k];
        }
      }
      for (int i = 0; i < kTile; ++i) {
        for (int k = 0; k < kTile; ++k) {
          for (int j = 0; j < kTile; ++j) {
            sum[i * kTile + j] += fa[i * kTile + k] * fb[k * kTile + j];
          }
        }
      }
    }
  };
  static int thread() { return 0; }
  static int threads() { return 1; }
  static int warp() { return 0; }
  static int warps() { return 1; }
  static int lane() { return 0; }
  static int lanes() { return 1; }
  static void sync() {}
  static void sync_warp() {}
};

/// Runs a share on each of `teams` teams. On the CPU over its threads; on the GPU a block each.
template <typename Share>
void run_teams(const Cpu&, int64_t teams, const Share& share);
template <typename Share>
void run_teams(const Cuda& on, int64_t teams, const Share& share);

}  // namespace tt3d::field
