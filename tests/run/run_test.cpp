#include "tt3d/run.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include <set>

#include "support/temporary_folder.h"

namespace tt3d::run {
namespace {

/// The message of the InputError of loading this TOML; "" if it loads.
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
  set_all(config, {std::string("seed=7")});
  set_all(config, {std::string("attack.target=teapot")});
  set_all(config, {std::string("attack.surrogates=[\"a\", \"b\"]")});
  set_all(config, {std::string("mesh.remesh_at=[0.25]")});
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "c.toml", config_toml(config));
  const RunConfig back = load_config(folder / "c.toml");
  EXPECT_EQ(config_json(back), config_json(config));
  EXPECT_EQ(config_json(config_from_json(config_json(config), "run.json")), config_json(config));
}

TEST(Config, KeysAreDocumentedAndUnique) {
  std::set<std::string> names;
  RunConfig defaults;
  const KeyList keys = keys_of(defaults);
  for (const Key& key : keys.all()) {
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
  const std::string folder = std::string(TT3D_SOURCE_DIR) + "/configs/";
  const RunConfig demo = load_config(folder + "demo.toml");
  EXPECT_EQ(demo.attack.target, "teapot");
  EXPECT_TRUE(std::filesystem::exists(demo.capture.path)) << demo.capture.path;
  const RunConfig paper = load_config(folder + "paper.toml");
  EXPECT_EQ(paper.attack.options.schedule.steps, 25000);
  EXPECT_EQ(paper.field.steps, 15000);
}

TEST(Config, RelativePathsAreRelativeToTheFile) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "sub/c.toml", "[capture]\npath = \"../photos\"\n");
  EXPECT_EQ(load_config(folder / "sub/c.toml").capture.path,
            std::filesystem::weakly_canonical(folder / "photos"));
}

TEST(Config, SetAcceptsTomlAndBareWords) {
  RunConfig config;
  set_all(config, {std::string("attack.target=n04398044")});
  EXPECT_EQ(config.attack.target, "n04398044");
  EXPECT_THROW(set_all(config, {std::string("attack.beta")}), InputError);
  EXPECT_THROW(set_all(config, {std::string("attack.beta=much")}), InputError);
}

TEST(Config, AClassMayBeAnIndex) {
  RunConfig config;
  set_all(config, std::vector<std::string>{"evaluate.true_class=933", "attack.target=849"});
  EXPECT_EQ(config.evaluate.true_class, "933");
  EXPECT_EQ(config.attack.target, "849");
  set_all(config, {std::string("attack.target=imagenet=hen,coco=bird")});
  EXPECT_EQ(config.attack.target, "imagenet=hen,coco=bird");
}

TEST(Config, APresetSetsAllItsKeysExceptGivenOnes) {
  const auto steps_and_beta = [](const std::string& toml) {
    testing::TemporaryFolder folder;
    write_file_atomic(folder / "c.toml", toml);
    return load_config(folder / "c.toml").attack.options;
  };
  const attack::AttackOptions plain = steps_and_beta("[attack]\nmethod = \"paper\"\n");
  EXPECT_EQ(plain.schedule.steps, 25000);
  EXPECT_EQ(plain.objective.loss, attack::Objective::kCrossEntropy);
  EXPECT_EQ(plain.schedule.view_distribution, scene::ViewDistribution::kPaper);
  // For any order, and also if the given value equals the default.
  const attack::AttackOptions given =
      steps_and_beta("[attack]\nsteps = 450\nmethod = \"paper\"\nviews_per_step = 6\n");
  EXPECT_EQ(given.schedule.steps, RunConfig().attack.options.schedule.steps);
  EXPECT_EQ(given.schedule.views_per_step, 6);
  EXPECT_EQ(given.schedule.image_size, 400);
}

TEST(Config, AnotherPresetResetsTheKeysOfTheFirst) {
  RunConfig config;
  set_all(config, {std::string("attack.method=paper")});
  set_all(config, std::vector<std::string>{"attack.beta=7", "attack.method=mesh"});
  EXPECT_EQ(config.attack.options.schedule.steps, RunConfig().attack.options.schedule.steps);
  EXPECT_EQ(config.attack.options.naturalness.beta, 7);
  EXPECT_EQ(config.attack.options.optimize,
            (std::vector{object::Part::kVertexColors, object::Part::kVertices}));
  set_all(config, {std::string("attack.method=dual")});
  EXPECT_EQ(config.attack.options.optimize, RunConfig().attack.options.optimize);
  EXPECT_EQ(config.attack.options.naturalness.beta, 7);
}

TEST(Config, RelationsBetweenKeysAreCheckedAfterAllAssignments) {
  RunConfig config;
  set_all(config, std::vector<std::string>{"attack.eot.scale_low=2", "attack.eot.scale_high=3"});
  EXPECT_EQ(config.attack.options.eot.scale_low, 2);
  EXPECT_THROW(set_all(config, {std::string("attack.eot.scale_low=4")}), InputError);
}

TEST(Config, UntargetedNeedsTheTrueClass) {
  RunConfig config;
  config.attack.options.objective.goal = attack::Goal::kUntargeted;
  config.attack.target = "teapot";
  EXPECT_THROW((void)class_of_objective(config), InputError);
  config.evaluate.true_class = "hen";
  EXPECT_EQ(class_of_objective(config), "hen");
  config.attack.options.objective.goal = attack::Goal::kTargeted;
  EXPECT_EQ(class_of_objective(config), "teapot");
}

TEST(RunFolder, AChangedConfigurationIsAnErrorThatNamesTheKeys) {
  testing::TemporaryFolder folder;
  RunConfig config;
  { const run::Run run(folder / "r", config, false); }
  config.attack.options.naturalness.beta = 5;
  try {
    const run::Run run(folder / "r", config, false);
    FAIL();
  } catch (const InputError& error) {
    expect_contains(error.what(), {"attack.beta", "1000.0", "5.0", "--restart"});
  }
  const run::Run run(folder / "r", config, true);
  EXPECT_EQ(run.config().attack.options.naturalness.beta, 5);
}

TEST(RunFolder, TwoProcessesCannotUseItAtTheSameTime) {
  testing::TemporaryFolder folder;
  const run::Run run(folder / "r", {}, false);
  EXPECT_THROW(run::Run(folder / "r", {}, false), InputError);
}

TEST(RunFolder, OpenRestoresTheConfiguration) {
  testing::TemporaryFolder folder;
  RunConfig config;
  config.attack.options.schedule.steps = 17;
  config.attack.surrogates = {"x y", "z"};
  set_all(config, {std::string("attack.beta=3")});
  { const run::Run run(folder / "r", config, false); }
  const run::Run run = run::Run::open(folder / "r");
  EXPECT_EQ(run.config().attack.options.schedule.steps, 17);
  EXPECT_EQ(run.config().attack.surrogates[0], "x y");
  EXPECT_EQ(run.config().given, config.given);
  EXPECT_THROW((void)run::Run::open(folder / "none"), InputError);
}

TEST(RunFolder, RunJsonHoldsTypedValues) {
  testing::TemporaryFolder folder;
  { const run::Run run(folder / "r", {}, false); }
  const auto config = nlohmann::json::parse(read_file(folder / "r/run.json"))["config"];
  EXPECT_TRUE(config["attack.steps"].is_number_integer());
  EXPECT_TRUE(config["attack.beta"].is_number_float());
  EXPECT_TRUE(config["attack.surrogates"].is_array());
  EXPECT_TRUE(config["evaluate.geometry"].is_boolean());
  EXPECT_EQ(config["attack.objective"], "logit");
}

TEST(RunFolder, AMalformedRecordIsAnErrorWithFileAndKey) {
  testing::TemporaryFolder folder;
  const auto error_of_open = [&](const std::string& text) {
    write_file_atomic(folder / "r/run.json", text);
    try {
      (void)run::Run::open(folder / "r");
      return std::string();
    } catch (const InputError& error) {
      return std::string(error.what());
    }
  };
  expect_contains(error_of_open(R"({"config": [], "seed": 1})"), {"run.json: config"});
  expect_contains(
      error_of_open(
          R"({"config": {"attack.steps": "450"}, "seed": 1, "versions": {}, "inputs": {}, "stages": []})"),
      {"run.json", "attack.steps", "integer"});
}

/// A run folder whose mesh stage is done and has read `file`.
void write_run(const std::filesystem::path& folder, const std::filesystem::path& file) {
  { const run::Run run(folder, {}, false); }
  auto record = nlohmann::json::parse(read_file(folder / "run.json"));
  record["stages"] = {{{"name", "mesh"},
                       {"seconds", 1},
                       {"peak_rss_bytes", 1},
                       {"seed", 0},
                       {"inputs", {{file.string(), sha256_file(file)}}}}};
  write_file_atomic(folder / "run.json", record.dump());
  write_file_atomic(folder / "mesh/mesh.safetensors", "product");
}

TEST(RunFolder, AFileThatChangedUnderAFinishedStageIsRefusedByName) {
  testing::TemporaryFolder folder;
  const std::filesystem::path photo = folder / "photo.jpg";
  write_file_atomic(photo, "as it was");
  write_run(folder / "r", photo);
  Progress quiet;
  const auto error_of_run = [&] {
    try {
      run::Run run = run::Run::open(folder / "r");
      run.run_until("field", quiet);  // has no input, so it fails after the check
      return std::string();
    } catch (const InputError& error) {
      return std::string(error.what());
    }
  };
  expect_contains(error_of_run(), {"capture.path"});
  write_file_atomic(photo, "as it is");
  expect_contains(error_of_run(), {photo.string() + ": has changed since stage 'mesh' read it"});
  // A stage that is forgotten reads its files anew.
  {
    run::Run run = run::Run::open(folder / "r");
    run.forget_from("mesh");
  }
  expect_contains(error_of_run(), {"capture.path"});
}

TEST(RunFolder, ANewSeedHoldsFromAStageOn) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "photo.jpg", "photo");
  write_run(folder / "r", folder / "photo.jpg");
  {
    run::Run run = run::Run::open(folder / "r");
    run.reconfigure({{"seed", int64_t{5}}}, "attack");
    EXPECT_EQ(run.config().seed, 5U);
    ASSERT_EQ(run.finished().size(), 1U);
    EXPECT_EQ(run.finished()[0].seed, 0U) << "the mesh was made with the old seed";
  }
  EXPECT_EQ(run::Run::open(folder / "r").config().seed, 5U);
}

TEST(RunFolder, TheTableOfStagesIsConsistent) {
  std::set<std::string> names;
  for (const Stage& stage : stages()) {
    EXPECT_TRUE(names.insert(stage.name).second);
    // A stage writes into its own folder only, so its product is in this folder.
    if (!stage.folder.empty()) {
      EXPECT_EQ(*stage.product.begin(), stage.folder) << stage.name;
    }
  }
}

TEST(RunFolder, AReadOnlyParentIsAResourceError) {
  EXPECT_THROW(run::Run("/proc/tt3d-run", {}, false), ResourceError);
}

}  // namespace
}  // namespace tt3d::run
