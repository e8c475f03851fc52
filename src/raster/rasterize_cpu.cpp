#include <algorithm>
#include <limits>
#include <vector>

#include "pixels_cpu.h"
#include "raster_kernels.h"

// Compiled with -ffp-contract=off: both triangles at an edge must see the same bits.
namespace tt3d::raster {
namespace {

/// Rows [y_begin,y_end) of a view, and the depth of what they show.
template <typename T>
struct Band {
  T* rast;  ///< of the view
  int y_begin, y_end;
  std::vector<double> depth;
};

template <typename T>
void draw_triangle(const TriangleSetup& t, int64_t face, const Sizes& s, Band<T>& band) {
  const int y_begin = std::max(t.y_begin, band.y_begin), y_end = std::min(t.y_end, band.y_end);
  for (int y = y_begin; y < y_end; ++y) {
    const double py = pixel_y(y, s.height);
    double* depth = band.depth.data() + (y - band.y_begin) * s.width;
    T* row = band.rast + 4 * y * s.width;
    for (int x = t.x_begin; x < t.x_end; ++x) {
      Hit hit;
      // Triangles come in order: at equal depth the lower index stays.
      if (!hit_triangle(t, pixel_x(x, s.width), py, hit) || hit.zw >= depth[x]) continue;
      depth[x] = hit.zw;
      T* out = row + 4 * static_cast<int64_t>(x);
      const double scale = hit.scale();
      out[0] = static_cast<T>(hit.e[0] * scale);
      out[1] = static_cast<T>(hit.e[1] * scale);
      out[2] = static_cast<T>(hit.zw);
      out[3] = static_cast<T>(face + 1);
    }
  }
}

/// All triangles of a view, in order: neighbours in a mesh are neighbours on the screen, so the
/// band stays in the cache without sorting triangles into tiles first.
template <typename T>
void draw_band(const T* clip, const int32_t* faces, const Sizes& s, Band<T> band) {
  band.depth.assign((band.y_end - band.y_begin) * s.width, std::numeric_limits<double>::infinity());
  // A vertex is shared by six triangles or so.
  std::vector<ScreenPoint> points(static_cast<size_t>(s.vertices));
  for (int64_t v = 0; v < s.vertices; ++v) {
    points[v] = screen_point(load_vertex(clip, v), s.height, s.width);
  }
  TriangleSetup setup;
  for (int64_t f = 0; f < s.faces; ++f) {
    const int32_t* face = faces + 3 * f;
    if (setup_triangle(clip, face, points[face[0]], points[face[1]], points[face[2]], s.height,
                       s.width, setup)) {
      draw_triangle(setup, f, s, band);
    }
  }
}

}  // namespace

/// A thread draws whole views, or bands of one where there are more threads than views.
template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s) {
  constexpr int64_t kLeastRows = 16;
  const int64_t share = at::get_num_threads() / std::max<int64_t>(1, s.views);
  const int64_t bands = std::clamp<int64_t>(share, 1, std::max<int64_t>(1, s.height / kLeastRows));
  at::parallel_for(0, s.views * bands, 1, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      const int64_t n = i / bands, band = i % bands;
      draw_band<T>(clip + n * s.vertices * 4, faces, s,
                   {rast + n * s.height * s.width * 4,
                    static_cast<int>(band * s.height / bands),
                    static_cast<int>((band + 1) * s.height / bands),
                    {}});
    }
  });
}

/// Neighbouring pixels mostly show the same triangle: its corners are loaded and its gradients
/// added to the vertices' once a run of them.
template <typename T>
void scatter(const Cpu&, const RasterizeBackwardPixel<T>& body) {
  const Sizes& s = body.s;
  const int64_t pixels = s.height * s.width;
  const auto add = [&](int64_t view, int64_t first, int64_t last, T* sums) {
    int64_t shown = -1;
    ClipTriangle triangle = {};
    double grad[3][4] = {};
    for (int64_t i = first; i < last; ++i) {
      const T* rast = body.rast + 4 * (view * pixels + i);
      const T* grad_rast = body.grad_rast + 4 * (view * pixels + i);
      const auto face = static_cast<int64_t>(rast[3]) - 1;
      if (face < 0 || (grad_rast[0] == 0 && grad_rast[1] == 0)) continue;
      if (face != shown) {
        if (shown >= 0) body.add(shown, grad, sums);
        std::fill_n(&grad[0][0], 12, 0.0);
        triangle = load_triangle(body.clip + view * s.vertices * 4, body.faces + 3 * face);
        shown = face;
      }
      rasterize_backward(triangle, pixel_x(i % s.width, s.width), pixel_y(i / s.width, s.height),
                         static_cast<double>(grad_rast[0]), static_cast<double>(grad_rast[1]),
                         grad);
    }
    if (shown >= 0) body.add(shown, grad, sums);
  };
  scatter_in_parts(s.views, pixels, s.vertices, 4, body.grad_clip, add);
}

template void rasterize(const Cpu&, const float*, const int32_t*, float*, const Sizes&);
template void rasterize(const Cpu&, const double*, const int32_t*, double*, const Sizes&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<float>&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<double>&);

}  // namespace tt3d::raster
