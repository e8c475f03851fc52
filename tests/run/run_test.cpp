#include "tt3d/run.h"

#include <gtest/gtest.h>

#include <set>

#include "support/temporary_folder.h"

namespace tt3d {
namespace {

/// The message of the InputError that loading this TOML gives; "" if it loads.
std::string error_of(const std::string& toml) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "c.toml", toml);
  try {
    (void)load_config(folder / "c.toml");
    return "";
  } catch (const InputError& error) {
    return error.what();
  }
}

void expect_contains(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << text;
}

TEST(Config, UnknownKeyNamesFileLineAndNearestKey) {
  expect_contains(error_of("seed = 1\n[attack]\nbetta = 3.0\n"),
                  {"c.toml:3:", "attack.betta", "attack.beta"});
}

TEST(Config, WrongTypeAndRange) {
  expect_contains(error_of("[attack]\nbeta = \"high\"\n"), {"c.toml:2:", "attack.beta", "number"});
  expect_contains(error_of("[attack]\nbeta = -1\n"), {"c.toml:2:", "attack.beta", "0 to"});
  expect_contains(error_of("[attack]\nsteps = 1.5\n"), {"attack.steps", "integer"});
  expect_contains(error_of("[attack]\nsurrogates = \"x\"\n"), {"attack.surrogates", "list"});
  expect_contains(error_of("[attack]\nmethod = \"duel\"\n"),
                  {"attack.method", "did you mean 'dual'"});
  expect_contains(error_of("[attack]\noptimize = [\"vertice\"]\n"),
                  {"attack.optimize", "did you mean 'vertices'"});
  expect_contains(error_of("[field]\noccupancy = 100\n"), {"field.occupancy", "multiple of 8"});
  expect_contains(error_of("[attack.eot]\nscale_low = 2.0\n"), {"scale_low", "scale_high"});
  expect_contains(error_of("seed = = 2\n"), {"c.toml:1:"});
}

TEST(Config, EveryKeySurvivesARoundTrip) {
  RunConfig config;
  set_config(config, "seed=7");
  set_config(config, "attack.target=teapot");
  set_config(config, "attack.surrogates=[\"a\", \"b\"]");
  set_config(config, "mesh.remesh_at=[0.25]");
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "c.toml", config_toml(config));
  const RunConfig back = load_config(folder / "c.toml");
  const auto a = config_keys(config), b = config_keys(back);
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) EXPECT_EQ(a[i].value, b[i].value) << a[i].name;
}

TEST(Config, KeysAreDocumentedAndUnique) {
  std::set<std::string> names;
  for (const ConfigKey& key : config_keys({})) {
    EXPECT_TRUE(names.insert(key.name).second) << key.name;
    EXPECT_FALSE(key.meaning.empty()) << key.name;
  }
  for (const char* contract : {"seed", "capture.path", "capture.format", "attack.method",
                               "attack.target", "attack.surrogates", "attack.beta",
                               "evaluate.true_class", "evaluate.victims", "evaluate.views"}) {
    EXPECT_TRUE(names.contains(contract)) << contract;
  }
}

TEST(Config, ShippedConfigurationsLoad) {
  for (const char* name : {"demo.toml", "paper.toml"}) {
    EXPECT_NO_THROW((void)load_config(std::string(TT3D_SOURCE_DIR) + "/configs/" + name)) << name;
  }
}

TEST(Config, RelativePathsAreRelativeToTheFile) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "sub/c.toml", "[capture]\npath = \"../photos\"\n");
  EXPECT_EQ(load_config(folder / "sub/c.toml").capture.path,
            std::filesystem::weakly_canonical(folder / "photos"));
}

TEST(Config, SetTakesTomlAndBareWords) {
  RunConfig config;
  set_config(config, "attack.target=n04398044");
  EXPECT_EQ(config.attack_target, "n04398044");
  EXPECT_THROW(set_config(config, "attack.beta"), InputError);
  EXPECT_THROW(set_config(config, "attack.beta=much"), InputError);
}

TEST(Config, APresetSetsItsKeysAndGivenOnesWin) {
  const auto steps_and_beta = [](const std::string& toml) {
    testing::TemporaryFolder folder;
    write_file_atomic(folder / "c.toml", toml);
    return load_config(folder / "c.toml").attack;
  };
  const AttackOptions plain = steps_and_beta("[attack]\nmethod = \"paper\"\n");
  EXPECT_EQ(plain.steps, 25000);
  EXPECT_EQ(plain.objective, "cross-entropy");
  EXPECT_EQ(plain.view_distribution, "paper");
  // Whatever the order; also where the given value is the program's default.
  const AttackOptions given =
      steps_and_beta("[attack]\nsteps = 450\nmethod = \"paper\"\nviews_per_step = 6\n");
  EXPECT_EQ(given.steps, RunConfig().attack.steps);
  EXPECT_EQ(given.views_per_step, 6);
  EXPECT_EQ(given.image_size, 400);
}

TEST(Config, AnotherPresetTakesBackWhatTheFirstSet) {
  RunConfig config;
  set_config(config, "attack.method=paper");
  set_all(config, {"attack.beta=7", "attack.method=mesh"});
  EXPECT_EQ(config.attack.steps, RunConfig().attack.steps);
  EXPECT_EQ(config.attack.beta, 7);
  EXPECT_EQ(config.attack.optimize, (std::vector<std::string>{"vertex-colors", "vertices"}));
  set_config(config, "attack.method=dual");
  EXPECT_EQ(config.attack.optimize, RunConfig().attack.optimize);
  EXPECT_EQ(config.attack.beta, 7);
}

TEST(Config, RelationsOfAssignmentsHoldAtTheEnd) {
  RunConfig config;
  set_all(config, {"attack.eot.scale_low=2", "attack.eot.scale_high=3"});
  EXPECT_EQ(config.attack.eot.scale_low, 2);
  EXPECT_THROW(set_config(config, "attack.eot.scale_low=4"), InputError);
}

TEST(Config, UntargetedNeedsTheTrueClass) {
  RunConfig config;
  config.attack.goal = "untargeted";
  config.attack_target = "teapot";
  EXPECT_THROW((void)class_of_objective(config), InputError);
  config.true_class = "hen";
  EXPECT_EQ(class_of_objective(config), "hen");
  config.attack.goal = "targeted";
  EXPECT_EQ(class_of_objective(config), "teapot");
}

TEST(RunFolder, ChangedConfigurationIsRefusedWithTheKeys) {
  testing::TemporaryFolder folder;
  RunConfig config;
  { const tt3d::Run run(folder / "r", config, false); }
  config.attack.beta = 5;
  try {
    const tt3d::Run run(folder / "r", config, false);
    FAIL();
  } catch (const InputError& error) {
    expect_contains(error.what(), {"attack.beta", "1000.0", "5.0", "--restart"});
  }
  const tt3d::Run run(folder / "r", config, true);
  EXPECT_EQ(run.config().attack.beta, 5);
}

TEST(RunFolder, TwoProgramsDoNotShareIt) {
  testing::TemporaryFolder folder;
  const tt3d::Run run(folder / "r", {}, false);
  EXPECT_THROW(tt3d::Run(folder / "r", {}, false), InputError);
}

TEST(RunFolder, OpenRestoresTheConfiguration) {
  testing::TemporaryFolder folder;
  RunConfig config;
  config.attack.steps = 17;
  config.attack_surrogates = {"x y", "z"};
  set_config(config, "attack.beta=3");
  { const tt3d::Run run(folder / "r", config, false); }
  const tt3d::Run run = tt3d::Run::open(folder / "r");
  EXPECT_EQ(run.config().attack.steps, 17);
  EXPECT_EQ(run.config().attack_surrogates[0], "x y");
  EXPECT_EQ(run.config().given, config.given);
  EXPECT_THROW(tt3d::Run::open(folder / "none"), InputError);
}

TEST(RunFolder, ReadOnlyPlaceIsAResourceError) {
  EXPECT_THROW(tt3d::Run("/proc/tt3d-run", {}, false), ResourceError);
}

}  // namespace
}  // namespace tt3d
