#include "tt3d/raster.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include <unordered_map>
#include <vector>

#include "raster_kernels.h"
#include "tt3d/device.h"

// The operators' checks, allocation, autograd and choice of the device. No other file of the room
// includes torch.
namespace tt3d::raster {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

void check_indices(const Tensor& t, const char* name) {
  TORCH_CHECK(t.dim() == 2 && t.size(1) == 3 && t.scalar_type() == at::kInt && t.is_contiguous(),
              name, " must be dense [F,3] int32");
}

void check_rast(const Tensor& rast) {
  TORCH_CHECK(rast.dim() == 4 && rast.size(3) == 4, "rast must be [N,H,W,4]");
}

raster::Sizes sizes_of(const Tensor& rast, const Tensor& faces, int64_t vertices,
                       int64_t channels) {
  return {rast.size(0), vertices, faces.size(0), rast.size(1), rast.size(2), channels};
}

/// Pointer to a gradient's data; null if the gradient is not wanted.
template <typename T>
T* pointer_or_null(const Tensor& t) {
  return t.defined() ? t.mutable_data_ptr<T>() : nullptr;
}

template <typename T>
void run_rasterize(const Cpu& on, const Tensor& clip, const Tensor& faces, const Tensor& rast,
                   const raster::Sizes& s) {
  raster::rasterize(on, clip.const_data_ptr<T>(), faces.const_data_ptr<int32_t>(),
                    rast.mutable_data_ptr<T>(), s);
}

template <typename T>
void run_rasterize(const Cuda& on, const Tensor& clip, const Tensor& faces, const Tensor& rast,
                   const raster::Sizes& s) {
  TORCH_CHECK(s.views * s.faces < (int64_t{1} << 31), "rasterize: too many triangles in all views");
  const auto filled = [&](int64_t size, int64_t value, at::ScalarType type) {
    return at::full({size}, value, clip.options().dtype(type));
  };
  const Tensor depth = filled(s.pixels(), -1, at::kLong), face = filled(s.pixels(), -1, at::kInt);
  const Tensor list = at::empty({s.views * s.faces}, faces.options());
  const Tensor listed = filled(2, 0, at::kLong);
  const raster::DepthBuffer buffer = {
      reinterpret_cast<uint64_t*>(depth.mutable_data_ptr<int64_t>()),
      reinterpret_cast<uint32_t*>(face.mutable_data_ptr<int32_t>()),
      list.mutable_data_ptr<int32_t>(), listed.mutable_data_ptr<int64_t>()};
  raster::rasterize(on, clip.const_data_ptr<T>(), faces.const_data_ptr<int32_t>(), buffer,
                    rast.mutable_data_ptr<T>(), s);
}

struct Rasterize : public Function<Rasterize> {
  static Tensor forward(AutogradContext* ctx, const Tensor& clip_in, const Tensor& faces,
                        int64_t height, int64_t width) {
    const Tensor clip = clip_in.contiguous();
    Tensor rast = at::empty({clip.size(0), height, width, 4}, clip.options());  // fully written
    const raster::Sizes s = sizes_of(rast, faces, clip.size(1), 0);
    AT_DISPATCH_FLOATING_TYPES(clip.scalar_type(), "rasterize", [&] {
      on_device_of(clip,
                   [&](const auto& on) { run_rasterize<scalar_t>(on, clip, faces, rast, s); });
    });
    ctx->save_for_backward({clip, faces, rast});
    return rast;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &clip = saved[0], &faces = saved[1], &rast = saved[2];
    const Tensor grad = grads[0].contiguous();
    Tensor grad_clip = at::zeros_like(clip);
    const raster::Sizes s = sizes_of(rast, faces, clip.size(1), 0);
    AT_DISPATCH_FLOATING_TYPES(clip.scalar_type(), "rasterize_backward", [&] {
      const raster::RasterizeBackwardPixel<scalar_t> body = {
          clip.const_data_ptr<scalar_t>(),        faces.const_data_ptr<int32_t>(),
          rast.const_data_ptr<scalar_t>(),        grad.const_data_ptr<scalar_t>(),
          grad_clip.mutable_data_ptr<scalar_t>(), s};
      on_device_of(clip, [&](const auto& on) { raster::scatter(on, body); });
    });
    return {grad_clip, Tensor(), Tensor(), Tensor()};
  }
};

struct Interpolate : public Function<Interpolate> {
  static Tensor forward(AutogradContext* ctx, const Tensor& attributes_in, const Tensor& rast_in,
                        const Tensor& faces) {
    const Tensor attributes = attributes_in.contiguous();
    const Tensor rast = rast_in.contiguous();
    const int64_t channels = attributes.size(1);
    Tensor out =
        at::empty({rast.size(0), rast.size(1), rast.size(2), channels}, attributes.options());
    const raster::Sizes s = sizes_of(rast, faces, attributes.size(0), channels);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "interpolate", [&] {
      const raster::InterpolatePixel<scalar_t> body = {
          attributes.const_data_ptr<scalar_t>(), rast.const_data_ptr<scalar_t>(),
          faces.const_data_ptr<int32_t>(), out.mutable_data_ptr<scalar_t>(), s};
      on_device_of(out, [&](const auto& on) { raster::for_each_pixel(on, body); });
    });
    ctx->save_for_backward({attributes, rast, faces});
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &attributes = saved[0], &rast = saved[1], &faces = saved[2];
    const Tensor grad = grads[0].contiguous();
    Tensor grad_attributes, grad_rast;
    if (ctx->needs_input_grad(0)) grad_attributes = at::zeros_like(attributes);
    if (ctx->needs_input_grad(1)) grad_rast = at::empty_like(rast);
    const raster::Sizes s = sizes_of(rast, faces, attributes.size(0), attributes.size(1));
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "interpolate_backward", [&] {
      const raster::InterpolateBackwardPixel<scalar_t> body = {
          attributes.const_data_ptr<scalar_t>(),
          rast.const_data_ptr<scalar_t>(),
          faces.const_data_ptr<int32_t>(),
          grad.const_data_ptr<scalar_t>(),
          pointer_or_null<scalar_t>(grad_attributes),
          pointer_or_null<scalar_t>(grad_rast),
          s};
      on_device_of(grad, [&](const auto& on) { raster::scatter(on, body); });
    });
    return {grad_attributes, grad_rast, Tensor()};
  }
};

struct PaintPixels : public Function<PaintPixels> {
  static Tensor forward(AutogradContext* ctx, const Tensor& colors_in, const Tensor& pixels,
                        int64_t size) {
    const Tensor colors = colors_in.contiguous();
    const int64_t channels = colors.size(0), count = colors.size(1);
    Tensor picture = at::zeros({size, channels + 1}, colors.options());
    AT_DISPATCH_FLOATING_TYPES(colors.scalar_type(), "paint_pixels", [&] {
      const raster::PaintPixel<scalar_t> body = {
          colors.const_data_ptr<scalar_t>(), pixels.const_data_ptr<int64_t>(),
          picture.mutable_data_ptr<scalar_t>(), channels, count};
      for_each_index_on(colors, count, body);
    });
    ctx->save_for_backward({pixels});
    return picture;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const Tensor pixels = ctx->get_saved_variables()[0], grad = grads[0].contiguous();
    const int64_t channels = grad.size(1) - 1, count = pixels.size(0);
    Tensor grad_colors = at::empty({channels, count}, grad.options());
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "paint_pixels_backward", [&] {
      const raster::PaintBackwardPixel<scalar_t> body = {
          grad.const_data_ptr<scalar_t>(), pixels.const_data_ptr<int64_t>(),
          grad_colors.mutable_data_ptr<scalar_t>(), channels, count};
      for_each_index_on(grad, count, body);
    });
    return {grad_colors, Tensor(), Tensor()};
  }
};

template <typename T>
raster::AntialiasScene<T> scene_of(const Tensor& rast, const Tensor& clip, const Tensor& faces,
                                   const Tensor& silhouette) {
  return {rast.const_data_ptr<T>(), clip.const_data_ptr<T>(), faces.const_data_ptr<int32_t>(),
          silhouette.const_data_ptr<uint8_t>()};
}

/// The silhouette edges of each face in each view: [N,F] uint8, bit k for edge k.
Tensor silhouette_edges(const Tensor& clip, const Tensor& faces, const Tensor& twins,
                        const raster::Sizes& s) {
  Tensor facing = at::empty({s.views, s.faces}, faces.options().dtype(at::kByte));
  Tensor edges = at::empty_like(facing);
  AT_DISPATCH_FLOATING_TYPES(clip.scalar_type(), "antialias_facing", [&] {
    const raster::FacingFace<scalar_t> body = {clip.const_data_ptr<scalar_t>(),
                                               faces.const_data_ptr<int32_t>(),
                                               facing.mutable_data_ptr<uint8_t>(), s};
    on_device_of(clip, [&](const auto& on) { raster::for_each_face(on, body); });
  });
  const raster::SilhouetteEdges body = {
      faces.const_data_ptr<int32_t>(), twins.const_data_ptr<int32_t>(),
      facing.const_data_ptr<uint8_t>(), edges.mutable_data_ptr<uint8_t>(), s};
  for_each_index_on(clip, s.views * s.faces, body);
  return edges;
}

struct Antialias : public Function<Antialias> {
  static Tensor forward(AutogradContext* ctx, const Tensor& color_in, const Tensor& rast,
                        const Tensor& clip_in, const Tensor& faces, const Tensor& twins) {
    const Tensor color = color_in.contiguous();
    const Tensor clip = clip_in.contiguous();
    Tensor out = color.clone();
    const raster::Sizes s = sizes_of(rast, faces, clip.size(1), color.size(3));
    const Tensor silhouette = silhouette_edges(clip, faces, twins, s);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "antialias", [&] {
      const raster::AntialiasPixel<scalar_t> body = {
          scene_of<scalar_t>(rast, clip, faces, silhouette), color.const_data_ptr<scalar_t>(),
          out.mutable_data_ptr<scalar_t>(), s};
      on_device_of(out, [&](const auto& on) { raster::scatter(on, body); });
    });
    ctx->save_for_backward({color, rast, clip, faces, silhouette});
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &color = saved[0], &rast = saved[1], &clip = saved[2], &faces = saved[3];
    const Tensor grad = grads[0].contiguous();
    Tensor grad_color = grad.clone();
    Tensor grad_clip;
    if (ctx->needs_input_grad(2)) grad_clip = at::zeros_like(clip);
    const raster::Sizes s = sizes_of(rast, faces, clip.size(1), color.size(3));
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "antialias_backward", [&] {
      const raster::AntialiasBackwardPixel<scalar_t> body = {
          scene_of<scalar_t>(rast, clip, faces, saved[4]),
          color.const_data_ptr<scalar_t>(),
          grad.const_data_ptr<scalar_t>(),
          grad_color.mutable_data_ptr<scalar_t>(),
          pointer_or_null<scalar_t>(grad_clip),
          s};
      on_device_of(grad, [&](const auto& on) { raster::scatter(on, body); });
    });
    return {grad_color, Tensor(), grad_clip, Tensor(), Tensor()};
  }
};

template <typename T>
raster::MipLevel<T> level_of(const Tensor& texels, const Tensor& grad) {
  return {texels.const_data_ptr<T>(), pointer_or_null<T>(grad), texels.size(0), texels.size(1)};
}

/// The mipmap chain: 2x2 box-filtered levels, down to a side that is one texel or odd.
std::vector<Tensor> mipmaps(const Tensor& texture, bool with_levels) {
  std::vector<Tensor> chain = {texture};
  while (with_levels && chain.back().size(0) % 2 == 0 && chain.back().size(1) % 2 == 0) {
    const Tensor fine = chain.back();
    const int64_t height = fine.size(0) / 2, width = fine.size(1) / 2, channels = fine.size(2);
    const Tensor coarse = at::empty({height, width, channels}, fine.options());
    AT_DISPATCH_FLOATING_TYPES(fine.scalar_type(), "halve_texture", [&] {
      const raster::HalveTexel<scalar_t> body = {level_of<scalar_t>(fine, Tensor()),
                                                 coarse.mutable_data_ptr<scalar_t>(), channels};
      on_device_of(fine, [&](const auto& on) { raster::for_each_texel(on, body); });
    });
    chain.push_back(coarse);
  }
  return chain;
}

/// Spreads each level's gradient over the four finer texels that were averaged, from the coarsest
/// level to the finest.
void fold_mipmap_gradients(const std::vector<Tensor>& chain, const std::vector<Tensor>& grads) {
  for (size_t i = grads.size() - 1; i > 0; --i) {
    const Tensor& coarse = grads[i];
    AT_DISPATCH_FLOATING_TYPES(coarse.scalar_type(), "fold_texture", [&] {
      const raster::FoldTexel<scalar_t> body = {level_of<scalar_t>(chain[i - 1], grads[i - 1]),
                                                coarse.const_data_ptr<scalar_t>(), coarse.size(2)};
      on_device_of(coarse, [&](const auto& on) { raster::for_each_texel(on, body); });
    });
  }
}

template <typename T>
raster::MipChain<T> chain_of(const std::vector<Tensor>& chain, const std::vector<Tensor>& grads) {
  raster::MipChain<T> levels = {};
  levels.count = static_cast<int64_t>(chain.size());
  for (size_t i = 0; i < chain.size(); ++i) {
    levels.level[i] = level_of<T>(chain[i], i < grads.size() ? grads[i] : Tensor());
  }
  return levels;
}

template <typename T>
const T* derivatives_of(const Tensor& derivatives) {
  return derivatives.numel() > 0 ? derivatives.const_data_ptr<T>() : nullptr;
}

struct Texture : public Function<Texture> {
  static Tensor forward(AutogradContext* ctx, const Tensor& texture_in, const Tensor& uv_in,
                        const Tensor& derivatives, const Tensor& rast) {
    const Tensor uv = uv_in.contiguous();
    const std::vector<Tensor> chain = mipmaps(texture_in.contiguous(), derivatives.numel() > 0);
    Tensor out =
        at::empty({uv.size(0), uv.size(1), uv.size(2), texture_in.size(2)}, texture_in.options());
    const raster::Sizes s = {uv.size(0), 0, 0, uv.size(1), uv.size(2), texture_in.size(2)};
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "texture", [&] {
      const raster::TexturePixel<scalar_t> body = {
          chain_of<scalar_t>(chain, {}),         uv.const_data_ptr<scalar_t>(),
          derivatives_of<scalar_t>(derivatives), rast.const_data_ptr<scalar_t>(),
          out.mutable_data_ptr<scalar_t>(),      s};
      on_device_of(out, [&](const auto& on) { raster::for_each_pixel(on, body); });
    });
    variable_list saved = {uv, rast, derivatives};
    saved.insert(saved.end(), chain.begin(), chain.end());
    ctx->save_for_backward(saved);
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grad_list) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &uv = saved[0], &rast = saved[1], &derivatives = saved[2];
    const std::vector<Tensor> chain(saved.begin() + 3, saved.end());
    const Tensor grad = grad_list[0].contiguous();
    Tensor grad_uv;
    if (ctx->needs_input_grad(1)) grad_uv = at::zeros_like(uv);
    std::vector<Tensor> grads;
    if (ctx->needs_input_grad(0)) {
      for (const Tensor& level : chain) grads.push_back(at::zeros_like(level));
    }
    const raster::Sizes s = {uv.size(0), 0, 0, uv.size(1), uv.size(2), grad.size(3)};
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "texture_backward", [&] {
      const raster::TextureBackwardPixel<scalar_t> body = {chain_of<scalar_t>(chain, grads),
                                                           uv.const_data_ptr<scalar_t>(),
                                                           derivatives_of<scalar_t>(derivatives),
                                                           rast.const_data_ptr<scalar_t>(),
                                                           grad.const_data_ptr<scalar_t>(),
                                                           pointer_or_null<scalar_t>(grad_uv),
                                                           s};
      on_device_of(grad, [&](const auto& on) { raster::scatter(on, body); });
    });
    if (!grads.empty()) fold_mipmap_gradients(chain, grads);
    return {grads.empty() ? Tensor() : grads[0], grad_uv, Tensor(), Tensor()};
  }
};

}  // namespace

Tensor rasterize(const Tensor& clip, const Tensor& faces, int64_t height, int64_t width) {
  TORCH_CHECK(clip.dim() == 3 && clip.size(2) == 4, "clip must be [N,V,4]");
  check_indices(faces, "faces");
  // The triangle's number is stored as a float, and float32 holds integers exactly up to 2^24.
  TORCH_CHECK(faces.size(0) < (1 << 24), "at most 2^24 - 1 faces");
  check_same_device("rasterize", {clip, faces});
  return Rasterize::apply(clip, faces, height, width);
}

Tensor interpolate(const Tensor& attributes, const Tensor& rast, const Tensor& faces) {
  TORCH_CHECK(attributes.dim() == 2, "attributes must be [V,C]");
  check_rast(rast);
  check_indices(faces, "faces");
  check_same_device("interpolate", {attributes, rast, faces});
  return Interpolate::apply(attributes, rast, faces);
}

SurfacePoints surface_points(const Tensor& vertices, const Tensor& rast, const Tensor& faces,
                             const Tensor& pixels) {
  const Tensor positions = interpolate(vertices, rast, faces).view({-1, 3});
  return {positions.index_select(0, pixels), rast.reshape({-1, 4}).index_select(0, pixels)};
}

Tensor paint_pixels(const Tensor& colors, const Tensor& pixels, int64_t size) {
  TORCH_CHECK(colors.dim() == 2 && colors.size(0) >= raster::kAlpha,
              "colors must be [C,P] with C at least 3");
  TORCH_CHECK(pixels.dim() == 1 && pixels.scalar_type() == at::kLong && pixels.is_contiguous() &&
                  pixels.size(0) == colors.size(1),
              "pixels must be dense [P] int64");
  check_same_device("paint_pixels", {colors, pixels});
  return PaintPixels::apply(colors, pixels, size);
}

Tensor attribute_derivatives(const Tensor& attributes_in, const Tensor& rast_in,
                             const Tensor& clip_in, const Tensor& faces) {
  check_rast(rast_in);
  check_indices(faces, "faces");
  check_same_device("attribute_derivatives", {attributes_in, rast_in, clip_in, faces});
  const Tensor attributes = attributes_in.detach().contiguous();
  const Tensor rast = rast_in.detach().contiguous(), clip = clip_in.detach().contiguous();
  const int64_t channels = attributes.size(1);
  Tensor out =
      at::empty({rast.size(0), rast.size(1), rast.size(2), 2 * channels}, attributes.options());
  const raster::Sizes s = sizes_of(rast, faces, attributes.size(0), channels);
  AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "attribute_derivatives", [&] {
    const raster::AttributeDerivativesPixel<scalar_t> body = {
        attributes.const_data_ptr<scalar_t>(), rast.const_data_ptr<scalar_t>(),
        clip.const_data_ptr<scalar_t>(),       faces.const_data_ptr<int32_t>(),
        out.mutable_data_ptr<scalar_t>(),      s};
    on_device_of(out, [&](const auto& on) { raster::for_each_pixel(on, body); });
  });
  return out;
}

Tensor edge_twins(const Tensor& faces_in) {
  check_indices(faces_in, "faces");
  const Tensor faces = faces_in.cpu();  // once per mesh, not once per step
  struct Sides {
    int32_t count = 0;
    int32_t sum = 0;  // of the first two sides; sum minus one side is the other
  };
  const int64_t count = faces.size(0);
  const int32_t* f = faces.const_data_ptr<int32_t>();
  const auto key_of = [&](int64_t side) {
    const int64_t face = side / 3, k = side % 3;
    const auto a = static_cast<uint64_t>(f[3 * face + (k + 1) % 3]);
    const auto b = static_cast<uint64_t>(f[3 * face + (k + 2) % 3]);
    return (std::min(a, b) << 32) | std::max(a, b);
  };
  std::unordered_map<uint64_t, Sides> edges;
  edges.reserve(static_cast<size_t>(count) * 3 / 2);
  for (int64_t side = 0; side < 3 * count; ++side) {
    Sides& sides = edges[key_of(side)];
    if (++sides.count <= 2) sides.sum += static_cast<int32_t>(side);
  }
  Tensor twins = at::empty({count, 3}, faces.options());
  auto* out = twins.mutable_data_ptr<int32_t>();
  for (int64_t side = 0; side < 3 * count; ++side) {
    const Sides& sides = edges.at(key_of(side));
    out[side] = sides.count == 2 ? sides.sum - static_cast<int32_t>(side) : -1;
  }
  return twins.to(faces_in.device());
}

Tensor antialias(const Tensor& color, const Tensor& rast, const Tensor& clip, const Tensor& faces,
                 const Tensor& twins) {
  TORCH_CHECK(color.dim() == 4, "color must be [N,H,W,C]");
  check_rast(rast);
  check_indices(faces, "faces");
  check_indices(twins, "twins");
  check_same_device("antialias", {color, rast, clip, faces, twins});
  return Antialias::apply(color, rast.detach().contiguous(), clip, faces, twins);
}

Tensor texture(const Tensor& texture, const Tensor& uv, const Tensor& uv_derivatives,
               const Tensor& rast) {
  TORCH_CHECK(texture.dim() == 3, "texture must be [H,W,C]");
  TORCH_CHECK(uv.dim() == 4 && uv.size(3) == 2, "uv must be [N,h,w,2]");
  check_rast(rast);
  check_same_device("texture", {texture, uv, uv_derivatives, rast});
  TORCH_CHECK(texture.size(0) <= (1 << 23) && texture.size(1) <= (1 << 23),
              "texture sides must be at most 2^23");
  // Autograd needs defined tensors: an empty one means "no mipmaps".
  const Tensor derivatives =
      uv_derivatives.defined() ? uv_derivatives.contiguous() : at::empty({0}, uv.options());
  return Texture::apply(texture, uv, derivatives, rast.detach().contiguous());
}

}  // namespace tt3d::raster
