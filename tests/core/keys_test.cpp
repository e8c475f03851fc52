#include "tt3d/keys.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "support/error_of.h"

namespace tt3d {
namespace {

using testing::error_of;
using Texts = std::vector<std::string>;
using Numbers = std::vector<double>;

enum class Filter { kNearest, kLinear, kCubic };
constexpr std::array<std::string_view, 3> enum_names(Filter) {
  return {"nearest", "linear", "cubic"};
}

struct BlurOptions {
  double sigma = 1;
  void keys(KeyList& key) { key("sigma", sigma, {0.5, 2}, "pixels", "largest sigma"); }
};

struct CameraOptions {
  BlurOptions blur;
  int64_t iso = 100;
  void keys(KeyList& key) {
    key.group("blur", blur);
    key("iso", iso, {50, 6400}, "", "sensitivity");
  }
};

/// A member of each type that a key can have.
struct AllTypes {
  bool enabled = false;
  int64_t steps = 4;
  int count = 2;
  uint64_t seed = 7;
  double rate = 1;
  std::string title = "hen";
  std::filesystem::path folder = "data";
  Texts models = {"a"};
  Numbers shares = {0.5};
  Filter filter = Filter::kLinear;
  std::vector<Filter> filters = {Filter::kNearest};
  std::string method = "dual";

  void keys(KeyList& key) {
    key("enabled", enabled, "on or off");
    key("steps", steps, {0, 10}, "", "steps in total");
    key("count", count, {-3, 3}, "", "views");
    key("seed", seed, {0, 1e15}, "", "random seed");
    key("rate", rate, {0.5, 2}, "", "learning rate");
    key("title", title, "heading");
    key("folder", folder, "input folder");
    key("models", models, "surrogates");
    key("shares", shares, {0, 1}, "shares of the steps");
    key("filter", filter, "texture filter");
    key("filters", filters, "all texture filters");
    key.one_of("method", method, {"dual", "grid"}, "preset");
  }
};

class Keys : public ::testing::Test {
 protected:
  Keys() { options.keys(list); }
  void set(const std::string& name, const KeyValue& value) { list.find(name).set(value); }
  KeyValue get(const std::string& name) { return list.find(name).get(); }
  std::string error(const std::string& name, const KeyValue& value) {
    return error_of([&] { set(name, value); });
  }

  AllTypes options;
  KeyList list;
};

TEST_F(Keys, AreListedInTheOrderOfTheirDeclaration) {
  Texts names;
  for (const Key& key : list.all()) names.push_back(key.name);
  EXPECT_EQ(names, (Texts{"enabled", "steps", "count", "seed", "rate", "title", "folder", "models",
                          "shares", "filter", "filters", "method"}));
}

TEST_F(Keys, GetReturnsTheMemberWithTheTypeOfItsKey) {
  EXPECT_EQ(get("enabled"), KeyValue(false));
  EXPECT_EQ(get("steps"), KeyValue(int64_t{4}));
  EXPECT_EQ(get("count"), KeyValue(int64_t{2}));
  EXPECT_EQ(get("seed"), KeyValue(int64_t{7}));
  EXPECT_EQ(get("rate"), KeyValue(1.0));
  EXPECT_EQ(get("title"), KeyValue(std::string("hen")));
  EXPECT_EQ(get("folder"), KeyValue(std::string("data")));
  EXPECT_EQ(get("models"), KeyValue(Texts{"a"}));
  EXPECT_EQ(get("shares"), KeyValue(Numbers{0.5}));
  EXPECT_EQ(get("filter"), KeyValue(std::string("linear")));
  EXPECT_EQ(get("filters"), KeyValue(Texts{"nearest"}));
  EXPECT_EQ(get("method"), KeyValue(std::string("dual")));
}

TEST_F(Keys, GetSeesLaterChangesOfTheMember) {
  options.steps = 9;
  options.filter = Filter::kCubic;
  EXPECT_EQ(get("steps"), KeyValue(int64_t{9}));
  EXPECT_EQ(get("filter"), KeyValue(std::string("cubic")));
}

TEST_F(Keys, SetChangesTheMember) {
  set("enabled", true);
  set("steps", int64_t{5});
  set("count", int64_t{-1});
  set("seed", int64_t{8});
  set("rate", 1.5);
  set("title", std::string("cup"));
  set("folder", std::string("other"));
  set("models", Texts{"b", "c"});
  set("shares", Numbers{0.25, 0.75});
  set("filter", std::string("cubic"));
  set("filters", Texts{"cubic", "linear"});
  set("method", std::string("grid"));
  EXPECT_TRUE(options.enabled);
  EXPECT_EQ(options.steps, 5);
  EXPECT_EQ(options.count, -1);
  EXPECT_EQ(options.seed, 8U);
  EXPECT_EQ(options.rate, 1.5);
  EXPECT_EQ(options.title, "cup");
  EXPECT_EQ(options.folder.string(), "other");
  EXPECT_EQ(options.models, (Texts{"b", "c"}));
  EXPECT_EQ(options.shares, (Numbers{0.25, 0.75}));
  EXPECT_EQ(options.filter, Filter::kCubic);
  EXPECT_EQ(options.filters, (std::vector<Filter>{Filter::kCubic, Filter::kLinear}));
  EXPECT_EQ(options.method, "grid");
}

TEST_F(Keys, ABoolAcceptsZeroAndOne) {
  set("enabled", int64_t{1});
  EXPECT_TRUE(options.enabled);
  set("enabled", int64_t{0});
  EXPECT_FALSE(options.enabled);
  EXPECT_EQ(error("enabled", int64_t{2}), "expected true or false");
  EXPECT_EQ(error("enabled", int64_t{-1}), "expected true or false");
}

TEST_F(Keys, ANumberAcceptsAnIntegerButNotTheReverse) {
  set("rate", int64_t{2});
  EXPECT_EQ(options.rate, 2.0);
  EXPECT_EQ(error("steps", 5.0), "expected an integer");
  EXPECT_EQ(options.steps, 4);
}

TEST_F(Keys, RangesIncludeTheirEnds) {
  for (const int64_t end : {0, 10}) {
    set("steps", end);
    EXPECT_EQ(options.steps, end);
  }
  for (const int end : {-3, 3}) {
    set("count", int64_t{end});
    EXPECT_EQ(options.count, end);
  }
  for (const double end : {0.5, 2.0}) {
    set("rate", end);
    EXPECT_EQ(options.rate, end);
  }
  set("seed", int64_t{1'000'000'000'000'000});
  EXPECT_EQ(options.seed, 1'000'000'000'000'000U);
  set("shares", Numbers{0, 1});
  EXPECT_EQ(options.shares, (Numbers{0, 1}));
}

TEST_F(Keys, ValuesOutsideTheRangeAreInputErrorsAndChangeNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(error("steps", int64_t{-1}), "expected 0 to 10");
  EXPECT_EQ(error("steps", int64_t{11}), "expected 0 to 10");
  EXPECT_EQ(error("count", int64_t{-4}), "expected -3 to 3");
  EXPECT_EQ(error("count", int64_t{4}), "expected -3 to 3");
  // The lowest 32 bits of this integer are 0.
  EXPECT_EQ(error("count", int64_t{1} << 32), "expected -3 to 3");
  EXPECT_EQ(error("seed", int64_t{-1}), "expected 0 to 1000000000000000");
  EXPECT_EQ(error("rate", std::nextafter(0.5, 0.0)), "expected 0.5 to 2");
  EXPECT_EQ(error("rate", std::nextafter(2.0, 3.0)), "expected 0.5 to 2");
  EXPECT_EQ(error("rate", nan), "expected 0.5 to 2");
  EXPECT_EQ(error("shares", Numbers{0.25, 1.5}), "expected a list of numbers from 0 to 1");
  EXPECT_EQ(error("shares", Numbers{nan}), "expected a list of numbers from 0 to 1");
  EXPECT_EQ(options.steps, 4);
  EXPECT_EQ(options.count, 2);
  EXPECT_EQ(options.seed, 7U);
  EXPECT_EQ(options.rate, 1.0);
  EXPECT_EQ(options.shares, Numbers{0.5});
}

TEST_F(Keys, WrongTypesAreInputErrorsThatNameTheExpectedType) {
  const KeyValue text = std::string("1");
  EXPECT_EQ(error("enabled", text), "expected true or false");
  EXPECT_EQ(error("enabled", 1.0), "expected true or false");
  for (const char* name : {"steps", "count", "seed"}) {
    EXPECT_EQ(error(name, text), "expected an integer") << name;
    EXPECT_EQ(error(name, true), "expected an integer") << name;
  }
  EXPECT_EQ(error("rate", text), "expected a number");
  EXPECT_EQ(error("rate", true), "expected a number");
  for (const char* name : {"filter", "method"}) {
    EXPECT_EQ(error(name, int64_t{1}), "expected a string") << name;
  }
  for (const char* name : {"title", "folder", "filter", "method"}) {
    EXPECT_EQ(error(name, 1.5), "expected a string") << name;
    EXPECT_EQ(error(name, Texts{"linear"}), "expected a string") << name;
  }
  EXPECT_EQ(error("models", text), "expected a list of strings");
  EXPECT_EQ(error("models", Numbers{1}), "expected a list of strings");
  EXPECT_EQ(error("shares", 0.5), "expected a list of numbers from 0 to 1");
  EXPECT_EQ(error("shares", Texts{"0.5"}), "expected a list of numbers from 0 to 1");
  EXPECT_EQ(error("filters", std::string("linear")), "expected a list of nearest, linear, cubic");
  EXPECT_EQ(error("filters", Numbers{1}), "expected a list of nearest, linear, cubic");
}

TEST_F(Keys, UnknownNamesAreInputErrorsThatNameTheNearest) {
  const std::string all = "expected one of nearest, linear, cubic";
  EXPECT_EQ(error("filter", std::string("linar")), all + "; did you mean 'linear'?");
  EXPECT_EQ(error("filter", std::string("zzzzzzzz")), all);
  EXPECT_EQ(error("filter", std::string("Linear")), all + "; did you mean 'linear'?");
  EXPECT_EQ(error("filters", Texts{"linear", "cubik"}), all + "; did you mean 'cubic'?");
  EXPECT_EQ(error("method", std::string("dul")),
            "expected one of dual, grid; did you mean 'dual'?");
  EXPECT_EQ(options.filter, Filter::kLinear);
  EXPECT_EQ(options.filters, std::vector<Filter>{Filter::kNearest});
  EXPECT_EQ(options.method, "dual");
}

TEST_F(Keys, AnEmptyListFitsEveryListOfStrings) {
  // An empty list in a file has no element type, so it may arrive as a list of numbers.
  for (const KeyValue& empty : {KeyValue(Texts{}), KeyValue(Numbers{})}) {
    options.models = {"a"};
    options.filters = {Filter::kCubic};
    set("models", empty);
    set("filters", empty);
    EXPECT_TRUE(options.models.empty());
    EXPECT_TRUE(options.filters.empty());
  }
  set("shares", Numbers{});
  EXPECT_TRUE(options.shares.empty());
}

TEST_F(Keys, DescribeWhatTheyAccept) {
  EXPECT_EQ(list.find("enabled").range, "true or false");
  EXPECT_EQ(list.find("steps").range, "0 to 10");
  EXPECT_EQ(list.find("rate").range, "0.5 to 2");
  EXPECT_EQ(list.find("title").range, "");
  EXPECT_EQ(list.find("models").range, "list of strings");
  EXPECT_EQ(list.find("shares").range, "list of numbers from 0 to 1");
  EXPECT_EQ(list.find("filter").range, "nearest, linear, cubic");
  EXPECT_EQ(list.find("filters").range, "list of nearest, linear, cubic");
  EXPECT_EQ(list.find("method").range, "dual, grid");
  EXPECT_EQ(list.find("rate").meaning, "learning rate");
  for (const Key& key : list.all()) {
    EXPECT_EQ(key.path, key.name == "folder") << key.name;
    EXPECT_FALSE(key.meaning.empty()) << key.name;
  }
}

TEST_F(Keys, FindNamesTheNearestKeyOrTheCommandThatListsThem) {
  EXPECT_EQ(list.find("steps").name, "steps");
  EXPECT_EQ(error_of([&] { (void)list.find("stepz"); }),
            "unknown key 'stepz'; did you mean 'steps'?");
  EXPECT_EQ(error_of([&] { (void)list.find("qqqqqqqqqq"); }),
            "unknown key 'qqqqqqqqqq'; 'tt3d config' lists the keys");
}

TEST(KeyGroups, GiveDottedNamesAndEndWithTheGroup) {
  CameraOptions camera;
  bool last = false;
  KeyList list;
  list.group("camera", camera);
  list("last", last, "outside the group");
  Texts names;
  for (const Key& key : list.all()) names.push_back(key.name);
  EXPECT_EQ(names, (Texts{"camera.blur.sigma", "camera.iso", "last"}));
  EXPECT_EQ(list.find("camera.blur.sigma").unit, "pixels");
  list.find("camera.blur.sigma").set(1.75);
  EXPECT_EQ(camera.blur.sigma, 1.75);
  EXPECT_EQ(error_of([&] { (void)list.find("camera.blur.sigme"); }),
            "unknown key 'camera.blur.sigme'; did you mean 'camera.blur.sigma'?");
}

TEST(Enums, NamesAreReadAndWritten) {
  EXPECT_EQ(name_of(Filter::kCubic), "cubic");
  EXPECT_EQ(parse_enum<Filter>("nearest"), Filter::kNearest);
  EXPECT_EQ(names_of<Filter>(), (Texts{"nearest", "linear", "cubic"}));
  EXPECT_THROW((void)parse_enum<Filter>(""), InputError);
}

}  // namespace
}  // namespace tt3d
