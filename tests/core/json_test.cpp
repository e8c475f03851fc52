#include "tt3d/json.h"

#include <gtest/gtest.h>

#include <concepts>
#include <limits>

#include "support/error_of.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"

namespace tt3d {
namespace {

using nlohmann::json;
using testing::error_of;

struct Point {
  double x = 0;
  std::optional<int64_t> weight;
  std::string label = "none";
};
template <typename V, typename S>
requires std::same_as<std::remove_const_t<S>, Point>
void members(V& visit, S& p) {
  visit("x", p.x);
  visit("weight", p.weight);
  visit.optional("label", p.label);
}

struct Line {
  std::vector<Point> points;
  std::map<std::string, Point> named;
  std::optional<Point> middle;
};
template <typename V, typename S>
requires std::same_as<std::remove_const_t<S>, Line>
void members(V& visit, S& line) {
  visit("points", line.points);
  visit("named", line.named);
  visit("middle", line.middle);
}

/// The text of a JSON document as a T.
template <typename T>
T parse_as(const std::string& text) {
  const json document = parse_json(text, "f.json");
  return JsonValue(document, "f.json").as<T>();
}

/// The message of the error that reading a text as a T gives.
template <typename T>
std::string error_as(const std::string& text) {
  return error_of([&] { (void)parse_as<T>(text); });
}

TEST(Json, EveryTypeIsRead) {
  EXPECT_TRUE(parse_as<bool>("true"));
  EXPECT_EQ(parse_as<int>("-3"), -3);
  EXPECT_EQ(parse_as<int64_t>("-3"), -3);
  EXPECT_EQ(parse_as<uint64_t>("3"), 3U);
  EXPECT_EQ(parse_as<double>("2.5"), 2.5);
  EXPECT_EQ(parse_as<double>("2"), 2.0);
  EXPECT_EQ(parse_as<std::string>("\"hen\""), "hen");
  EXPECT_EQ(parse_as<std::filesystem::path>("\"a/b\"").string(), "a/b");
  EXPECT_EQ(parse_as<json>("{\"a\": [1]}").dump(), "{\"a\":[1]}");
  EXPECT_EQ(parse_as<std::vector<int>>("[1, 2]"), (std::vector<int>{1, 2}));
  EXPECT_EQ(parse_as<std::set<std::string>>("[\"b\", \"a\", \"b\"]"),
            (std::set<std::string>{"a", "b"}));
  EXPECT_EQ((parse_as<std::map<std::string, int>>("{\"a\": 1, \"b\": 2}")),
            (std::map<std::string, int>{{"a", 1}, {"b", 2}}));
  EXPECT_EQ((parse_as<std::array<double, 2>>("[1, 0.5]")), (std::array<double, 2>{1, 0.5}));
}

TEST(Json, WrongTypesAreInputErrorsThatNameTheExpectedType) {
  EXPECT_EQ(error_as<bool>("1"), "f.json: expected true or false");
  EXPECT_EQ(error_as<int64_t>("2.0"), "f.json: expected an integer");
  EXPECT_EQ(error_as<int64_t>("\"2\""), "f.json: expected an integer");
  EXPECT_EQ(error_as<int64_t>("true"), "f.json: expected an integer");
  EXPECT_EQ(error_as<double>("\"2\""), "f.json: expected a finite number");
  EXPECT_EQ(error_as<double>("null"), "f.json: expected a finite number");
  EXPECT_EQ(error_as<std::string>("2"), "f.json: expected a string");
  EXPECT_EQ(error_as<std::filesystem::path>("[]"), "f.json: expected a string");
  EXPECT_EQ(error_as<std::vector<int>>("{}"), "f.json: expected a list");
  EXPECT_EQ(error_as<std::set<int>>("1"), "f.json: expected a list");
  EXPECT_EQ((error_as<std::map<std::string, int>>("[]")), "f.json: expected an object");
  EXPECT_EQ((error_as<std::array<double, 3>>("[1, 2]")), "f.json: expected 3 elements");
  EXPECT_EQ(error_as<Point>("[]"), "f.json: expected an object");
}

TEST(Json, IntegersMustFitTheirType) {
  EXPECT_EQ(parse_as<int>("2147483647"), std::numeric_limits<int>::max());
  EXPECT_EQ(parse_as<int>("-2147483648"), std::numeric_limits<int>::min());
  EXPECT_EQ(error_as<int>("2147483648"), "f.json: expected an integer of 32 bits");
  EXPECT_EQ(error_as<int>("-2147483649"), "f.json: expected an integer of 32 bits");
  EXPECT_EQ(parse_as<int64_t>("9223372036854775807"), std::numeric_limits<int64_t>::max());
  EXPECT_EQ(parse_as<int64_t>("-9223372036854775808"), std::numeric_limits<int64_t>::min());
  EXPECT_EQ(error_as<int64_t>("9223372036854775808"), "f.json: expected an integer");
  EXPECT_EQ(parse_as<uint64_t>("18446744073709551615"), std::numeric_limits<uint64_t>::max());
  EXPECT_EQ(error_as<uint64_t>("18446744073709551616"),
            "f.json: expected an integer of at least 0");
  EXPECT_EQ(error_as<uint64_t>("-1"), "f.json: expected an integer of at least 0");
}

TEST(Json, NumbersMustBeFinite) {
  for (const double x :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    const json document = {{"x", x}};
    EXPECT_EQ(error_of([&] { (void)JsonValue(document, "f.json").as<Point>(); }),
              "f.json: x: expected a finite number");
  }
  EXPECT_EQ(error_of([] { (void)parse_json("{\n\"x\": NaN}", "f.json"); }).rfind("f.json:2: ", 0),
            0U);
  EXPECT_EQ(error_of([] { (void)parse_json("[1e999]", "f.json"); }),
            "f.json: has a number that is out of range");
}

TEST(Json, MalformedTextIsAnInputErrorWithItsLine) {
  EXPECT_EQ(error_of([] {
              (void)parse_json("{\n\"a\": 1,\n\"b\": oops}\n", "f.json");
            }).rfind("f.json:3: is not valid JSON", 0),
            0U);
  EXPECT_EQ(error_of([] { (void)parse_json("", "f.json"); }),
            "f.json: the file is empty, expected JSON");
}

TEST(Json, MissingMembersAreInputErrorsUnlessTheyAreOptional) {
  EXPECT_EQ(error_as<Point>("{\"label\": \"a\"}"), "f.json: x: is missing");
  EXPECT_EQ(error_as<Point>("{\"x\": null}"), "f.json: x: expected a finite number");
  for (const char* text : {"{\"x\": 1}", "{\"x\": 1, \"weight\": null, \"label\": null}"}) {
    const auto point = parse_as<Point>(text);
    EXPECT_EQ(point.x, 1.0) << text;
    EXPECT_FALSE(point.weight.has_value()) << text;
    EXPECT_EQ(point.label, "none") << text;
  }
  const auto point = parse_as<Point>("{\"x\": 1, \"weight\": 5, \"label\": \"a\"}");
  EXPECT_EQ(point.weight, 5);
  EXPECT_EQ(point.label, "a");
}

TEST(Json, ReadingClearsWhatTheTargetHeld) {
  const json document = json::parse(R"({"x": 1, "list": [3], "weight": null})");
  const JsonValue value(document, "f.json");
  Point point{0, 5, "old"};
  read(value, point);
  EXPECT_FALSE(point.weight.has_value());
  std::vector<int> list = {1, 2};
  read(value.at("list"), list);
  EXPECT_EQ(list, std::vector<int>{3});
}

TEST(Json, ErrorsNameThePathOfANestedMember) {
  const std::string start = R"({"points": [{"x": 1}, {"x": 2}, )";
  EXPECT_EQ(error_as<Line>(start + R"({"x": "3"}], "named": {}})"),
            "f.json: points[2].x: expected a finite number");
  EXPECT_EQ(error_as<Line>(start + R"({"label": "a"}], "named": {}})"),
            "f.json: points[2].x: is missing");
  EXPECT_EQ(error_as<Line>(start + R"(7], "named": {}})"), "f.json: points[2]: expected an object");
  EXPECT_EQ(error_as<Line>(R"({"points": [], "named": {"a": {"x": 1, "weight": 0.5}}})"),
            "f.json: named.a.weight: expected an integer");
  EXPECT_EQ(error_as<std::vector<std::vector<int>>>("[[1], [2, true]]"),
            "f.json: [1][1]: expected an integer");
}

TEST(Json, ElementsAndMembersAreFoundByIndexAndKey) {
  const json document = json::parse(R"({"a": [1, 2], "b": null})");
  const JsonValue value(document, "f.json");
  EXPECT_TRUE(value.has("a"));
  EXPECT_FALSE(value.has("b"));
  EXPECT_FALSE(value.has("c"));
  EXPECT_EQ(value.at("a").size(), 2U);
  EXPECT_EQ(value.at("a").at(size_t{1}).as<int>(), 2);
  EXPECT_EQ(value.get<int>("b", 9), 9);
  EXPECT_EQ(value.get<int>("c", 9), 9);
  EXPECT_EQ(value.get<std::vector<int>>("a", {}), (std::vector<int>{1, 2}));
  EXPECT_EQ(error_of([&] { (void)value.at("a").at(size_t{2}); }),
            "f.json: a: expected more than 2 elements");
  EXPECT_EQ(error_of([&] { (void)value.at("a").at("x"); }), "f.json: a: expected an object");
  EXPECT_EQ(error_of([&] { (void)value.at("a").has("x"); }), "f.json: a: expected an object");
  EXPECT_EQ(error_of([&] { (void)value.size(); }), "f.json: expected a list");
  EXPECT_EQ(error_of([&] { (void)value.get<bool>("a", false); }),
            "f.json: a: expected true or false");
}

TEST(Json, StructsSurviveARoundTripThroughAFile) {
  const testing::TemporaryFolder folder;
  const auto path = folder / "line.json";
  Line line;
  line.points = {{0.1, 3, "a"}, {1e-300, std::nullopt, "b, \"c\"\n"}};
  line.named["key"] = {-2.5, -1, ""};
  line.middle = Point{0.5, std::nullopt, "m"};
  write_json(path, to_json(line));
  const auto again = read_json_as<Line>(path);
  ASSERT_EQ(again.points.size(), 2U);
  EXPECT_EQ(again.points[0].x, 0.1);
  EXPECT_EQ(again.points[0].weight, 3);
  EXPECT_EQ(again.points[1].x, 1e-300);
  EXPECT_FALSE(again.points[1].weight.has_value());
  EXPECT_EQ(again.points[1].label, "b, \"c\"\n");
  EXPECT_EQ(again.named.at("key").x, -2.5);
  ASSERT_TRUE(again.middle.has_value());
  EXPECT_EQ(again.middle->label, "m");
  EXPECT_EQ(to_json(again).dump(), to_json(line).dump());
}

TEST(Json, FilesAreIndentedAndEndWithANewline) {
  const testing::TemporaryFolder folder;
  const auto path = folder / "point.json";
  write_json(path, to_json(Point{0.5, std::nullopt, "a"}));
  EXPECT_EQ(read_file(path), "{\n \"label\": \"a\",\n \"weight\": null,\n \"x\": 0.5\n}\n");
  EXPECT_EQ(error_of([&] { (void)read_json_as<std::vector<int>>(path); }),
            path.string() + ": expected a list");
}

}  // namespace
}  // namespace tt3d
