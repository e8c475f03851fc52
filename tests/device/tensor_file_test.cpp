#include "tt3d/tensor_file.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/temporary_folder.h"
#include "tt3d/core.h"

namespace tt3d {
namespace {

std::string with_header(const std::string& header, const std::string& data) {
  const uint64_t size = header.size();
  return std::string(reinterpret_cast<const char*>(&size), 8) + header + data;
}

TEST(TensorFile, RoundTrip) {
  testing::TemporaryFolder folder;
  const at::Tensor a = at::arange(6, at::kFloat).view({2, 3});
  const at::Tensor b = at::tensor({1, 2, 3}, at::kLong), c = at::empty({0, 4}, at::kByte);
  save_tensors(folder / "x.safetensors", {{"a", a}, {"b", b}, {"c", c}}, {{"format", "test"}});
  const TensorFile file = load_tensors(folder / "x.safetensors");
  EXPECT_TRUE(at::equal(file.get("a", {2, 3}, at::kFloat), a));
  EXPECT_TRUE(at::equal(file.get("b", {3}, at::kLong), b));
  EXPECT_EQ(file.get("c", {0, 4}, at::kByte).numel(), 0);
  EXPECT_EQ(file.metadata.at("format"), "test");
  EXPECT_THROW((void)file.get("a", {3, 2}, at::kFloat), InputError);
  EXPECT_THROW((void)file.get("d", {1}, at::kFloat), InputError);
}

TEST(TensorFile, MalformedFilesAreInputErrors) {
  testing::TemporaryFolder folder;
  const std::vector<std::string> bad = {
      "",
      "short",
      with_header("not json", ""),
      with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})", "1234"),
      with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,4]}})", "12345678"),
      with_header(R"({"a":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}})", "1234"),
      with_header(R"({"a":{"dtype":"F32","shape":[4611686018427387904,4],"data_offsets":[0,4]}})",
                  "1234"),
      with_header(R"({"a":{"dtype":"F32","shape":[0,4611686018427387904,4611686018427387904],)"
                  R"("data_offsets":[0,0]}})",
                  ""),
      with_header(R"({"a":{"dtype":"BOOL","shape":[1],"data_offsets":[0,1]}})", "1"),
      with_header(R"({"a":{"shape":[1]}})", "1"),
      std::string("\xff\xff\xff\xff\xff\xff\xff\xff", 8) + "{}",
  };
  for (const std::string& bytes : bad) {
    write_file_atomic(folder / "bad.safetensors", bytes);
    EXPECT_THROW((void)load_tensors(folder / "bad.safetensors"), InputError) << bytes;
  }
}

TEST(TensorFile, EveryTruncationIsAnInputError) {
  testing::TemporaryFolder folder;
  save_tensors(folder / "x", {{"a", at::arange(6, at::kFloat)}, {"b", at::ones({3})}}, {});
  const std::string bytes = read_file(folder / "x");
  for (size_t size = 0; size < bytes.size(); size += 3) {
    write_file_atomic(folder / "cut", bytes.substr(0, size));
    EXPECT_THROW((void)load_tensors(folder / "cut"), InputError) << size;
  }
}

}  // namespace
}  // namespace tt3d
