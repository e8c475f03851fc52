#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "asset/patches.h"

namespace tt3d::asset {
namespace {

/// A picture without memory of its own, used between two uvs.
Patch large_patch(int64_t side, double low, double high) {
  Patch patch;
  patch.image = at::full({1, 1, 3}, 7, at::kByte).expand({side, side, 3});
  patch.faces = {0};
  patch.uvs = {{Uv{low, low}, Uv{high, low}, Uv{low, high}}};
  return patch;
}

TEST(PackPatches, UnusedPartsAreCutOffIfAllIsTooLarge) {
  std::vector<Patch> patches(40, large_patch(8000, 0.5, 0.51));
  const at::Tensor texture = pack_patches(patches, "x.glb");
  EXPECT_LT(texture.size(0), 2000);
  for (const Patch& patch : patches) {
    EXPECT_LE(patch.image.size(0), 83);
    // Texel 4000 of the picture is the second of the part.
    EXPECT_NEAR(patch.uvs[0][0][0] * static_cast<double>(patch.image.size(1)), 1, 1e-6);
    EXPECT_NEAR(patch.uvs[0][1][0] * static_cast<double>(patch.image.size(1)), 81, 1e-6);
  }
}

TEST(PackPatches, WhatFitsIsNotCut) {
  std::vector<Patch> patches(4, large_patch(50, 0.5, 0.6));
  EXPECT_EQ(pack_patches(patches, "x.glb").size(1), 2 * 58);
  EXPECT_EQ(patches[0].image.size(0), 50);
}

TEST(PackPatches, WhatDoesNotFitIsRefused) {
  std::vector<Patch> patches(40, large_patch(8000, 0, 1));
  EXPECT_THROW((void)pack_patches(patches, "x.glb"), InputError);
}

}  // namespace
}  // namespace tt3d::asset
