#include <algorithm>
#include <cstring>

#include "colmap.h"
#include "tt3d/core.h"
#include "tt3d/input_files.h"

// Which COLMAP model of a capture is read, and in which encoding.

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

bool has_encoding(const fs::path& model, const std::string& extension) {
  return fs::exists(model / ("cameras" + extension)) && fs::exists(model / ("images" + extension));
}

/// The number of pictures of a model; 0 if it cannot be read.
uint64_t count_images(const fs::path& model) {
  try {
    if (!has_encoding(model, ".bin")) return read_colmap_text(model).images.size();
    uint64_t count = 0;
    const std::string bytes = read_file(model / "images.bin");
    if (bytes.size() >= sizeof count) std::memcpy(&count, bytes.data(), sizeof count);
    return count;
  } catch (const InputError&) {
    return 0;
  }
}

/// Orders sparse/2 before sparse/10.
bool name_before(const fs::path& a, const fs::path& b) {
  const std::string x = a.filename().string(), y = b.filename().string();
  return x.size() != y.size() ? x.size() < y.size() : x < y;
}

/// Adds the models in the folders of `sparse`, then that in `sparse` itself.
void add_models(const fs::path& sparse, std::vector<fs::path>& models) {
  std::vector<fs::path> inside;
  std::error_code error;
  for (fs::directory_iterator at(sparse, error), end; !error && at != end; at.increment(error)) {
    if (!is_hidden(at->path()) && is_colmap_model(at->path())) inside.push_back(at->path());
  }
  std::sort(inside.begin(), inside.end(), name_before);
  models.insert(models.end(), inside.begin(), inside.end());
  if (is_colmap_model(sparse)) models.push_back(sparse);
}

/// The model with the most pictures; the first one of equals.
fs::path largest(const std::vector<fs::path>& models, const fs::path& folder,
                 std::vector<std::string>& notes) {
  if (models.size() == 1) return models[0];
  std::vector<uint64_t> counts(models.size());
  std::transform(models.begin(), models.end(), counts.begin(), count_images);
  const auto best = std::max_element(counts.begin(), counts.end()) - counts.begin();
  std::string others;
  for (size_t i = 0; i < models.size(); ++i) {
    if (i == static_cast<size_t>(best)) continue;
    others += (others.empty() ? "" : ", ") + models[i].lexically_relative(folder).string() + " (" +
              std::to_string(counts[i]) + ")";
  }
  const fs::path& chosen = models[static_cast<size_t>(best)];
  notes.push_back("read the COLMAP model " + chosen.lexically_relative(folder).string() +
                  ", which has the most pictures (" +
                  std::to_string(counts[static_cast<size_t>(best)]) + "); not read: " + others +
                  "; to read another model, give its folder as the capture");
  return chosen;
}

/// Equal up to the digits that text files keep.
bool same_number(double a, double b) { return std::abs(a - b) <= 1e-4 * (1 + std::abs(a)); }

template <typename Numbers>
bool same_numbers(const Numbers& a, const Numbers& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), same_number);
}

bool same_cameras(const ColmapModel& a, const ColmapModel& b) {
  return std::equal(a.cameras.begin(), a.cameras.end(), b.cameras.begin(), b.cameras.end(),
                    [](const auto& x, const auto& y) {
                      const ColmapCamera &c = x.second, &d = y.second;
                      return x.first == y.first && c.model == d.model && c.width == d.width &&
                             c.height == d.height && same_numbers(c.parameters, d.parameters);
                    });
}

bool same_images(const ColmapModel& a, const ColmapModel& b) {
  const auto sorted = [](std::vector<ColmapImage> images) {
    std::sort(images.begin(), images.end(),
              [](const ColmapImage& x, const ColmapImage& y) { return x.name < y.name; });
    return images;
  };
  const std::vector<ColmapImage> first = sorted(a.images), second = sorted(b.images);
  return std::equal(first.begin(), first.end(), second.begin(), second.end(),
                    [](const ColmapImage& x, const ColmapImage& y) {
                      return x.name == y.name && x.camera == y.camera &&
                             same_numbers(x.rotation, y.rotation) &&
                             same_numbers(x.translation, y.translation);
                    });
}

/// Throws InputError if two encodings of a model differ.
void check_same(const fs::path& folder, const ColmapModel& binary, const ColmapModel& text) {
  const auto differ = [&](const std::string& part, size_t a, size_t b) {
    const std::string counts =
        a == b ? "" : " (" + std::to_string(a) + " and " + std::to_string(b) + " entries)";
    throw InputError(folder / (part + ".bin"),
                     "differs from " + part + ".txt" + counts +
                         "; delete the .bin files to read the text, or the .txt files to read the "
                         "binary model");
  };
  if (!same_cameras(binary, text)) {
    differ("cameras", binary.cameras.size(), text.cameras.size());
  }
  if (!same_images(binary, text)) differ("images", binary.images.size(), text.images.size());
  const bool both = fs::exists(folder / "points3D.bin") && fs::exists(folder / "points3D.txt");
  if (both && binary.points.size() != text.points.size()) {
    differ("points3D", binary.points.size(), text.points.size());
  }
}

/// A note if a part of the model is there in the encoding that is not read.
void note_stray_files(const fs::path& folder, const std::string& unread, ColmapModel& model) {
  for (const char* part : {"cameras", "images"}) {
    const fs::path file = folder / (part + unread);
    if (fs::exists(file)) model.notes.push_back(file.string() + " is not read");
  }
}

}  // namespace

bool is_colmap_model(const fs::path& folder) {
  return fs::exists(folder / "cameras.bin") || fs::exists(folder / "cameras.txt");
}

fs::path find_colmap_model(const fs::path& folder, std::vector<std::string>& notes) {
  std::vector<fs::path> models;
  for (const char* place : {"sparse", "colmap/sparse"}) add_models(folder / place, models);
  if (is_colmap_model(folder)) models.push_back(folder);
  return models.empty() ? fs::path() : largest(models, folder, notes);
}

ColmapModel read_colmap_model(const fs::path& folder) {
  const bool binary = has_encoding(folder, ".bin"), text = has_encoding(folder, ".txt");
  if (!binary && !text) {
    throw InputError(folder, "expected cameras.bin and images.bin, or cameras.txt and images.txt");
  }
  ColmapModel model = binary ? read_colmap_binary(folder) : read_colmap_text(folder);
  if (binary && text) {
    check_same(folder, model, read_colmap_text(folder));
  } else {
    note_stray_files(folder, binary ? ".txt" : ".bin", model);
  }
  return model;
}

}  // namespace tt3d::capture
