// What a classifier says of an asset from a few sides: the core of 'tt3d evaluate'.
//
//   classify_views ASSET.glb MODEL [VIEWS]
#include <ATen/ATen.h>

#include <cstdio>
#include <cstdlib>

#include "tt3d/error.h"
#include "tt3d/evaluate.h"
#include "tt3d/model.h"

namespace {

void classify(const std::filesystem::path& path, const std::string& name, int64_t count) {
  const tt3d::TexturedMesh asset = tt3d::load_asset(path);
  const auto model = tt3d::Classifier::load(name);
  const tt3d::AssetRenderer renderer(asset);
  for (const tt3d::SampledView& view : tt3d::evaluation_views(
           "dome", /*seed=*/0, count, /*size=*/256, tt3d::asset_view_frame(asset, path))) {
    // Premultiplied colour and alpha, put over white.
    const at::Tensor picture = renderer.render({view.camera}).permute({0, 3, 1, 2});
    const at::Tensor image = picture.narrow(1, 0, 3) + 1 - picture.narrow(1, 3, 1);
    const at::Tensor p = model->logits(tt3d::preprocess(image, model->card())).softmax(1)[0];
    const auto top = p.argmax().item<int64_t>();
    std::printf("azimuth %6.1f  elevation %5.1f  %5.1f %%  %s\n", view.azimuth_deg,
                view.elevation_deg, 100 * p[top].item<double>(), model->card().labels[top].c_str());
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) {
    std::fprintf(stderr, "usage: classify_views ASSET.glb MODEL [VIEWS]\n");
    return 2;
  }
  try {
    classify(argv[1], argv[2], argc == 4 ? std::atoi(argv[3]) : 6);
  } catch (const tt3d::Error& error) {
    std::fprintf(stderr, "classify_views: %s\n", error.what());
    return error.exit_code();
  }
}
