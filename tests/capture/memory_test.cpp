#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "capture/load_views.h"
#include "capture/synthetic_capture.h"
#include "support/temporary_folder.h"

namespace tt3d::capture {
namespace {

/// The photographs of a nerfstudio capture, not yet decoded.
std::vector<RawView> photographs(const std::filesystem::path& folder) {
  CaptureOptions options;
  options.path = folder;
  return read_nerfstudio(find_source(options)).train;
}

TEST(Memory, TooManyPhotographsAreOneClearError) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), testing::fixture_cameras(20));
  const std::vector<RawView> raw = photographs(folder.path());
  // 20 photographs of 120x90 pixels, 4 bytes each, four times.
  constexpr int64_t kNeeded = int64_t{20} * 120 * 90 * 4 * 4;
  Progress quiet;
  EXPECT_EQ(load_views(raw, 0, kNeeded, quiet).size(), 20U);
  EXPECT_EQ(load_views(raw, 60, kNeeded / 4, quiet).size(), 20U);
  try {
    (void)load_views(raw, 0, kNeeded / 2, quiet);
    ADD_FAILURE() << "loaded without an error";
  } catch (const ResourceError& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("20 photographs need about 0.0 GiB"), std::string::npos) << text;
    EXPECT_NE(text.find("lower capture.max_size or capture.max_train_views"), std::string::npos);
  }
}

}  // namespace
}  // namespace tt3d::capture
