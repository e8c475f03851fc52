#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "tt3d/asset.h"
#include "tt3d/core.h"
#include "tt3d/record.h"

/// An HTML page about one run, and an HTML page that compares several runs. Both use records alone
/// and open from disk without a network.
namespace tt3d::report {

/// One view on the contact sheet.
struct ShownView {
  at::Tensor adversarial, clean;  ///< [H,W,3] uint8, sRGB; clean may be undefined
  double azimuth_deg = 0, elevation_deg = 0;
  std::vector<record::Answer> answers;  ///< answers for the adversarial picture
};

/// A frame of a video.
struct ShownFrame {
  at::Tensor picture;  ///< [H,W,3] uint8, sRGB
  double seconds = 0;
  std::string background;  ///< label; may be empty
  std::vector<record::Answer> answers;
};

/// The files of `tt3d video-score --out`.
struct ShownVideo {
  record::VideoRecord record;
  std::vector<ShownFrame> frames;  ///< shown as a strip; may be empty
};

/// The content of the page. An empty member leaves out its section.
struct ReportInput {
  std::string title;
  const asset::TexturedMesh* clean = nullptr;  ///< both objects are shown in 3D, side by side
  const asset::TexturedMesh* adversarial = nullptr;
  std::optional<record::EvaluationRecord> evaluation;  ///< the evaluation of the run itself
  std::vector<record::EvaluationRecord> others;        ///< evaluations with other renderers
  std::vector<record::JudgeRecord> judges;
  std::vector<ShownVideo> videos;
  record::Curves curves;
  std::string config_toml;  ///< effective configuration, shown as text
  std::optional<record::RunRecord> run;
  std::optional<record::FieldMetrics> field;
  std::optional<record::MeshMetrics> mesh;
  std::vector<ShownView> views;  ///< contact sheet
};

/// Returns the whole page. All text is escaped; the page loads nothing from elsewhere. Throws
/// InputError for pictures of the wrong shape.
[[nodiscard]] std::string render_report(const ReportInput& input);

/// Writes the page atomically. Throws the errors of render_report, and ResourceError.
void write_report(const ReportInput& input, const std::filesystem::path& html);

/// A run, or any set of evaluations, on the page that compares runs.
struct ComparedRun {
  std::string name;
  record::Records records;
  std::vector<std::string> surrogates = {};  ///< names of the models the attack saw
};

/// A table as CSV and as a LaTeX tabular for booktabs.
struct ComparedTable {
  std::string file;  ///< file name without extension
  std::string csv, latex;
};

/// The records of all runs as a page and as tables with the same numbers.
struct Comparison {
  std::string html;
  std::string json;  ///< an object with the rows of each table: victims, tasks, videos
  /// comparison: one row per run, renderer and victim. comparison-tasks: one row per run, task and
  /// phrase. comparison-videos: one row per run, video, victim and background. A table without rows
  /// has its header only.
  std::vector<ComparedTable> tables;
};
[[nodiscard]] Comparison compare_runs(const std::vector<ComparedRun>& runs);

}  // namespace tt3d::report
