#include <gtest/gtest.h>
#include <sys/stat.h>

#include "model/package_tools.h"
#include "support/temporary_folder.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

using testing::Entries;
using Json = nlohmann::json;

const std::string kRoot = "toy_cnn/";
const std::string kGraph = kRoot + "models/model.json";
const std::string kWeights = kRoot + "data/weights/model_weights_config.json";

/// Packages made from the toy network, each with one error.
class Refusal : public ::testing::Test {
 protected:
  void edit_json(const std::string& entry, const std::function<void(Json&)>& edit) {
    Json json = Json::parse(entries.at(entry));
    edit(json);
    entries[entry] = json.dump();
  }
  void edit_graph(const std::function<void(Json& graph)>& edit) {
    edit_json(kGraph, [&](Json& json) { edit(json["graph_module"]["graph"]); });
  }
  void edit_weight(const std::function<void(Json& weight)>& edit) {
    edit_json(kWeights, [&](Json& json) { edit(json["config"]["head.weight"]); });
  }
  void write(bool deflate = false, const std::function<void(zip_t*)>& last = {}) {
    testing::pack(path, entries, deflate, last);
    testing::write_card(path, "toy_cnn");
  }
  /// The error when loading the package, "" if it loads.
  std::string error(const ModelLimits& limits = {}) const {
    try {
      (void)Classifier::load(path.string(), limits);
    } catch (const Error& caught) {
      return caught.what();
    }
    return "";
  }
  void expect_error(const std::string& part, const ModelLimits& limits = {}) const {
    const std::string text = error(limits);
    EXPECT_NE(text.find(part), std::string::npos) << "got: " << text;
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  }

  testing::TemporaryFolder folder;
  std::filesystem::path path = folder / "toy.pt2";
  Entries entries = testing::unpack(testing::fixture("toy_cnn.pt2"));
};

TEST_F(Refusal, RepackedArchiveLoads) {
  write();
  EXPECT_EQ(error(), "");
  write(true);
  EXPECT_EQ(error(), "") << "deflated";
}

TEST_F(Refusal, Pickles) {
  entries = {{"toy/data.pkl", "x"}, {"toy/version", "3"}};
  write();
  expect_error("is a pickle");
  entries = testing::unpack(testing::fixture("toy_cnn.pt2"));
  edit_weight([](Json& weight) { weight["use_pickle"] = true; });
  write();
  expect_error("pickled");
}

TEST_F(Refusal, NotAZip) {
  write_file_atomic(path, "\x80\x04pickle");
  testing::write_card(path, "toy_cnn");
  expect_error("not a readable zip archive");
  write_file_atomic(path, "");
  testing::write_card(path, "toy_cnn");
  expect_error("not a readable zip archive");
}

TEST_F(Refusal, OtherZip) {
  entries = {{"a/b.txt", "x"}};
  write();
  expect_error("not a torch.export archive");
}

TEST_F(Refusal, NamesThatLeaveTheArchive) {
  for (const std::string name : {"toy_cnn/../evil", "../evil", "toy_cnn/a\\b"}) {
    auto kept = entries;
    entries.emplace(name, "x");
    write();
    EXPECT_NE(error(), "") << name;
    entries = kept;
  }
  entries.emplace("/etc/evil", "x");
  write();
  expect_error("plain relative path");
}

TEST_F(Refusal, SymbolicLink) {
  write(false, [](zip_t* archive) {
    zip_file_set_external_attributes(archive, 0, 0, ZIP_OPSYS_UNIX,
                                     static_cast<zip_uint32_t>(S_IFLNK | 0777) << 16);
  });
  expect_error("link");
}

TEST_F(Refusal, ZipBomb) {
  entries[kRoot + "data/weights/bomb"] = std::string(8 << 20, '\0');
  write(true);
  expect_error("zip bomb");
}

TEST_F(Refusal, DuplicateEntries) {
  entries.emplace(kRoot + "dup_a", "x");
  entries.emplace(kRoot + "dup_b", "y");
  write();
  std::string bytes = read_file(path);
  testing::overwrite(bytes, "dup_b", "dup_a");
  write_file_atomic(path, bytes);
  testing::write_card(path, "toy_cnn");
  expect_error("appears twice");
}

TEST_F(Refusal, TruncatedFile) {
  write();
  const std::string bytes = read_file(path);
  for (const size_t keep : {bytes.size() / 10, bytes.size() / 2, bytes.size() - 10}) {
    write_file_atomic(path, bytes.substr(0, keep));
    testing::write_card(path, "toy_cnn");
    expect_error("not a readable zip archive");
  }
}

TEST_F(Refusal, DamagedWeights) {
  entries.emplace(kRoot + "data/weights/marker", "MARKERMARKER");
  edit_weight([](Json& weight) { weight["path_name"] = "marker"; });
  edit_weight([](Json& weight) {
    weight["tensor_meta"]["sizes"] = Json::array({{{"as_int", 1}}});
  });
  edit_weight([](Json& weight) {
    weight["tensor_meta"]["strides"] = Json::array({{{"as_int", 1}}});
  });
  write();
  std::string bytes = read_file(path);
  testing::overwrite(bytes, "MARKERMARKER", "MARKERmARKER");
  write_file_atomic(path, bytes);
  testing::write_card(path, "toy_cnn");
  expect_error("damaged");
}

TEST_F(Refusal, WeightsBeyondTheirFile) {
  const auto original = entries;
  const std::vector<std::pair<const char*, Json>> cases = {
      {"sizes", {{{"as_int", 7}}, {{"as_int", 9}}}},
      {"sizes", {{{"as_int", int64_t{1} << 62}}, {{"as_int", 8}}}},
      {"sizes", {{{"as_int", -7}}, {{"as_int", 8}}}},
      {"strides", {{{"as_int", 1000}}, {{"as_int", 1}}}},
      {"strides", {{{"as_int", int64_t{1} << 62}}, {{"as_int", int64_t{1} << 62}}}},
      {"storage_offset", {{"as_int", 1}}},
      {"storage_offset", {{"as_int", -1}}},
      {"sizes", {{{"as_int", 7.5}}, {{"as_int", 8}}}},
      {"storage_offset", {{"as_int", 4e23}}},
      {"dtype", 1e300},
      {"dtype", 8},
      {"dtype", 99},
      {"layout", 1}};
  for (const auto& [key, value] : cases) {
    entries = original;
    edit_weight([&](Json& weight) { weight["tensor_meta"][key] = value; });
    write();
    expect_error("weight 'head.weight'");
  }
}

TEST_F(Refusal, WeightFileOutsideItsFolder) {
  edit_weight([](Json& weight) { weight["path_name"] = "../constants/x"; });
  write();
  expect_error("not a plain file name");
}

TEST_F(Refusal, MissingWeight) {
  edit_json(kWeights, [](Json& json) { json["config"].erase("head.weight"); });
  write();
  expect_error("weight 'head.weight' is missing");
}

TEST_F(Refusal, UnknownOperatorIsNamedWithItsNode) {
  for (const std::string target :
       {"torch.ops.aten.rand_like.default", "torch.ops.aten.as_strided.default",
        "torch.ops.aten.from_file.default", "torch.ops.aten.relu.out", "torch.ops.my.op.default",
        "os.system", "torch.ops.aten.set_.source_Storage"}) {
    entries = testing::unpack(testing::fixture("toy_cnn.pt2"));
    edit_graph([&](Json& graph) { graph["nodes"][0]["target"] = target; });
    write();
    expect_error("node");
    EXPECT_NE(error().find(target == "torch.ops.aten.relu.out" ? "relu" : target),
              std::string::npos);
  }
}

TEST_F(Refusal, CyclesAndUndefinedNames) {
  edit_graph([](Json& graph) { std::reverse(graph["nodes"].begin(), graph["nodes"].end()); });
  write();
  expect_error("before anything defines it");
}

TEST_F(Refusal, ValueDefinedTwice) {
  edit_graph([](Json& graph) { graph["nodes"][1]["outputs"] = graph["nodes"][0]["outputs"]; });
  write();
  expect_error("defined twice");
}

TEST_F(Refusal, WrongInputAndOutput) {
  edit_graph([](Json& graph) {
    for (auto& [name, meta] : graph["tensor_values"].items()) meta["dtype"] = 8;
  });
  write();
  expect_error("float32 images");
  entries = testing::unpack(testing::fixture("toy_cnn.pt2"));
  edit_json(kGraph,
            [](Json& json) { json["graph_module"]["signature"]["output_specs"] = Json::array(); });
  write();
  expect_error("exactly one tensor");
}

TEST_F(Refusal, TrainingMode) {
  edit_graph([](Json& graph) {
    for (Json& node : graph["nodes"]) {
      for (Json& input : node["inputs"]) {
        if (input["name"] == "training") input["arg"] = {{"as_bool", true}};
      }
    }
  });
  write();
  expect_error("training mode");
}

TEST_F(Refusal, WritingToAWeight) {
  edit_graph([](Json& graph) {
    Json node = graph["nodes"][0];
    node["target"] = "torch.ops.aten.zero_.default";
    node["inputs"] = Json::array(
        {{{"name", "self"}, {"arg", {{"as_tensor", {{"name", "p_head_bias"}}}}}, {"kind", 1}}});
    node["outputs"] = Json::array({{{"as_tensor", {{"name", "evil"}}}}});
    graph["nodes"].push_back(node);
  });
  write();
  expect_error("writes to a weight");
}

TEST_F(Refusal, Limits) {
  write();
  ModelLimits limits;
  limits.nodes = 5;
  expect_error("more than the limit", limits);
  limits = {};
  limits.archive_bytes = 1000;
  expect_error("archive_bytes", limits);
  limits = {};
  limits.tensor_bytes = 10;
  expect_error("tensor_bytes", limits);
  limits = {};
  limits.json_depth = 3;
  expect_error("nested", limits);
  limits = {};
  limits.intermediate_bytes = 100;
  expect_error("intermediate result", limits);
}

TEST_F(Refusal, DeeplyNestedGraph) {
  entries[kGraph] = std::string(100000, '[');
  write();
  expect_error("nested deeper");
}

}  // namespace
}  // namespace tt3d::model
