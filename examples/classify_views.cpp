// A classifier's answers for an asset seen from several sides: the core of 'tt3d evaluate'.
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
  const tt3d::asset::TexturedMesh asset = tt3d::asset::load_asset(path);
  const auto model = tt3d::model::Classifier::load(name);
  const tt3d::evaluate::AssetRenderer renderer(asset);
  for (const tt3d::scene::SampledView& view :
       tt3d::evaluate::evaluation_views(tt3d::scene::ViewDistribution::kDome, /*seed=*/0, count,
                                        /*size=*/256, tt3d::asset::view_frame(asset, path))) {
    // Premultiplied colour and alpha, composited over white.
    const at::Tensor picture = renderer.render({view.camera}).permute({0, 3, 1, 2});
    const at::Tensor image = picture.narrow(1, 0, 3) + 1 - picture.narrow(1, 3, 1);
    const at::Tensor p = model->logits(tt3d::model::preprocess(image, model->card())).softmax(1)[0];
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
