// Any JSON as the graph and the tables of weights gives a checked graph, or Malformed. The archive
// around them is valid, so that the fuzzer spends its time on the content. An input is up to three
// texts, separated by a line of '=': graph, table of weights, table of constants.

#include <zip.h>

#include <array>
#include <string>
#include <string_view>

#include "graph_reader.h"
#include "malformed.h"
#include "memory_file.h"
#include "rewrite.h"

using tt3d::model::Archive;
using tt3d::model::Graph;
using tt3d::model::Malformed;
using tt3d::model::MappedFile;

namespace {

constexpr std::string_view kSeparator = "\n=\n";
constexpr size_t kWeightBytes = 4096;

void add(zip_t* archive, const std::string& name, std::string_view content) {
  zip_source_t* source = zip_source_buffer(archive, content.data(), content.size(), 0);
  const zip_int64_t index = zip_file_add(archive, ("m/" + name).c_str(), source, 0);
  zip_set_file_compression(archive, static_cast<zip_uint64_t>(index), ZIP_CM_STORE, 0);
}

std::array<std::string_view, 3> split(std::string_view text) {
  std::array<std::string_view, 3> parts;
  for (size_t i = 0; i < 3; ++i) {
    const size_t end = i < 2 ? text.find(kSeparator) : std::string_view::npos;
    parts[i] = text.substr(0, end);
    if (end == std::string_view::npos) break;
    text.remove_prefix(end + kSeparator.size());
  }
  return parts;
}

/// A zip archive of these texts and ten files of weights.
std::string pack(const std::array<std::string_view, 3>& texts) {
  static const std::string weights(kWeightBytes, '\1');
  zip_error_t error;
  zip_source_t* buffer = zip_source_buffer_create(nullptr, 0, 0, &error);
  zip_source_keep(buffer);
  zip_t* archive = zip_open_from_source(buffer, ZIP_TRUNCATE, &error);
  add(archive, "archive_format", "pt2");
  add(archive, "archive_version", "0");
  add(archive, "models/model.json", texts[0]);
  add(archive, "data/weights/model_weights_config.json", texts[1]);
  add(archive, "data/constants/model_constants_config.json", texts[2]);
  for (int i = 0; i < 10; ++i) add(archive, "data/weights/weight_" + std::to_string(i), weights);
  zip_close(archive);
  zip_stat_t stat;
  zip_source_stat(buffer, &stat);
  std::string bytes(stat.size, '\0');
  zip_source_open(buffer);
  zip_source_read(buffer, bytes.data(), bytes.size());
  zip_source_close(buffer);
  zip_source_free(buffer);
  return bytes;
}

/// The preparation of a graph in Classifier::load.
void prepare(Graph graph) {
  tt3d::model::fold_paddings(graph);
  if (tt3d::model::can_use_channels_last(graph)) tt3d::model::use_channels_last(graph);
  tt3d::model::fold_batch_norms(graph, at::MemoryFormat::ChannelsLast);
  tt3d::model::simplify_batch_norms(graph);
  tt3d::model::find_last_uses(graph);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string bytes = pack(split({reinterpret_cast<const char*>(data), size}));
  const tt3d::testing::MemoryFile file(reinterpret_cast<const uint8_t*>(bytes.data()),
                                       bytes.size());
  tt3d::model::ModelLimits limits;
  limits.archive_bytes = limits.tensor_bytes = 1 << 22;
  limits.nodes = 1000;
  try {
    const Archive archive(MappedFile::open(file.path(), limits.archive_bytes), limits);
    prepare(tt3d::model::read_graph(archive, limits));
  } catch (const Malformed&) {
    return 0;
  } catch (const c10::Error&) {
    return 0;  // Classifier::load turns it into an InputError too
  }
  return 0;
}
