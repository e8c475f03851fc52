#include <gtest/gtest.h>

#include <cstring>

#include "support/shapes.h"
#include "support/temporary_folder.h"
#include "tt3d/asset.h"

namespace tt3d::asset {
namespace {

TEST(WritePly, CountsAndCoordinates) {
  testing::TemporaryFolder folder;
  const testing::Shape ball = testing::sphere(1);
  write_ply({ball.vertices * 2 + 1, ball.faces}, folder / "m.ply");
  const std::string bytes = read_file(folder / "m.ply");
  EXPECT_NE(bytes.find("element vertex 18"), std::string::npos);
  EXPECT_NE(bytes.find("element face 32"), std::string::npos);
  float first[3];
  std::memcpy(first, bytes.data() + bytes.find("end_header\n") + 11, sizeof first);
  EXPECT_FLOAT_EQ(first[0], 3);  // 2 * (1,0,0) + 1
  EXPECT_FLOAT_EQ(first[1], 1);
}

}  // namespace
}  // namespace tt3d::asset
