#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <string>
#include <vector>

#include "tt3d/bake.h"
#include "tt3d/capture.h"
#include "tt3d/core.h"

/// A run as one HTML page that opens from disk without a network.
namespace tt3d {

/// What a victim says to one picture of the adversarial object.
struct ReportVictimAnswer {
  std::string victim;      ///< name of the model
  std::string answer;      ///< its most probable class
  double probability = 0;  ///< of that class, in [0,1]
  bool is_target = false;  ///< the answer is the attack's target class
};

/// One view on the contact sheet.
struct ReportView {
  at::Tensor adversarial, clean;  ///< [H,W,3] uint8, sRGB; clean may be undefined
  double azimuth_deg = 0, elevation_deg = 0;
  std::vector<ReportVictimAnswer> answers;  ///< to the adversarial picture
};

/// A frame of a video.
struct ReportFrame {
  at::Tensor picture;  ///< [H,W,3] uint8, sRGB
  double seconds = 0;
  std::string background;  ///< label; may be empty
  std::vector<ReportVictimAnswer> answers;
};

/// What `tt3d video-score --out` wrote.
struct ReportVideo {
  std::string record_json;
  std::vector<ReportFrame> frames;  ///< shown as a strip; may be empty
};

/// Everything the page shows. A text, path or list that is empty leaves its part out.
struct ReportInput {
  std::string title;
  std::filesystem::path clean_glb, adversarial_glb;  ///< shown turning in 3D, side by side
  std::string record_json;                           ///< evaluation record (eval/builtin.json)
  std::vector<std::string> other_records;  ///< evaluations by other renderers (eval/*.json)
  std::vector<std::string> judge_records;  ///< what `tt3d judge --out` wrote, JSON
  std::vector<ReportVideo> videos;         ///< what `tt3d video-score --out` wrote
  std::string views_csv;    ///< rows of the evaluation (eval/builtin.csv), for the view spheres
  std::string curves_csv;   ///< step,loss,objective,rgb,chamfer,laplacian,edge,success
  std::string config_toml;  ///< effective configuration
  std::string run_json;     ///< versions, seed, stages [{name,seconds,peak_rss_bytes}], hashes
  std::string field_metrics_json;  ///< {"psnr_test"}
  std::string mesh_metrics_json;   ///< {"psnr_test","faces","closed"}
  std::vector<ReportView> views;   ///< contact sheet
};

/// The whole page. All text is escaped; nothing is loaded from elsewhere. Throws InputError for
/// JSON that does not parse, unreadable assets and pictures of the wrong shape.
[[nodiscard]] std::string render_report(const ReportInput& input);

/// A run, or any set of evaluations, on the page that compares many. All records are JSON.
struct ComparedRun {
  std::string name;
  std::vector<std::string> records;             ///< evaluations
  std::string run_json;                         ///< for the surrogates; may be empty
  std::vector<std::string> judge_records = {};  ///< what `tt3d judge --out` wrote
  std::vector<std::string> video_records = {};  ///< what `tt3d video-score --out` wrote
};

/// Rows of one kind as CSV and as a LaTeX tabular for booktabs.
struct ComparedTable {
  std::string file;  ///< name to write them to, without the ending
  std::string csv, latex;
};

/// The records of all runs as a page and as tables with the same numbers.
struct Comparison {
  std::string html;
  std::string json;  ///< an object with the rows of each table: victims, tasks, videos
  /// comparison: a row a run, renderer and victim; comparison-tasks: a run, task and phrase;
  /// comparison-videos: a run, video, victim and background. Without rows only the heading.
  std::vector<ComparedTable> tables;
};
/// Throws InputError for JSON that does not parse.
[[nodiscard]] Comparison compare_runs(const std::vector<ComparedRun>& runs);

/// Writes the page atomically. Throws as render_report, and ResourceError.
void write_report(const ReportInput& input, const std::filesystem::path& html);

}  // namespace tt3d
