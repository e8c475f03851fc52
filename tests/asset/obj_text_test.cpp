#include "asset/obj_text.h"

#include <gtest/gtest.h>

namespace tt3d::asset {
namespace {

std::optional<double> number(std::string_view text) { return Words(text).number(); }

TEST(ObjText, Numbers) {
  EXPECT_EQ(number("1.5"), 1.5);
  EXPECT_EQ(number("+2e1"), 20);
  EXPECT_EQ(number("500000.123"), 500000.123);
  EXPECT_EQ(number("-.5"), -0.5);
  for (const char* tiny : {"1e-400", "-4.9e-999999999999", "0.0000000000001e-330", "1.0e-0400"}) {
    EXPECT_EQ(number(tiny), 0) << tiny;
  }
  const std::string tiny_without_exponent = "0." + std::string(400, '0') + "1";
  EXPECT_EQ(number(tiny_without_exponent), 0);
  const std::string huge_without_exponent = std::string(400, '9');
  EXPECT_EQ(number(huge_without_exponent), std::nullopt);
  for (const char* wrong :
       {"1e400", "0.1e+999999999999", "nan", "inf", "1,5", "1.#QNAN", "x", ""}) {
    EXPECT_EQ(number(wrong), std::nullopt) << wrong;
  }
}

TEST(ObjText, LineEndsAndContinuations) {
  const auto lines_of = [](std::string_view text) {
    std::vector<std::string> result;
    Lines lines(text);
    for (std::string line; lines.next(line);) result.push_back(line);
    return result;
  };
  const std::vector<std::string> two = {"a b", "c"};
  EXPECT_EQ(lines_of("a b\nc\n"), two);
  EXPECT_EQ(lines_of("a b\r\nc"), two);
  EXPECT_EQ(lines_of("a b\rc\r"), two);
  EXPECT_EQ(lines_of("\xEF\xBB\xBF"
                     "a b\nc"),
            two);
  EXPECT_EQ(lines_of("a\\\nb\nc"), two);
  const std::vector<std::string> comment = {"# C:\\folder\\", "v 0 0 0"};
  EXPECT_EQ(lines_of("# C:\\folder\\\nv 0 0 0"), comment);
}

TEST(ObjText, NamesAndComments) {
  EXPECT_EQ(plain_name("  \"my model.mtl\"  # by hand"), "my model.mtl");
  EXPECT_EQ(plain_name("a#b.png"), "a#b.png");
  EXPECT_EQ(plain_name("# nothing"), "");
  EXPECT_EQ(plain_name("\""), "\"");
  const std::vector<std::string> names = {"a.mtl", "b c.mtl", "d.mtl"};
  EXPECT_EQ(split_names("a.mtl \"b c.mtl\"\td.mtl "), names);
}

}  // namespace
}  // namespace tt3d::asset
