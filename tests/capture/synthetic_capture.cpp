#include "capture/synthetic_capture.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

namespace tt3d::testing {
namespace fs = std::filesystem;
using nlohmann::json;

namespace {

double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3 minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec3 unit(const Vec3& a) {
  const double n = std::sqrt(dot(a, a));
  return {a[0] / n, a[1] / n, a[2] / n};
}

std::string image_name(size_t i) {
  return "view_" + std::to_string(i / 10) + std::to_string(i % 10);
}

/// Camera to world with the axes x right, y up, z backwards.
json opengl_matrix(const FixtureCamera& c) {
  json rows = json::array();
  for (int r = 0; r < 3; ++r) rows.push_back({c.right[r], c.up[r], -c.forward[r], c.position[r]});
  rows.push_back({0, 0, 0, 1});
  return rows;
}

void write_image(const fs::path& path, const FixtureCamera& camera) {
  write_file_atomic(path, image::encode_png(draw(camera)));
}

/// Quaternion w x y z of the rotation whose rows are right, down, forward.
std::array<double, 4> colmap_rotation(const FixtureCamera& c) {
  const Vec3 down = {-c.up[0], -c.up[1], -c.up[2]};
  const double trace = c.right[0] + down[1] + c.forward[2];
  const double entries[4] = {trace, c.right[0], down[1], c.forward[2]};
  const auto largest = std::max_element(entries, entries + 4) - entries;
  // Shepperd's method: each off-diagonal sum or difference is 4 times a product of two components.
  const double a = c.forward[1] - down[2], b = c.right[2] - c.forward[0], d = down[0] - c.right[1];
  const double e = down[0] + c.right[1], f = c.right[2] + c.forward[0], g = c.forward[1] + down[2];
  const double s = 2 * std::sqrt(largest == 0 ? 1 + trace : 1 + 2 * entries[largest] - trace);
  if (largest == 0) return {s / 4, a / s, b / s, d / s};
  if (largest == 1) return {a / s, s / 4, e / s, f / s};
  if (largest == 2) return {b / s, e / s, s / 4, g / s};
  return {d / s, f / s, g / s, s / 4};
}

Vec3 colmap_translation(const FixtureCamera& c) {
  return {-dot(c.right, c.position), dot(c.up, c.position), -dot(c.forward, c.position)};
}

template <typename T>
void put(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::vector<double> opencv_parameters(const FixtureCamera& c) {
  std::vector<double> p = {c.fx, c.fy, c.cx, c.cy};
  p.insert(p.end(), c.distortion.begin(), c.distortion.end());
  return p;
}

void write_colmap_images(const fs::path& folder, const std::vector<FixtureCamera>& cameras) {
  for (size_t i = 0; i < cameras.size(); ++i) {
    write_image(folder / "images" / (image_name(i) + ".png"), cameras[i]);
  }
}

json nerf_synthetic_json(const fs::path& folder, const std::string& split,
                         const std::vector<FixtureCamera>& cameras) {
  json root = {{"camera_angle_x", 2 * std::atan(0.5 * cameras[0].width / cameras[0].fx)}};
  for (size_t i = 0; i < cameras.size(); ++i) {
    write_image(folder / split / (image_name(i) + ".png"), cameras[i]);
    root["frames"].push_back({{"file_path", "./" + split + "/" + image_name(i)},
                              {"transform_matrix", opengl_matrix(cameras[i])}});
  }
  return root;
}

}  // namespace

const std::vector<Ball>& fixture_balls() {
  static const std::vector<Ball> balls = {{{1.6, -2, 3}, {220, 30, 20}},
                                          {{1, -1.3, 3}, {20, 200, 40}},
                                          {{1, -2, 3.5}, {30, 50, 230}},
                                          {{0.5, -2.4, 2.6}, {230, 210, 20}}};
  return balls;
}

std::vector<FixtureCamera> fixture_cameras(int count) {
  const Vec3 target = {1, -2, 3};
  std::vector<FixtureCamera> cameras;
  for (int i = 0; i < count; ++i) {
    const double azimuth = 2.4 * i;
    const double elevation = -0.4 + 1.5 * i / count;
    FixtureCamera camera;
    const Vec3 out = {std::cos(elevation) * std::cos(azimuth),
                      std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
    const double distance = 5 + 0.5 * (i % 3);
    for (int a = 0; a < 3; ++a) camera.position[a] = target[a] + distance * out[a];
    camera.forward = {-out[0], -out[1], -out[2]};
    camera.right = unit(cross(camera.forward, {0, 0, 1}));
    camera.up = cross(camera.right, camera.forward);
    cameras.push_back(camera);
  }
  return cameras;
}

std::array<double, 2> project(const FixtureCamera& c, const Vec3& point) {
  const Vec3 d = minus(point, c.position);
  const double depth = dot(d, c.forward);
  const double x = dot(d, c.right) / depth;
  const double y = -dot(d, c.up) / depth;
  const auto [k1, k2, p1, p2] = c.distortion;
  const double r2 = x * x + y * y;
  const double radial = 1 + k1 * r2 + k2 * r2 * r2;
  return {c.cx + c.fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)),
          c.cy + c.fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)};
}

at::Tensor draw(const FixtureCamera& camera) {
  at::Tensor image = at::empty({camera.height, camera.width, 4}, at::kByte);
  std::vector<Ball> balls = fixture_balls();
  const auto depth = [&](const Ball& ball) {
    return dot(minus(ball.position, camera.position), camera.forward);
  };
  std::sort(balls.begin(), balls.end(),
            [&](const Ball& a, const Ball& b) { return depth(a) < depth(b); });
  uint8_t* pixel = image.data_ptr<uint8_t>();
  for (int row = 0; row < camera.height; ++row) {
    for (int column = 0; column < camera.width; ++column, pixel += 4) {
      const uint8_t background[4] = {255, 0, 200, 0};
      std::copy(background, background + 4, pixel);
      for (const Ball& ball : balls) {
        const auto [u, v] = project(camera, ball.position);
        const double radius = kBallRadius * camera.fx / depth(ball);
        if (std::hypot(column + 0.5 - u, row + 0.5 - v) > radius) continue;
        std::copy(ball.colour.begin(), ball.colour.end(), pixel);
        pixel[3] = 255;
        break;
      }
    }
  }
  return image;
}

void write_nerf_synthetic(const fs::path& folder, const std::vector<FixtureCamera>& train,
                          const std::vector<FixtureCamera>& test) {
  write_file_atomic(folder / "transforms_train.json",
                    nerf_synthetic_json(folder, "train", train).dump(1));
  if (test.empty()) return;
  write_file_atomic(folder / "transforms_test.json",
                    nerf_synthetic_json(folder, "test", test).dump(1));
}

void write_nerfstudio(const fs::path& folder, const std::vector<FixtureCamera>& cameras) {
  json root = {{"camera_model", "OPENCV"}, {"fl_x", 1.0}, {"fl_y", 1.0}};
  for (size_t i = 0; i < cameras.size(); ++i) {
    const FixtureCamera& c = cameras[i];
    write_image(folder / "images" / (image_name(i) + ".png"), c);
    root["frames"].push_back({{"file_path", "images/" + image_name(i) + ".png"},
                              {"transform_matrix", opengl_matrix(c)},
                              {"w", c.width},
                              {"h", c.height},
                              {"fl_x", c.fx},
                              {"fl_y", c.fy},
                              {"cx", c.cx},
                              {"cy", c.cy},
                              {"k1", c.distortion[0]},
                              {"k2", c.distortion[1]},
                              {"p1", c.distortion[2]},
                              {"p2", c.distortion[3]}});
  }
  write_file_atomic(folder / "transforms.json", root.dump(1));
}

void write_colmap_text(const fs::path& folder, const std::vector<FixtureCamera>& cameras) {
  write_colmap_images(folder, cameras);
  std::ostringstream lenses, images, points;
  lenses.precision(17);
  images.precision(17);
  lenses << "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  images << "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n";
  for (size_t i = 0; i < cameras.size(); ++i) {
    lenses << i + 1 << " OPENCV " << cameras[i].width << ' ' << cameras[i].height;
    for (const double p : opencv_parameters(cameras[i])) lenses << ' ' << p;
    images << i + 1;
    for (const double q : colmap_rotation(cameras[i])) images << ' ' << q;
    for (const double t : colmap_translation(cameras[i])) images << ' ' << t;
    lenses << '\n';
    images << ' ' << i + 1 << ' ' << image_name(i) << ".png\n"
           << (i % 2 == 0 ? "" : "10.5 20.5 -1") << '\n';
  }
  points << "1 1.6 -2 3 220 30 20 0.1 1 0\n";
  write_file_atomic(folder / "sparse/0/cameras.txt", lenses.str());
  write_file_atomic(folder / "sparse/0/images.txt", images.str());
  write_file_atomic(folder / "sparse/0/points3D.txt", points.str());
}

void write_colmap_binary(const fs::path& folder, const std::vector<FixtureCamera>& cameras) {
  write_colmap_images(folder, cameras);
  std::string lenses, images, points;
  put<uint64_t>(lenses, cameras.size());
  put<uint64_t>(images, cameras.size());
  for (size_t i = 0; i < cameras.size(); ++i) {
    put(lenses, static_cast<int32_t>(i + 1));
    put<int32_t>(lenses, 4);
    put<uint64_t>(lenses, static_cast<uint64_t>(cameras[i].width));
    put<uint64_t>(lenses, static_cast<uint64_t>(cameras[i].height));
    for (const double p : opencv_parameters(cameras[i])) put(lenses, p);
    put(images, static_cast<int32_t>(i + 1));
    for (const double q : colmap_rotation(cameras[i])) put(images, q);
    for (const double t : colmap_translation(cameras[i])) put(images, t);
    put(images, static_cast<int32_t>(i + 1));
    images += image_name(i) + ".png";
    images += '\0';
    put<uint64_t>(images, i % 2);
    if (i % 2 == 1) {
      put(images, 10.5);
      put(images, 20.5);
      put<int64_t>(images, -1);
    }
  }
  put<uint64_t>(points, 1);
  put<uint64_t>(points, 1);
  for (const double p : {1.6, -2.0, 3.0}) put(points, p);
  points += std::string("\xDC\x1E\x14", 3);
  put(points, 0.1);
  put<uint64_t>(points, 1);
  put<int64_t>(points, 0);
  write_file_atomic(folder / "sparse/0/cameras.bin", lenses);
  write_file_atomic(folder / "sparse/0/images.bin", images);
  write_file_atomic(folder / "sparse/0/points3D.bin", points);
}

void edit_json(const fs::path& path, const std::function<void(json&)>& edit) {
  json root = json::parse(read_file(path));
  edit(root);
  write_file_atomic(path, root.dump(1));
}

capture::Capture load(const fs::path& folder, const std::string& format) {
  Progress progress;
  capture::CaptureOptions options;
  options.path = folder;
  options.format = parse_enum<capture::CaptureFormat>(format);
  options.max_size = 0;
  return capture::load_capture(options, progress);
}

}  // namespace tt3d::testing
