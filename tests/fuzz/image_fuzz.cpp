// Any bytes as a picture: decoded and turned upright, or rejected with InputError.

#include "memory_file.h"
#include "tt3d/error.h"
#include "tt3d/image.h"
#include "tt3d/pictures.h"

namespace {

void require(bool holds) {
  if (!holds) __builtin_trap();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const int orientation =
      tt3d::image::exif_orientation({reinterpret_cast<const char*>(data), size});
  require(orientation >= 1 && orientation <= 8);
  const tt3d::testing::MemoryFile file(data, size);
  try {
    const at::Tensor upright = tt3d::image::read_upright_image(file.path());
    const at::Tensor labels = tt3d::image::read_label_picture(file.path()).rgba;
    require(upright.numel() == labels.numel() && upright.is_contiguous());
  } catch (const tt3d::InputError&) {
    return 0;
  }
  return 0;
}
