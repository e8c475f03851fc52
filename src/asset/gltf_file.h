#pragma once

#include <array>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "asset_source.h"

/// Reader of glTF 2.0, binary or text: every offset, count and index is checked against the data.
namespace tt3d::asset {

/// The values of an accessor: `count` rows of `width` numbers.
struct AccessorValues {
  size_t count = 0;
  size_t width = 0;
  std::vector<double> values;
};

/// A parsed glTF file: its JSON and its buffers.
class GltfFile {
 public:
  explicit GltfFile(const std::filesystem::path& path);

  [[nodiscard]] const nlohmann::json& root() const { return root_; }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  /// The files that were read.
  [[nodiscard]] const std::set<std::filesystem::path>& files() const { return files_; }
  [[noreturn]] void fail(const std::string& what) const;

  /// Element `index` of the top-level array `name`.
  [[nodiscard]] const nlohmann::json& item(const char* name, size_t index) const;
  /// `object`.`key` as an index or count of at least 0. If absent: `fallback`, or an error if that
  /// is negative.
  [[nodiscard]] size_t whole(const nlohmann::json& object, const char* key,
                             int64_t fallback = -1) const;
  /// `object`.`key` as an array of N finite numbers, or `fallback`.
  template <size_t N>
  [[nodiscard]] std::array<double, N> numbers(const nlohmann::json& object, const char* key,
                                              const std::array<double, N>& fallback) const;

  /// `object`.`key` as an array of indices; empty if absent.
  [[nodiscard]] std::vector<size_t> indices(const nlohmann::json& object, const char* key) const;
  /// `object`.extensions.`name` as an object, or nullptr.
  [[nodiscard]] const nlohmann::json* extension(const nlohmann::json& object,
                                                const char* name) const;

  /// The bytes of a buffer view; `stride` receives its byteStride (0: packed).
  [[nodiscard]] std::string_view view(size_t index, size_t& stride) const;
  /// The numbers of an accessor whose type is one of `types` ("SCALAR", "VEC3", ...); normalised
  /// integers are returned as fractions. An accessor without a buffer view is zero, apart from its
  /// sparse values.
  [[nodiscard]] AccessorValues accessor(size_t index, const std::set<std::string>& types) const;
  /// The bytes of an image: from a buffer view, a data URI or a file next to the asset.
  [[nodiscard]] std::string image_bytes(const nlohmann::json& image) const;

 private:
  /// Elements of one component type, packed or strided in a buffer view.
  struct Layout {
    std::string where;  ///< for error messages
    size_t component_type = 0, width = 0, count = 0;
    bool normalized = false;
  };
  [[nodiscard]] std::vector<double> elements(const nlohmann::json& place,
                                             const Layout& layout) const;
  void apply_sparse(const nlohmann::json& sparse, const Layout& layout,
                    std::vector<double>& values) const;
  void check_extensions() const;
  void split_chunks(const std::string& bytes);
  void load_buffers();
  [[nodiscard]] std::string uri_bytes(const std::string& uri) const;

  std::filesystem::path path_;
  mutable std::set<std::filesystem::path> files_;
  nlohmann::json root_;
  std::string binary_;
  std::vector<std::string> buffers_;
  /// For each buffer: the extension without which it has no data; empty: it has data.
  std::vector<std::string> missing_;
};

template <size_t N>
std::array<double, N> GltfFile::numbers(const nlohmann::json& object, const char* key,
                                        const std::array<double, N>& fallback) const {
  const auto found = object.find(key);
  if (found == object.end()) return fallback;
  std::array<double, N> values{};
  if (!found->is_array() || found->size() != N) {
    fail(std::string(key) + ": expected " + std::to_string(N) + " numbers");
  }
  for (size_t i = 0; i < N; ++i) {
    if (!(*found)[i].is_number() || !std::isfinite((*found)[i].get<double>())) {
      fail(std::string(key) + ": expected finite numbers");
    }
    values[i] = (*found)[i].get<double>();
  }
  return values;
}

}  // namespace tt3d::asset
