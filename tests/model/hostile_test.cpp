#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "model/package_tools.h"
#include "support/temporary_folder.h"
#include "tt3d/model.h"

/// Graphs whose operators would take too much memory or change weights: the guarantees of
/// docs/threat-model.md while a graph runs.
namespace tt3d::model {
namespace {

using testing::Entries;
using Json = nlohmann::json;

Json argument(const std::string& name, const std::string& tag, const Json& value) {
  return {{"name", name}, {"arg", {{tag, value}}}, {"kind", 1}};
}

Json tensor(const std::string& name, const std::string& value) {
  return argument(name, "as_tensor", {{"name", value}});
}

Json result(const std::string& name) {
  Json outputs = Json::array();
  outputs.push_back({{"as_tensor", {{"name", name}}}});
  return outputs;
}

Json node(const std::string& target, const std::vector<Json>& inputs, const Json& outputs) {
  return {{"target", "torch.ops.aten." + target},
          {"inputs", Json(inputs)},
          {"outputs", outputs},
          {"name", "evil"},
          {"metadata", Json::object()}};
}

/// The toy network with additional nodes at its end.
class Hostile : public ::testing::Test {
 protected:
  std::string error_with(const std::vector<Json>& nodes) {
    Entries entries = testing::unpack(testing::fixture("toy_cnn.pt2"));
    std::string& text = entries.at("toy_cnn/models/model.json");
    Json json = Json::parse(text);
    for (const Json& one : nodes) json["graph_module"]["graph"]["nodes"].push_back(one);
    text = json.dump();
    testing::pack(path, entries);
    testing::write_card(path, "toy_cnn");
    try {
      (void)Classifier::load(path.string());
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  }
  void expect_refused(const std::vector<Json>& nodes, const std::string& part) {
    const std::string text = error_with(nodes);
    EXPECT_NE(text.find(part), std::string::npos) << "got: " << text;
  }

  testing::TemporaryFolder folder;
  std::filesystem::path path = folder / "toy.pt2";
};

TEST_F(Hostile, AddedNodesThatDoNoHarmRun) {
  EXPECT_EQ(error_with({node("relu.default", {tensor("self", "p_head_weight")}, result("fine"))}),
            "");
}

TEST_F(Hostile, HugeTensorsAreRefusedBeforeTheyAreMade) {
  const int64_t huge = int64_t{1} << 40;
  expect_refused(
      {node("zeros.default", {argument("size", "as_ints", Json::array({huge}))}, result("a"))},
      "exceeds the limit");
  const Json column =
      node("zeros.default", {argument("size", "as_ints", {1 << 20, 1})}, result("a"));
  const Json row = node("zeros.default", {argument("size", "as_ints", {1, 1 << 20})}, result("b"));
  expect_refused(
      {column, row, node("add.Tensor", {tensor("self", "a"), tensor("other", "b")}, result("c"))},
      "exceeds the limit");
  expect_refused({column, node("expand.default",
                               {tensor("self", "a"), argument("size", "as_ints", {1 << 20, huge})},
                               result("c"))},
                 "limit");
}

TEST_F(Hostile, ListsOfTensorsAreShort) {
  const Json wide =
      node("zeros.default", {argument("size", "as_ints", Json::array({1 << 22}))}, result("a"));
  Json part, outputs = Json::array();
  part["as_tensors"].push_back({{"name", "b"}});
  outputs.push_back(part);
  expect_refused({wide, node("unbind.int", {tensor("self", "a")}, outputs)}, "too many parts");
  expect_refused({wide, node("split.Tensor",
                             {tensor("self", "a"), argument("split_size", "as_int", 1)}, outputs)},
                 "too many parts");
}

/// A tensor of zeros as value `name`.
Json zeros(const std::string& name, const std::vector<int64_t>& sizes) {
  return node("zeros.default", {argument("size", "as_ints", sizes)}, result(name));
}

/// Arguments for which torch's own kernels read out of bounds or crash.
TEST_F(Hostile, ArgumentsThatLeadOutOfBoundsAreRefused) {
  const Json picture = zeros("evil_x", {2, 8, 4, 4});
  expect_refused(
      {zeros("q", {1, 1, 3, 4}), zeros("k", {1, 1, 5, 4}), zeros("v", {1, 1, 2, 4}),
       node("scaled_dot_product_attention.default",
            {tensor("query", "q"), tensor("key", "k"), tensor("value", "v")}, result("a"))},
      "keys do not fit");
  Json outputs = result("a");
  for (const char* name : {"b", "c"}) outputs.push_back(result(name)[0]);
  expect_refused({picture, zeros("s", {1}),
                  node("_native_batch_norm_legit_no_training.default",
                       {tensor("input", "evil_x"), argument("weight", "as_none", true),
                        argument("bias", "as_none", true), tensor("running_mean", "s"),
                        tensor("running_var", "s"), argument("momentum", "as_float", 0.1),
                        argument("eps", "as_float", 1e-5)},
                       outputs)},
                 "statistics do not fit");
  expect_refused(
      {picture,
       node("upsample_nearest2d.default",
            {tensor("self", "evil_x"), argument("output_size", "as_ints", {4, 4}),
             argument("scales_h", "as_float", 1e-30), argument("scales_w", "as_float", 1.0)},
            result("a"))},
      "scale is out of range");
  expect_refused(
      {picture, node("reflection_pad2d.default",
                     {tensor("self", "evil_x"), argument("padding", "as_ints", {-6, 6, 0, 0})},
                     result("a"))},
      "padding is negative");
  expect_refused({node("div.Tensor_mode",
                       {argument("self", "as_int", INT64_MIN), argument("other", "as_int", -1),
                        argument("rounding_mode", "as_string", "trunc")},
                       result("a"))},
                 "truncating division");
}

TEST_F(Hostile, WritesThroughViewsOfWeightsAreRefused) {
  const Json zero = node("zero_.default", {tensor("self", "a")}, result("b"));
  expect_refused(
      {node("view.default",
            {tensor("self", "p_head_weight"), argument("size", "as_ints", Json::array({-1}))},
            result("a")),
       zero},
      "writes to a weight");
  // A view that the operator's schema does not declare.
  Json operands = argument("tensors", "as_tensors", Json::array());
  operands["arg"]["as_tensors"].push_back({{"name", "p_head_weight"}});
  expect_refused(
      {node("einsum.default", {argument("equation", "as_string", "ij->ij"), operands}, result("a")),
       zero},
      "writes to a weight");
}

TEST_F(Hostile, NumbersWrittenIntoAreMadeAnew) {
  const Json one = argument("self", "as_int", 1);
  ASSERT_EQ(error_with({node("zero_.default", {one}, result("a"))}), "");
  const auto model = Classifier::load(path.string());
  const at::Tensor images = at::rand({1, 3, 16, 16});
  EXPECT_TRUE(model->logits(images).equal(model->logits(images)));
}

}  // namespace
}  // namespace tt3d::model
