#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "support/shapes.h"
#include "tt3d/attack.h"
#include "tt3d/device.h"
#include "tt3d/gpu_options.h"
#include "tt3d/mesh.h"
#include "tt3d/model.h"
#include "tt3d/optimize.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"
#include "tt3d/tensor_file.h"

// Run by scripts/gpu-check.
//
//   gpu_speed                 times each operator, forward and backward, on the CPU and on the GPU;
//                             prints rows of a Markdown table: operator, size, milliseconds on both
//                             (median of the repetitions), their ratio
//   gpu_speed --peers MESH    times the cases that bench/gpu_peers.py compares with other programs,
//                             on the GPU only; prints {name: milliseconds}. MESH: see kernel_bench
//   gpu_speed --profile MESH  runs each of these cases three times, untimed, for a profiler
namespace tt3d {
namespace {

using at::Tensor;

/// Prepares inputs on a device and returns the work to time.
using Case = std::function<std::function<void()>(at::Device)>;

/// Waits for the device by copying one number to the host.
void wait_for(at::Device device) {
  if (device.is_cuda()) (void)at::zeros({1}, at::TensorOptions().device(device)).item<float>();
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<int64_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double median_ms(const Case& prepare, at::Device device, int repetitions) {
  const std::function<void()> work = prepare(device);
  work();  // warm
  wait_for(device);
  std::vector<double> times;
  for (int i = 0; i < repetitions; ++i) {
    const double start = now_seconds();
    work();
    wait_for(device);
    times.push_back(1e3 * (now_seconds() - start));
  }
  return median(std::move(times));
}

void print_row(const std::string& name, const std::string& size, const Case& prepare,
               at::Device gpu) {
  const double cpu_ms = median_ms(prepare, at::kCPU, 3);
  const double gpu_ms = median_ms(prepare, gpu, 20);
  std::printf("| %s | %s | %.3f | %.3f | %.1f |\n", name.c_str(), size.c_str(), cpu_ms, gpu_ms,
              cpu_ms / gpu_ms);
  std::fflush(stdout);
}

Tensor random(at::IntArrayRef shape, double low, double high, uint64_t seed, at::Device device) {
  return testing::uniform(shape, low, high, seed).to(device, at::kFloat);
}

/// Runs the function, then its backward pass with a gradient of ones.
std::function<void()> both_ways(std::vector<Tensor> inputs,
                                std::function<Tensor(const std::vector<Tensor>&)> function) {
  return [inputs, function] {
    for (const Tensor& t : inputs) {
      t.mutable_grad().reset();
      t.requires_grad_(true);
    }
    const Tensor out = function(inputs);
    out.backward(at::ones_like(out));
  };
}

Case hash_case(int64_t points) {
  return [points](at::Device device) {
    const field::HashGridShape shape;
    return both_ways({random({shape.entries(), 2}, -1, 1, 1, device)},
                     [shape, x = random({points, 3}, -1, 1, 2, device)](const auto& in) {
                       return field::hash_encode(x, in[0], shape);
                     });
  };
}

Case mlp_case(int64_t points, bool half) {
  return [points, half](at::Device device) {
    return both_ways({random({35, points}, -1, 1, 3, device), random({64, 35}, -1, 1, 4, device),
                      random({64, 64}, -1, 1, 5, device), random({6, 64}, -1, 1, 6, device)},
                     [half](const auto& in) {
                       const std::vector<Tensor> weights = {in[1], in[2], in[3]};
                       return half ? field::half_mlp(in[0], weights) : field::mlp(in[0], weights);
                     });
  };
}

/// Rasterizes, interpolates colours, antialiases; gradients to positions and colours.
std::function<void()> drawing(const Tensor& clip, const Tensor& colors, const Tensor& faces,
                              int64_t size) {
  return both_ways({clip, colors}, [faces, twins = raster::edge_twins(faces),
                                    size](const auto& in) {
    const Tensor rast = raster::rasterize(in[0], faces, size, size);
    return raster::antialias(raster::interpolate(in[1], rast, faces), rast, in[0], faces, twins);
  });
}

/// Renders a sphere with one colour per vertex.
Case render_case(int levels, int64_t size) {
  return [levels, size](at::Device device) {
    const testing::Shape shape = testing::sphere(levels);
    const Tensor depth = 3 - shape.vertices.select(1, 2);
    const Tensor clip = at::stack({shape.vertices.select(1, 0) * 1.8,
                                   shape.vertices.select(1, 1) * 1.8, depth * 0.5, depth},
                                  1)
                            .unsqueeze(0)
                            .to(device);
    return drawing(clip, random({shape.vertices.size(0), 4}, 0, 1, 7, device),
                   shape.faces.to(device), size);
  };
}

Case texture_case(int64_t size) {
  return [size](at::Device device) {
    const Tensor rast = at::ones({1, size, size, 4}, at::TensorOptions().device(device));
    const Tensor derivatives = random({1, size, size, 4}, -1e-3, 1e-3, 8, device);
    return both_ways(
        {random({2048, 2048, 3}, 0, 1, 9, device), random({1, size, size, 2}, 0, 1, 10, device)},
        [rast, derivatives](const auto& in) {
          return raster::texture(in[0], in[1], derivatives, rast);
        });
  };
}

Case chamfer_case(int levels) {
  return [levels](at::Device device) {
    const testing::Shape shape = testing::sphere(levels);
    const auto regularizer = std::make_shared<mesh::MeshRegularizer>(
        scene::TriMesh{shape.vertices, shape.faces}.to(device));
    const Tensor moved =
        shape.vertices.to(device) + random(shape.vertices.sizes(), -0.05, 0.05, 11, device);
    return both_ways({moved},
                     [regularizer](const auto& in) { return regularizer->chamfer(in[0]); });
  };
}

Case transform_case(int64_t pictures) {
  return [pictures](at::Device device) {
    return both_ways({random({pictures, 4, 256, 256}, 0, 1, 12, device)}, [](const auto& in) {
      return attack::transform_images(in[0], 224, attack::EotOptions{}, 1, 0);
    });
  };
}

Case classifier_case(const std::shared_ptr<model::Classifier>& model, int64_t pictures) {
  return [model, pictures](at::Device device) {
    const int64_t size = model->card().height;
    return both_ways({random({pictures, 3, size, size}, 0, 1, 13, device)},
                     [model](const auto& in) { return model->logits(in[0]); });
  };
}

/// A classifier's passes with single kernel launches, and replayed as CUDA graphs.
void print_classifier_rows(const std::string& name, int64_t pictures, at::Device gpu) {
  const auto model = model::Classifier::load(name);
  const Case work = classifier_case(model, pictures);
  print_row(name, std::to_string(pictures) + " pictures", work, gpu);
  use_gpu_options({.graphs = true});
  print_row("the same, --cuda-graphs", std::to_string(pictures) + " pictures", work, gpu);
  use_gpu_options({});
}

// ---- Cases compared with other programs ----------------------------------------------------

/// Milliseconds per call when calls are launched back to back, without waiting in between: the
/// median over some rounds.
double sustained_ms(const std::function<void()>& work, at::Device gpu) {
  constexpr int kRounds = 5, kCalls = 20;
  for (int i = 0; i < kCalls; ++i) work();  // warm
  std::vector<double> times;
  for (int round = 0; round < kRounds; ++round) {
    wait_for(gpu);
    const double start = now_seconds();
    for (int i = 0; i < kCalls; ++i) work();
    wait_for(gpu);
    times.push_back(1e3 * (now_seconds() - start) / kCalls);
  }
  return median(std::move(times));
}

/// A coloured mesh from a file, the same in all views.
std::function<void()> colored_mesh(const TensorFile& file, int64_t views, int64_t size,
                                   at::Device gpu) {
  const Tensor clip = file.get("clip", {1, -1, 4}, at::kFloat).to(gpu).expand({views, -1, -1});
  return drawing(clip.contiguous(), file.get("colors", {-1, 3}, at::kFloat).to(gpu),
                 file.get("faces", {-1, 3}, at::kInt).to(gpu), size);
}

/// A training step of a hash grid followed by an MLP 35-64-64-6: encoding, squared error,
/// gradients, Adam.
std::function<void()> training_step(int64_t points, bool half, at::Device gpu) {
  const field::HashGridShape shape;
  std::vector<Tensor> parameters = {
      random({shape.entries(), 2}, -1e-4, 1e-4, 1, gpu), random({64, 35}, -0.3, 0.3, 4, gpu),
      random({64, 64}, -0.3, 0.3, 5, gpu), random({6, 64}, -0.3, 0.3, 6, gpu)};
  std::vector<Tensor> moment1, moment2;
  for (Tensor& p : parameters) {
    moment1.push_back(at::zeros_like(p));
    moment2.push_back(at::zeros_like(p));
    p.requires_grad_(true);
  }
  const Tensor x = random({points, 3}, -1, 1, 2, gpu), target = random({6, points}, 0, 1, 3, gpu);
  auto iteration = std::make_shared<int64_t>(0);
  return [=] {
    const Tensor encoded = field::encode_points(x, parameters[0], shape);
    const std::vector<Tensor> weights(parameters.begin() + 1, parameters.end());
    const Tensor out = half ? field::half_mlp(encoded, weights) : field::mlp(encoded, weights);
    const std::vector<Tensor> gradients =
        torch::autograd::grad({at::mse_loss(out, target)}, parameters);
    const at::NoGradGuard none;
    ++*iteration;
    for (size_t i = 0; i < parameters.size(); ++i) {
      optimize::Adam{}.step(parameters[i], gradients[i].contiguous(), moment1[i], moment2[i], 1e-3,
                            *iteration);
    }
  };
}

/// Prints the milliseconds of each case; for a profiler runs each three times instead.
void measure_for_peers(const std::string& mesh, bool for_profiler, at::Device gpu) {
  const TensorFile file = load_tensors(mesh);
  const std::vector<std::pair<std::string, Case>> cases = {
      {"colored_mesh 1x400", [&](auto on) { return colored_mesh(file, 1, 400, on); }},
      {"colored_mesh 8x512", [&](auto on) { return colored_mesh(file, 8, 512, on); }},
      {"colored_mesh 1x2048", [&](auto on) { return colored_mesh(file, 1, 2048, on); }},
      {"training_step", [](auto on) { return training_step(1 << 18, false, on); }},
      {"training_step half", [](auto on) { return training_step(1 << 18, true, on); }}};
  nlohmann::json times;
  for (const auto& [name, prepare] : cases) {
    const std::function<void()> work = prepare(gpu);
    if (!for_profiler) times[name] = sustained_ms(work, gpu);
    for (int i = 0; for_profiler && i < 3; ++i) work();
  }
  std::cout << times.dump() << "\n";
}

void measure(at::Device gpu) {
  std::printf(
      "| forward and backward | size | CPU ms | CUDA ms | ratio |\n|---|---|---|---|---|\n");
  print_row("hash encoding, 16 levels, F=2", "2^18 points", hash_case(1 << 18), gpu);
  print_row("MLP 35-64-64-6", "2^18 points", mlp_case(1 << 18, false), gpu);
  print_row("the same, --half-mlp (the CPU imitates it)", "2^18 points", mlp_case(1 << 18, true),
            gpu);
  print_row("rasterize + interpolate + antialias", "32,768 faces, 400x400", render_case(6, 400),
            gpu);
  print_row("rasterize + interpolate + antialias", "524,288 faces, 2048x2048", render_case(8, 2048),
            gpu);
  print_row("texture with mipmaps, 2048x2048 texels", "1024x1024", texture_case(1024), gpu);
  print_row("Chamfer, every vertex searched", "16,386 vertices", chamfer_case(6), gpu);
  print_row("transforms of the attack", "8 pictures", transform_case(8), gpu);
  print_classifier_rows("efficientnet_lite0", 6, gpu);
}

}  // namespace
}  // namespace tt3d

int main(int argc, char** argv) {
  try {
    const at::Device gpu = tt3d::device_named("cuda");
    const std::string mode = argc == 3 ? argv[1] : "";
    if (mode == "--peers" || mode == "--profile") {
      tt3d::measure_for_peers(argv[2], mode == "--profile", gpu);
    } else {
      tt3d::measure(gpu);
    }
  } catch (const std::exception& error) {
    std::cerr << "gpu_speed: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
