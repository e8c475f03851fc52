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

/// A picture with a line of text below it.
struct ReportImage {
  std::string caption;
  at::Tensor image;  ///< [H,W,3] uint8, sRGB
};

/// What a victim says to one view of the adversarial object.
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

/// Everything the page shows. A text, path or list that is empty leaves its part out.
struct ReportInput {
  std::string title;
  std::filesystem::path clean_glb, adversarial_glb;  ///< shown turning in 3D, side by side
  std::string record_json;                           ///< evaluation record (eval/builtin.json)
  std::vector<std::string> other_records;  ///< evaluations by other renderers (eval/*.json)
  std::vector<std::string> judge_records;  ///< what `tt3d judge --out` wrote, JSON
  std::vector<std::string> video_records;  ///< what `tt3d video-score --out` wrote, JSON
  std::string views_csv;    ///< rows of the evaluation (eval/builtin.csv), for the view spheres
  std::string curves_csv;   ///< step,loss,objective,rgb,chamfer,laplacian,edge,success
  std::string config_toml;  ///< effective configuration
  std::string run_json;     ///< versions, seed, stages [{name,seconds,peak_rss_bytes}], hashes
  std::string field_metrics_json;   ///< {"psnr_test"}
  std::string mesh_metrics_json;    ///< {"psnr_test","faces","closed"}
  std::vector<ReportView> views;    ///< contact sheet
  std::vector<ReportImage> images;  ///< further pictures
};

/// The whole page. All text is escaped; nothing is loaded from elsewhere. Throws InputError for
/// JSON that does not parse, unreadable assets and pictures of the wrong shape.
[[nodiscard]] std::string render_report(const ReportInput& input);

/// A run, or any set of evaluations, on the page that compares many.
struct ComparedRun {
  std::string name;
  std::vector<std::string> records;  ///< evaluation records, JSON
  std::string run_json;              ///< for the surrogates; may be empty
};

/// One row a run, renderer and victim, in four forms with the same numbers. Throws InputError for
/// JSON that does not parse.
struct Comparison {
  std::string html, csv, json, latex;
};
[[nodiscard]] Comparison compare_runs(const std::vector<ComparedRun>& runs);

/// Writes the page atomically. Throws as render_report, and ResourceError.
void write_report(const ReportInput& input, const std::filesystem::path& html);

}  // namespace tt3d
