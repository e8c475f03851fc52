#include "tt3d/input_files.h"

#include <gtest/gtest.h>

#include <fstream>

#include "support/error_of.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/json.h"

namespace tt3d {
namespace {

using testing::error_of;

TEST(InputFiles, ExtensionsInAnyCase) {
  for (const char* name : {"a.png", "a.PNG", "b/a.Png", "a.b.pNg"}) {
    EXPECT_TRUE(has_extension(name, {".jpg", ".png"})) << name;
  }
  for (const char* name : {"png", "a.png.txt", ".png", "a.pn", "a"}) {
    EXPECT_FALSE(has_extension(name, {".jpg", ".png"})) << name;
  }
}

TEST(InputFiles, ListsAreSortedAndWithoutHiddenFilesAndFolders) {
  const testing::TemporaryFolder folder;
  for (const char* name : {"b.JPG", "a.jpg", "._a.jpg", ".DS_Store", "c.txt"}) {
    std::ofstream(folder / name) << name;
  }
  std::filesystem::create_directory(folder / "d.jpg");
  const std::vector<std::filesystem::path> files = list_files(folder.path(), {".jpg"});
  EXPECT_EQ(files, (std::vector<std::filesystem::path>{folder / "a.jpg", folder / "b.JPG"}));
  EXPECT_NE(error_of([&] { (void)list_files(folder / "none", {".jpg"}); }).find("cannot read"),
            std::string::npos);
}

TEST(InputFiles, ByteOrderMarks) {
  const testing::TemporaryFolder folder;
  std::ofstream(folder / "a.json") << "\xEF\xBB\xBF{\"a\": 1}\r\n";
  EXPECT_EQ(read_text(folder / "a.json"), "{\"a\": 1}\r\n");
  EXPECT_EQ(read_json(folder / "a.json")["a"], 1);
  std::ofstream(folder / "b.json") << "\xEF\xBB\xBF";
  EXPECT_NE(error_of([&] { (void)read_json(folder / "b.json"); }).find("empty"), std::string::npos);
  for (const char* mark : {"\xFF\xFE", "\xFE\xFF"}) {
    std::ofstream(folder / "c.json") << mark << "{}";
    EXPECT_NE(error_of([&] { (void)read_json(folder / "c.json"); }).find("is UTF-16 text"),
              std::string::npos);
  }
}

}  // namespace
}  // namespace tt3d
