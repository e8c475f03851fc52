#include "tt3d/record.h"

#include <gtest/gtest.h>

#include "support/temporary_folder.h"
#include "tt3d/core.h"

// Every record survives a round trip. A malformed record is an error with file and key.

namespace tt3d::record {
namespace {

EvaluationRecord evaluation() {
  EvaluationRecord r;
  r.asset = "a.glb";
  r.asset_sha256 = "0123";
  r.target = {849, "n04398044", "teapot"};
  r.true_class = ClassId{8, "n01514859", "hen, \"biddy\""};
  r.renderer = {"builtin", "0.1.0", false, 4};
  r.background = "white";
  r.views = {"dome", 2, 7, 400};
  VictimRecord v;
  v.name = "one, two";
  v.sha256 = "ab";
  v.answers = {{849, "teapot", 0.75, 0.75, 0.125, 8}, {8, "hen, biddy", 0.5, 0.25, 0.5, 8}};
  summarize(v, 849, 8);
  r.victims = {v};
  r.naturalness.psnr = 22.5;
  r.naturalness.lpips_net = "alex";
  r.geometry = GeometryRecord{0.1, 0.2, 3, 4, 5};
  r.tt3d_version = "0.1.0";
  r.wall_seconds = 1.5;
  r.poses = {{10, 20, 3, -1}, {30, 40, 3, 1}};
  return r;
}

/// The message of the InputError of reading.
template <typename Read>
std::string error_of(const Read& read) {
  try {
    (void)read();
    return "";
  } catch (const InputError& error) {
    return error.what();
  }
}

TEST(Evaluation, RoundTripOfJsonAndCsv) {
  testing::TemporaryFolder folder;
  const EvaluationRecord before = evaluation();
  save(before, folder / "e.json");
  const EvaluationRecord after = load_evaluation(folder / "e.json");
  EXPECT_EQ(tt3d::to_json(after), tt3d::to_json(before));
  ASSERT_EQ(after.victims[0].answers.size(), 2U);
  EXPECT_EQ(after.victims[0].answers[1].top1_name, "hen, biddy");
  EXPECT_EQ(after.victims[0].answers[1].p_true, 0.5);
  EXPECT_EQ(after.victims[0].answers[0].clean_top1, 8);
  EXPECT_EQ(after.poses[1].elevation_deg, 40);
}

TEST(Evaluation, FiguresThatWereNotMeasuredStayEmpty) {
  testing::TemporaryFolder folder;
  EvaluationRecord before = evaluation();
  before.true_class.reset();
  before.geometry.reset();
  before.victims[0] = {};
  before.victims[0].name = "m";
  before.victims[0].answers = {{3, "x", 0.5, 0.25, {}, {}}};
  before.poses.resize(1);
  save(before, folder / "e.json");
  const EvaluationRecord after = load_evaluation(folder / "e.json");
  EXPECT_FALSE(after.true_class);
  EXPECT_FALSE(after.geometry);
  EXPECT_FALSE(after.victims[0].clean_accuracy);
  EXPECT_FALSE(after.victims[0].answers[0].p_true);
  EXPECT_FALSE(after.victims[0].answers[0].clean_top1);
}

TEST(Evaluation, MalformedFilesAreErrorsWithFileAndKey) {
  testing::TemporaryFolder folder;
  const nlohmann::json good = tt3d::to_json(evaluation());
  const auto refused = [&](const char* pointer, const nlohmann::json& value) {
    nlohmann::json bad = good;
    bad[nlohmann::json::json_pointer(pointer)] = value;
    write_json(folder / "bad.json", bad);
    return error_of([&] { return load_evaluation(folder / "bad.json"); });
  };
  EXPECT_NE(refused("/victims/0/asr", "x").find("bad.json: victims[0].asr: expected a finite"),
            std::string::npos);
  EXPECT_NE(refused("/victims/0/asr_ci95", {0.1}).find("asr_ci95: expected 2"), std::string::npos);
  EXPECT_NE(refused("/target", 3).find("target: expected an object"), std::string::npos);
  EXPECT_NE(refused("/views/count", 2.5).find("views.count: expected an integer"),
            std::string::npos);
  EXPECT_NE(refused("/victims", "none").find("victims: expected a list"), std::string::npos);
  nlohmann::json without = good;
  without.erase("background");
  write_json(folder / "bad.json", without);
  EXPECT_NE(
      error_of([&] { return load_evaluation(folder / "bad.json"); }).find("background: is missing"),
      std::string::npos);
  write_file_atomic(folder / "bad.json", "{\n\"asset\": ");
  EXPECT_NE(error_of([&] { return load_evaluation(folder / "bad.json"); }).find("bad.json:2: "),
            std::string::npos);
}

TEST(Evaluation, WrongRowsOfTheCsvFileAreErrorsWithTheirLine) {
  testing::TemporaryFolder folder;
  save(evaluation(), folder / "e.json");
  const std::string csv = read_file(folder / "e.csv");
  const auto refused = [&](const std::string& from, const std::string& to) {
    std::string text = csv;
    text.replace(text.find(from), from.size(), to);
    write_file_atomic(folder / "e.csv", text);
    return error_of([&] { return load_evaluation(folder / "e.json"); });
  };
  EXPECT_NE(refused("0.750000", "high").find("e.csv:2: p_top1: expected a number"),
            std::string::npos);
  EXPECT_NE(refused("\"one, two\",1", "\"one, two\",5").find("e.csv:3: expected view 1"),
            std::string::npos);
  EXPECT_NE(refused("p_target", "p_aim").find("has no column 'p_target'"), std::string::npos);
  EXPECT_NE(refused("\"one, two\",0", "other,0").find("victim 'other' is not in the record"),
            std::string::npos);
}

TEST(Interval, WilsonEqualsATextbookExample) {
  const Interval i = wilson_interval(8, 10);
  EXPECT_NEAR(i.low, 0.4902, 1e-3);
  EXPECT_NEAR(i.high, 0.9433, 1e-3);
  EXPECT_EQ(wilson_interval(0, 20).low, 0);
  EXPECT_EQ(wilson_interval(20, 20).high, 1);
}

TEST(Video, RoundTrip) {
  VideoRecord before;
  before.video = "v.mp4";
  before.video_sha256 = "ff";
  before.width = 640;
  before.height = 480;
  before.duration_seconds = 2.5;
  before.target = {849, "", "teapot"};
  before.frames = 3;
  const ClassId target = {2, "", "teapot"};
  before.victims = {{"m", "aa", target, {3, 1.0 / 3, {0.1, 0.8}}, 0.25, {{"", {1, 0, {0, 0.9}}}}}};
  before.strip = {{{"0.jpg", 0.5, "grass", {{"m", "teapot", 0.5, true}}}}};
  const nlohmann::json j = tt3d::to_json(before);
  EXPECT_EQ(tt3d::to_json(JsonValue(j, "v.json").as<VideoRecord>()), j);
  before.strip.reset();
  const nlohmann::json bare = tt3d::to_json(before);
  EXPECT_FALSE(JsonValue(bare, "v.json").as<VideoRecord>().strip);
}

TEST(Judge, RoundTrip) {
  JudgeRecord before;
  before.task = "detect";
  before.model = "models/judges/detect";
  before.shares = {{"a hen", 0.15}, {"a teapot", 0.65}};
  before.answers = nlohmann::json::array({{{"found", {true, false}}}});
  before.renderer.name = "blender";
  before.renderer.lit = true;
  before.views = {"dome", 20, 0, {}};
  const nlohmann::json j = tt3d::to_json(before);
  EXPECT_EQ(tt3d::to_json(JsonValue(j, "j.json").as<JudgeRecord>()), j);
}

TEST(Curves, RoundTrip) {
  testing::TemporaryFolder folder;
  const Curves before = {{0, 1.5, 1.25, 0.5, 0.25, 0.125, 2, 0.5}, {1, 1, 1, 1, 1, 1, 1, 1}};
  EXPECT_TRUE(curves_csv(before).starts_with(
      "step,loss,objective,rgb,chamfer,laplacian,edge,success\n0,1.5,1.25,0.5,0.25,0.125,2,0.5000"
      "\n"));
  write_file_atomic(folder / "c.csv", curves_csv(before));
  EXPECT_EQ(curves_csv(load_curves(folder / "c.csv")), curves_csv(before));
  write_file_atomic(folder / "c.csv", "step,loss\n0,1\n");
  EXPECT_NE(error_of([&] { return load_curves(folder / "c.csv"); }).find("no column 'objective'"),
            std::string::npos);
}

TEST(Run, RoundTripAndSurrogates) {
  RunRecord before;
  before.config = {{"attack.surrogates", {"models/seen.pt2", "other"}}, {"attack.beta", 2.5}};
  before.given = {"attack.beta"};
  before.seed = 7;
  before.versions = {{"tt3d", "0.1.0"}};
  before.threads = 2;
  before.inputs = {{"a", "b"}};
  before.stages = {{"field", 1.5, 1 << 20, 7, {{"a", "b"}}}};
  before.unfinished = {{"mesh", 0, 0, 8, {{"c", "d"}}}};
  const nlohmann::json j = tt3d::to_json(before);
  const auto after = JsonValue(j, "run.json").as<RunRecord>();
  EXPECT_EQ(tt3d::to_json(after), j);
  EXPECT_EQ(after.surrogates(), (std::vector<std::string>{"seen", "other"}));
}

TEST(Run, StagesOfOlderVersionsHaveNoSeedAndNoInputs) {
  const auto stage = nlohmann::json::parse(R"({"name": "field", "seconds": 1.5,
                                               "peak_rss_bytes": 3})");
  const auto after = JsonValue(stage, "run.json").as<StageRecord>();
  EXPECT_EQ(after.name, "field");
  EXPECT_FALSE(after.seed);
  EXPECT_TRUE(after.inputs.empty());
}

TEST(Metrics, RoundTrip) {
  const nlohmann::json mesh = tt3d::to_json(MeshMetrics{10, 8, 1, 0, 2, true, 28.5});
  EXPECT_EQ(tt3d::to_json(JsonValue(mesh, "m").as<MeshMetrics>()), mesh);
  const nlohmann::json field = tt3d::to_json(FieldMetrics{31.5, 8});
  const nlohmann::json asset = tt3d::to_json(AssetMetrics{30.5});
  EXPECT_EQ(tt3d::to_json(JsonValue(field, "m").as<FieldMetrics>()), field);
  EXPECT_EQ(tt3d::to_json(JsonValue(asset, "m").as<AssetMetrics>()), asset);
}

TEST(Folder, RecordsAreReadByKindAndOtherFilesIgnored) {
  testing::TemporaryFolder folder;
  save(evaluation(), folder / "b.json");
  save(evaluation(), folder / "builtin.json");
  JudgeRecord judge;
  judge.task = "caption";
  write_json(folder / "j.json", tt3d::to_json(judge));
  VideoRecord video;
  video.video = "v.mp4";
  write_json(folder / "v.json", tt3d::to_json(video));
  write_file_atomic(folder / "notes.json", "[1, 2]");
  write_file_atomic(folder / "other.json", "{\"x\": 1}");
  const Records records = load_records(folder.path(), "builtin.json");
  EXPECT_EQ(records.evaluations.size(), 1U);
  EXPECT_EQ(records.judges.size(), 1U);
  ASSERT_EQ(records.videos.size(), 1U);
  EXPECT_EQ(records.videos[0].first.filename(), "v.json");
  write_file_atomic(folder / "b.json", "{\"victims\": [], \"renderer\": 3}");
  EXPECT_THROW((void)load_records(folder.path()), InputError);
}

}  // namespace
}  // namespace tt3d::record
