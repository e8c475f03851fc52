#include "plan_kernels.h"

#include <ATen/ATen.h>

#include <bit>
#include <cmath>
#include <cstring>

#include "tt3d/device.h"
#include "tt3d/kernel.h"

namespace tt3d::model {
namespace {

/// The type that sums of stored numbers have.
template <typename Storage>
using SumOf = std::conditional_t<std::is_same_v<Storage, double>, double, float>;

constexpr int64_t kBlock = 16;  ///< channels of a block; its bits fill a uint16

/// Vectors of a number of bytes; nested, because GCC drops the size of a vector otherwise.
template <int kBytes>
struct VectorOf {
  template <typename T>
  struct Of {
    typedef T Type __attribute__((vector_size(kBytes), aligned(sizeof(T)), may_alias));
  };
};

template <typename Vector, typename T>
TT3D_HD const Vector& lanes_at(const T* numbers) {
  return *reinterpret_cast<const Vector*>(numbers);
}

// ---- Masks --------------------------------------------------------------------------------

/// Elements of a chunk of a mask: one task.
constexpr int64_t kChunk = 1 << 15;

/// Numbers beside each other, as many as a vector of `kVectorBytes` has floats.
template <int kVectorBytes, typename Number>
using FloatLanes = typename VectorOf<kVectorBytes / 4 *
                                     static_cast<int>(sizeof(Number))>::template Of<Number>::Type;

/// Sets the bits of blocks. Positive floats keep their order as integers, and negative ones are
/// negative, so 0 < value < high is a comparison of integers; without a sign it is a single one.
template <typename Integer>
TT3D_HD void set_bits(const Integer* values, int64_t blocks, Integer high, uint16_t* bits) {
  using Natural = std::make_unsigned_t<Integer>;
  const auto limit = static_cast<Natural>(high - 1);
  constexpr int64_t kGroup = 64;  // blocks
  alignas(64) uint8_t flags[kGroup * kBlock];
  for (int64_t first = 0; first < blocks; first += kGroup) {
    const int64_t count = blocks - first < kGroup ? blocks - first : kGroup;
    const Integer* from = values + first * kBlock;
    for (int64_t i = 0; i < count * kBlock; ++i) {
      flags[i] =
          static_cast<uint8_t>(static_cast<Natural>(static_cast<Natural>(from[i]) - 1) < limit);
    }
    for (int64_t b = 0; b < count; ++b) {
      uint64_t halves[2];
      std::memcpy(halves, flags + b * kBlock, sizeof(halves));
      // Gathers the lowest bit of each byte: the product puts them side by side in the top byte.
      constexpr uint64_t kGather = 0x0102040810204080ULL;
      const uint64_t low = (halves[0] * kGather) >> 56, top = (halves[1] * kGather) >> 56;
      bits[first + b] = static_cast<uint16_t>(low | top << 8);
    }
  }
}

/// Sets the lanes whose bit is not set to zero; `first`: index of lane 0 in its block.
template <int kBytes, typename Number, typename Integer>
TT3D_HD void clear_lanes(typename VectorOf<kBytes>::template Of<Number>::Type& value, uint16_t word,
                         int64_t first) {
  using Lanes = typename VectorOf<kBytes>::template Of<Integer>::Type;
  using Numbers = typename VectorOf<kBytes>::template Of<Number>::Type;
  Lanes bit;
  for (int i = 0; i < kBytes / static_cast<int>(sizeof(Number)); ++i) {
    bit[i] = static_cast<Integer>(1LL << i);
  }
  const Lanes all = Lanes{} + static_cast<Integer>(word >> first);
  const Numbers zero = {};
  value = (all & bit) != 0 ? value : zero;
}

template <int kVectorBytes, typename Integer>
TT3D_HD void clear_unset(Integer* values, int64_t blocks, const uint16_t* bits) {
  constexpr int kLanes = kVectorBytes / 4;
  using Lanes = FloatLanes<kVectorBytes, Integer>;
  for (int64_t b = 0; b < blocks; ++b) {
    for (int i = 0; i < kBlock; i += kLanes) {
      clear_lanes<kLanes* static_cast<int>(sizeof(Integer)), Integer, Integer>(
          *reinterpret_cast<Lanes*>(values + b * kBlock + i), bits[b], i);
    }
  }
}

#define TT3D_SET(Integer)                                                                       \
  TT3D_CPU_LOOP void set(const Integer* values, int64_t blocks, Integer high, uint16_t* bits) { \
    set_bits(values, blocks, high, bits);                                                       \
  }
#define TT3D_CLEAR(attributes, bytes, Integer)                                   \
  attributes void clear(Integer* values, int64_t blocks, const uint16_t* bits) { \
    clear_unset<bytes>(values, blocks, bits);                                    \
  }
TT3D_SET(int16_t)
TT3D_SET(int32_t)
TT3D_SET(int64_t)
TT3D_FOR_EACH_CPU(TT3D_CLEAR, int16_t)
TT3D_FOR_EACH_CPU(TT3D_CLEAR, int32_t)
TT3D_CLEAR(, 16, int64_t)  // for tests
#undef TT3D_SET
#undef TT3D_CLEAR

/// The integer as wide as a storage type, and the bits of a limit in it.
template <typename Storage>
struct AsInteger;
template <>
struct AsInteger<at::BFloat16> {
  using Type = int16_t;
};
template <>
struct AsInteger<float> {
  using Type = int32_t;
};
template <>
struct AsInteger<double> {
  using Type = int64_t;
};

template <typename Storage>
typename AsInteger<Storage>::Type limit_of(const Clamp& clamp) {
  using Integer = typename AsInteger<Storage>::Type;
  // Every number is below the largest integer, also infinity.
  if (std::isinf(clamp.high)) return std::numeric_limits<Integer>::max();
  return std::bit_cast<Integer>(static_cast<Storage>(static_cast<SumOf<Storage>>(clamp.high)));
}

/// Calls `body` with a null pointer to the storage type of `type`.
template <typename Body>
void with_storage(at::ScalarType type, const Body& body) {
  switch (type) {
    case at::kFloat:
      return body(static_cast<float*>(nullptr));
    case at::kBFloat16:
      return body(static_cast<at::BFloat16*>(nullptr));
    default:
      return body(static_cast<double*>(nullptr));
  }
}

/// Calls `body(values, blocks, bits)` over the chunks of a tensor, the last block filled up with
/// zeros. Writes the values back if `writes`.
template <typename Integer, typename Body>
void for_each_mask_chunk(Integer* values, int64_t n, uint16_t* bits, const Body& body) {
  for_each_chunk(n / kBlock, kChunk / kBlock, [&](int64_t first, int64_t last) {
    body(values + first * kBlock, last - first, bits + first);
  });
  const int64_t whole = n / kBlock * kBlock;
  if (whole == n) return;
  Integer rest[kBlock] = {};
  std::copy(values + whole, values + n, rest);
  body(rest, 1, bits + whole / kBlock);
  std::copy(rest, rest + (n - whole), values + whole);
}

uint16_t* words(const at::Tensor& bits) {
  return reinterpret_cast<uint16_t*>(bits.mutable_data_ptr<uint8_t>());
}

at::Tensor new_bits(int64_t elements) {
  return at::empty({(elements + kBlock - 1) / kBlock * 2}, at::kByte);
}

// ---- Depthwise convolution ----------------------------------------------------------------

/// One row of results: out[j] = sum over r, k of in[r][start + j * step + k] * weight[r][k].
template <typename Storage, typename Sum>
struct DepthwiseRow {
  int rows = 0, taps = 0;  ///< of the window
  const Storage* in[5] = {};
  const Sum* weight = nullptr;  ///< [rows][taps][channels]
  const Sum* bias = nullptr;    ///< [channels] or null
  int64_t channels = 0, in_width = 0, start = 0, step = 1;
  Storage* out = nullptr;
  int64_t count = 0, out_step = 1;  ///< results, and elements of `channels` from one to the next
  bool clamps = false;
  Sum high = 0;
  const uint16_t* bits = nullptr;  ///< mask of the results, or null; of a block at `out`
};

/// Vectors of sums, and how they are stored. Nothing here or below returns a vector or is a lambda:
/// either would be compiled for the plain processor.
template <int kVectorBytes, typename Storage, typename Sum>
struct Vectors {
  using Type = typename VectorOf<kVectorBytes>::template Of<Sum>::Type;
  static constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Sum));
  TT3D_HD static void load(const Storage* from, Type& to) { to = lanes_at<Type>(from); }
  TT3D_HD static void store(const Type& value, Storage* to) {
    *reinterpret_cast<Type*>(to) = value;
  }
};

/// bfloat16 is the upper half of a float32; rounded to the nearest, ties to even.
template <int kVectorBytes>
struct Vectors<kVectorBytes, at::BFloat16, float> {
  using Type = typename VectorOf<kVectorBytes>::template Of<float>::Type;
  using Wide = typename VectorOf<kVectorBytes>::template Of<uint32_t>::Type;
  using Narrow = typename VectorOf<kVectorBytes / 2>::template Of<uint16_t>::Type;
  static constexpr int kLanes = kVectorBytes / 4;
  TT3D_HD static void load(const at::BFloat16* from, Type& to) {
    const Wide wide = __builtin_convertvector(lanes_at<Narrow>(from), Wide);
    to = reinterpret_cast<Type>(wide << 16);
  }
  TT3D_HD static void store(const Type& value, at::BFloat16* to) {
    const Wide wide = reinterpret_cast<Wide>(value);
    const Wide rounded = (wide + 0x7fff + ((wide >> 16) & 1)) >> 16;
    *reinterpret_cast<Narrow*>(to) = __builtin_convertvector(rounded, Narrow);
  }
};

template <typename V, typename Storage, typename Sum>
TT3D_HD void finish(const DepthwiseRow<Storage, Sum>& row, typename V::Type& sum, int64_t j,
                    int64_t c) {
  using Vector = typename V::Type;
  if (row.clamps) {
    const Vector zero = {}, high = Vector{} + row.high;
    sum = sum > zero ? sum : zero;
    sum = sum < high ? sum : high;
  }
  const int64_t place = j * row.out_step * row.channels + c;
  if (row.bits != nullptr) {
    using Integer = std::conditional_t<sizeof(Sum) == 4, int32_t, int64_t>;
    clear_lanes<static_cast<int>(sizeof(Vector)), Sum, Integer>(sum, row.bits[place / kBlock],
                                                                c % kBlock);
  }
  V::store(sum, row.out + place);
}

/// The results [first, last) of a row whose window has the size R by K, for the channels of one
/// vector. `kChecks`: the window may leave the row.
template <typename V, int R, int K, bool kChecks, typename Storage, typename Sum>
TT3D_HD void convolve_lanes(const DepthwiseRow<Storage, Sum>& row, int64_t first, int64_t last,
                            int64_t c) {
  using Vector = typename V::Type;
  Vector weight[R][K];
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r) {
#pragma GCC unroll 8
    for (int k = 0; k < K; ++k) {
      weight[r][k] = lanes_at<Vector>(row.weight + (r * K + k) * row.channels + c);
    }
  }
  Vector bias = {};
  if (row.bias != nullptr) bias = lanes_at<Vector>(row.bias + c);
  for (int64_t j = first; j < last; ++j) {
    Vector sum = bias;
    const int64_t x = row.start + j * row.step;
#pragma GCC unroll 8
    for (int k = 0; k < K; ++k) {
      if constexpr (kChecks) {
        if (x + k < 0 || x + k >= row.in_width) continue;
      }
#pragma GCC unroll 8
      for (int r = 0; r < R; ++r) {
        Vector in;
        V::load(row.in[r] + (x + k) * row.channels + c, in);
        sum += in * weight[r][k];
      }
    }
    finish<V>(row, sum, j, c);
  }
}

template <int kVectorBytes, int R, int K, typename Storage, typename Sum>
TT3D_HD void convolve_window(const DepthwiseRow<Storage, Sum>& row) {
  using V = Vectors<kVectorBytes, Storage, Sum>;
  // Results whose window lies inside the row need no checks.
  const int64_t least = (-row.start + row.step - 1) / row.step;
  const int64_t inside = least < 0 ? 0 : (least > row.count ? row.count : least);
  const int64_t space = row.in_width - K - row.start;
  int64_t outside = space < 0 ? 0 : space / row.step + 1;
  outside = outside > row.count ? row.count : (outside < inside ? inside : outside);
  for (int64_t c = 0; c < row.channels; c += V::kLanes) {
    convolve_lanes<V, R, K, true>(row, 0, inside, c);
    convolve_lanes<V, R, K, false>(row, inside, outside, c);
    convolve_lanes<V, R, K, true>(row, outside, row.count, c);
  }
}

/// The windows of kernels of 3 and 5: the whole, and with stride 2 its parts of 1, 2 and 3.
template <int kVectorBytes, typename Storage, typename Sum>
TT3D_HD void convolve_row(const DepthwiseRow<Storage, Sum>& row) {
  switch (row.rows * 10 + row.taps) {
    case 11:
      return convolve_window<kVectorBytes, 1, 1>(row);
    case 12:
      return convolve_window<kVectorBytes, 1, 2>(row);
    case 21:
      return convolve_window<kVectorBytes, 2, 1>(row);
    case 22:
      return convolve_window<kVectorBytes, 2, 2>(row);
    case 23:
      return convolve_window<kVectorBytes, 2, 3>(row);
    case 32:
      return convolve_window<kVectorBytes, 3, 2>(row);
    case 33:
      return convolve_window<kVectorBytes, 3, 3>(row);
    default:
      return convolve_window<kVectorBytes, 5, 5>(row);
  }
}

#define TT3D_ROW(attributes, bytes, Storage)                                   \
  attributes void convolve(const DepthwiseRow<Storage, SumOf<Storage>>& row) { \
    convolve_row<bytes>(row);                                                  \
  }
TT3D_FOR_EACH_CPU(TT3D_ROW, float)
TT3D_ROW(, 16, double)  // for tests
TT3D_FOR_EACH_CPU(TT3D_ROW, at::BFloat16)
#undef TT3D_ROW

/// The taps of a kernel that meet residue `q` of a stride: q, q + stride, ...
int64_t taps_of(const DepthwiseShape& shape, int64_t q) {
  return (shape.kernel - q + shape.stride - 1) / shape.stride;
}

/// [k,k,C], contiguous.
at::Tensor taps_first(const at::Tensor& weight, at::ScalarType type) {
  return weight.to(type).squeeze(1).permute({1, 2, 0}).contiguous();
}

/// The windows of the gradient, one after the other: for each pair of residues (qy, qx) the taps
/// (qy + stride * m, qx + stride * n), in falling order.
at::Tensor windows_of_gradient(const DepthwiseShape& shape, const at::Tensor& taps) {
  std::vector<at::Tensor> windows;
  for (int64_t qy = 0; qy < shape.stride; ++qy) {
    for (int64_t qx = 0; qx < shape.stride; ++qx) {
      const at::Tensor window =
          taps.slice(0, qy, at::nullopt, shape.stride).slice(1, qx, at::nullopt, shape.stride);
      windows.push_back(window.flip({0, 1}).reshape({-1, shape.channels}));
    }
  }
  return at::cat(windows).contiguous();
}

at::Tensor new_result(const at::Tensor& like, int64_t channels, int64_t height, int64_t width) {
  return at::empty({like.size(0), channels, height, width}, like.options(),
                   at::MemoryFormat::ChannelsLast);
}

}  // namespace

at::Tensor slope_bits(const at::Tensor& result, const Clamp& clamp) {
  at::Tensor bits = new_bits(result.numel());
  with_storage(result.scalar_type(), [&](auto* none) {
    using Storage = std::remove_pointer_t<decltype(none)>;
    using Integer = typename AsInteger<Storage>::Type;
    auto* values =
        const_cast<Integer*>(reinterpret_cast<const Integer*>(result.const_data_ptr<Storage>()));
    const Integer high = limit_of<Storage>(clamp);
    for_each_mask_chunk(
        values, result.numel(), words(bits),
        [&](const Integer* from, int64_t blocks, uint16_t* to) { set(from, blocks, high, to); });
  });
  return bits;
}

void apply_bits(const at::Tensor& gradient, const at::Tensor& bits) {
  with_storage(gradient.scalar_type(), [&](auto* none) {
    using Storage = std::remove_pointer_t<decltype(none)>;
    using Integer = typename AsInteger<Storage>::Type;
    auto* values = reinterpret_cast<Integer*>(gradient.mutable_data_ptr<Storage>());
    for_each_mask_chunk(
        values, gradient.numel(), words(bits),
        [&](Integer* to, int64_t blocks, const uint16_t* from) { clear(to, blocks, from); });
  });
}

bool has_depthwise_kernel(const DepthwiseShape& shape) {
  const bool kernel = shape.kernel == 3 || shape.kernel == 5;
  return kernel && (shape.stride == 1 || shape.stride == 2) && shape.padding >= 0 &&
         shape.padding < shape.kernel && shape.padding_after >= 0 && shape.channels % kBlock == 0;
}

Depthwise::Depthwise(const DepthwiseShape& shape, const at::Tensor& weight, const at::Tensor& bias,
                     at::ScalarType type)
    : shape_(shape),
      forward_weight_(taps_first(weight, type)),
      backward_weight_(windows_of_gradient(shape, forward_weight_)) {
  if (bias.defined()) bias_ = bias.to(type, false, /*copy=*/true);
}

bool Depthwise::holds(const at::Tensor& weight, const at::Tensor& bias) const {
  const at::Tensor taps = taps_first(weight, forward_weight_.scalar_type());
  return taps.equal(forward_weight_) && windows_of_gradient(shape_, taps).equal(backward_weight_) &&
         (!bias_.defined() || bias_.equal(bias.to(bias_.scalar_type())));
}

at::Tensor Depthwise::forward(const at::Tensor& x, const Clamp& clamp, at::Tensor* bits) const {
  const int64_t in_height = x.size(2), in_width = x.size(3), channels = shape_.channels;
  const auto size = [&](int64_t in) {
    return (in + shape_.padding + shape_.padding_after - shape_.kernel) / shape_.stride + 1;
  };
  const int64_t height = size(in_height), width = size(in_width);
  at::Tensor y = new_result(x, channels, height, width);
  if (bits != nullptr) *bits = new_bits(y.numel());
  const at::Tensor zeros = at::zeros({in_width * channels}, x.options());
  with_storage(x.scalar_type(), [&](auto* none) {
    using Storage = std::remove_pointer_t<decltype(none)>;
    using Sum = SumOf<Storage>;
    using Integer = typename AsInteger<Storage>::Type;
    const Storage* in = x.const_data_ptr<Storage>();
    Storage* out = y.mutable_data_ptr<Storage>();
    for_each_task(x.size(0) * height, [&](int64_t task) {
      const int64_t n = task / height, first = task % height * shape_.stride - shape_.padding;
      DepthwiseRow<Storage, Sum> row;
      row.rows = row.taps = static_cast<int>(shape_.kernel);
      for (int r = 0; r < row.rows; ++r) {
        const int64_t y0 = first + r;
        row.in[r] = y0 < 0 || y0 >= in_height ? zeros.const_data_ptr<Storage>()
                                              : in + (n * in_height + y0) * in_width * channels;
      }
      row.weight = forward_weight_.const_data_ptr<Sum>();
      row.bias = bias_.defined() ? bias_.const_data_ptr<Sum>() : nullptr;
      row.channels = channels;
      row.in_width = in_width;
      row.start = -shape_.padding;
      row.step = shape_.stride;
      row.out = out + task * width * channels;
      row.count = width;
      row.clamps = clamp.active;
      row.high = static_cast<Sum>(clamp.high);
      convolve(row);
      if (bits == nullptr) return;
      const int64_t blocks = width * channels / kBlock;
      set(reinterpret_cast<const Integer*>(row.out), blocks, limit_of<Storage>(clamp),
          words(*bits) + task * blocks);
    });
  });
  return y;
}

at::Tensor Depthwise::backward(const at::Tensor& gradient, int64_t height, int64_t width,
                               const at::Tensor& input_bits) const {
  const int64_t out_height = gradient.size(2), out_width = gradient.size(3);
  const int64_t channels = shape_.channels, stride = shape_.stride;
  at::Tensor result = new_result(gradient, channels, height, width);
  const at::Tensor zeros = at::zeros({out_width * channels}, gradient.options());
  with_storage(gradient.scalar_type(), [&](auto* none) {
    using Storage = std::remove_pointer_t<decltype(none)>;
    using Sum = SumOf<Storage>;
    const Storage* in = gradient.const_data_ptr<Storage>();
    Storage* out = result.mutable_data_ptr<Storage>();
    for_each_task(gradient.size(0) * height, [&](int64_t task) {
      const int64_t n = task / height, y = task % height;
      const int64_t qy = (y + shape_.padding) % stride, last = (y + shape_.padding) / stride;
      DepthwiseRow<Storage, Sum> row;
      row.rows = static_cast<int>(taps_of(shape_, qy));
      for (int r = 0; r < row.rows; ++r) {
        const int64_t from = last - (row.rows - 1) + r;
        row.in[r] = from < 0 || from >= out_height
                        ? zeros.const_data_ptr<Storage>()
                        : in + (n * out_height + from) * out_width * channels;
      }
      row.weight = backward_weight_.const_data_ptr<Sum>();
      for (int64_t q = 0; q < qy; ++q) {
        row.weight += taps_of(shape_, q) * shape_.kernel * channels;
      }
      row.channels = channels;
      row.in_width = out_width;
      row.out_step = stride;
      for (int64_t qx = 0; qx < stride; ++qx) {
        row.taps = static_cast<int>(taps_of(shape_, qx));
        const int64_t x = (qx - shape_.padding % stride + stride) % stride;  // first of its residue
        row.start = (x + shape_.padding) / stride - (row.taps - 1);
        row.count = x < width ? (width - x + stride - 1) / stride : 0;
        const int64_t place = (task * width + x) * channels;
        row.out = out + place;
        row.bits = input_bits.defined() ? words(input_bits) + place / kBlock : nullptr;
        convolve(row);
        row.weight += row.rows * row.taps * channels;
      }
    });
  });
  return result;
}

}  // namespace tt3d::model
