#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

/// Pictures: codecs, resampling, sRGB, compositing, and measures of similarity. Pictures are sRGB.
/// A picture with premultiplied colour and linear alpha is composited over a background once
/// (over_background); straight alpha occurs only in files.
namespace tt3d::image {

// ---- Files --------------------------------------------------------------------------------

/// Reads a PNG, JPEG or WebP; the content decides, not the name. 8 or 16 bit, grey, palette or RGB,
/// with or without alpha; EXIF is ignored. Returns [H,W,4] uint8, sRGB, straight alpha, row 0 at
/// the top; alpha is 255 if the file has none. Throws InputError (missing, empty, truncated,
/// corrupt, too large).
[[nodiscard]] at::Tensor read_image(const std::filesystem::path& path);

/// True if the image file has an alpha channel or transparency.
[[nodiscard]] bool image_has_alpha(const std::filesystem::path& path);

/// Encodes [H,W,C] uint8 with C = 1, 3 or 4 as PNG; returns the file's bytes.
[[nodiscard]] std::string encode_png(const at::Tensor& image);
/// Encodes [H,W,3] uint8 as JPEG of the given quality (1..100); returns the file's bytes.
[[nodiscard]] std::string encode_jpeg(const at::Tensor& image, int quality = 90);
/// Decodes PNG, JPEG or WebP bytes, with the result of read_image; `name` is the file name in
/// errors.
[[nodiscard]] at::Tensor decode_image(std::string_view bytes, const std::filesystem::path& name);

/// Converts float [H,W,C], clamped to [0,1], to uint8, rounded to nearest.
[[nodiscard]] at::Tensor to_uint8(const at::Tensor& image);

// ---- sRGB (IEC 61966-2-1) -----------------------------------------------------------------

/// The transfer function and its inverse for numbers; arguments are clamped to [0,1].
[[nodiscard]] float linear_to_srgb(float value);
[[nodiscard]] float srgb_to_linear(float value);
/// The same for tensors of any shape with values in [0,1]. Differentiable, with a finite slope
/// everywhere.
[[nodiscard]] at::Tensor linear_to_srgb(const at::Tensor& linear);
[[nodiscard]] at::Tensor srgb_to_linear(const at::Tensor& srgb);

// ---- Compositing and resampling -----------------------------------------------------------

/// Converts straight alpha [H,W,4] uint8 to premultiplied float32 in [0,1].
[[nodiscard]] at::Tensor premultiplied(const at::Tensor& rgba);
/// Premultiplied [...,4] over a background colour [...,3] or scalar: rgb + (1 - alpha) *
/// background.
[[nodiscard]] at::Tensor over_background(const at::Tensor& rgba, const at::Tensor& background);

/// Reduces [H,W,4] uint8, straight alpha, to `width` x `height` pixels by area averaging; neither
/// may be larger than before. Alpha weights the colours, so that the colour of transparent pixels
/// does not bleed into the edge of the object. Fully transparent pixels become black.
[[nodiscard]] at::Tensor downscale(const at::Tensor& rgba, int width, int height);

/// Averages blocks of `factor` x `factor` pixels of premultiplied sRGB pictures [N,H,W,4] in
/// linear light, as a camera does. Returns [N,H/factor,W/factor,4], premultiplied sRGB.
[[nodiscard]] at::Tensor average_pixels(const at::Tensor& pictures, int64_t factor);

/// Gaussian blur of pictures [N,C,H,W], sigma in pixels. The kernel ends at two sigma; pixels
/// outside repeat the border. Differentiable.
[[nodiscard]] at::Tensor gaussian_blur(const at::Tensor& pictures, double sigma);

// ---- Measures -----------------------------------------------------------------------------

/// Peak signal-to-noise ratio of two pictures [H,W,C] in [0,1], in dB; 100 if they are equal.
[[nodiscard]] double psnr(const at::Tensor& a, const at::Tensor& b);
/// structural_similarity of two pictures [H,W,C] in [0,1], in float64.
[[nodiscard]] double ssim(const at::Tensor& a, const at::Tensor& b);

/// Structural similarity (Wang et al. 2004) of pictures in [0,1]: Gaussian window of sigma 1.5 over
/// 11 pixels, mean over channels and over the windows inside the picture. `stride`: distance of
/// consecutive windows, in pixels. a, b [N,C,H,W], floating, at least 11 pixels a side; returns
/// [N]. Differentiable in a.
[[nodiscard]] at::Tensor structural_similarity(const at::Tensor& a, const at::Tensor& b,
                                               int64_t stride = 1);

}  // namespace tt3d::image
