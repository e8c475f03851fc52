#pragma once

#include <functional>

#include "asset_source.h"

/// The materials of an OBJ file. MTL: http://paulbourke.net/dataformats/mtl/
namespace tt3d::asset {

struct MtlMaterial {
  std::string name;
  std::filesystem::path file;
  std::array<float, 3> diffuse{1, 1, 1}, emission{0, 0, 0};
  /// Arguments of the picture statements, such as "-s 2 2 1 wood.png"; empty: none.
  std::string diffuse_map, emission_map;
};

/// All files that an OBJ's `mtllib` statements name. Pictures are decoded when a face uses their
/// material.
class MtlLibrary {
 public:
  /// `source` receives notes and the files that are read.
  MtlLibrary(std::filesystem::path obj, AssetSource& source)
      : obj_(std::move(obj)), source_(source) {}

  /// Reads the files of a statement `mtllib NAME...`. A file that does not exist becomes an error
  /// when a material is not found. Throws InputError.
  void add(std::string_view names);
  /// The material of a statement `usemtl NAME`; nullptr if there is none. The latest `mtllib`
  /// statement wins, and in it the first file.
  [[nodiscard]] const MtlMaterial* find(std::string_view name) const;
  /// The file of an `mtllib` statement that does not exist; empty if all exist.
  [[nodiscard]] const std::string& missing() const { return missing_; }
  /// Reads the picture of a material. Throws InputError.
  [[nodiscard]] SourceMaterial load(const MtlMaterial& material);

 private:
  /// The materials of one file, by the text after `newmtl` and by the name without comment and
  /// quotes.
  struct File {
    std::map<std::string, MtlMaterial, std::less<>> exact;
    std::map<std::string, const MtlMaterial*, std::less<>> plain;
  };
  [[nodiscard]] std::vector<std::string> split_files(std::string_view names) const;
  [[nodiscard]] std::filesystem::path find_picture(const MtlMaterial& material,
                                                   std::string_view name) const;
  void load_map(const MtlMaterial& material, const std::string& map, SourceMaterial& result);
  [[nodiscard]] File read_file_of_materials(const std::filesystem::path& path);

  std::filesystem::path obj_;
  AssetSource& source_;
  std::map<std::filesystem::path, File> files_;
  std::vector<const File*> order_;  ///< the file that is searched first comes first
  std::string missing_;
  Pictures pictures_;
  std::map<std::filesystem::path, at::Tensor> by_path_;
};

}  // namespace tt3d::asset
