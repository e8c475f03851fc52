#pragma once

/// Names of files in a run folder that several stages use.
namespace tt3d::run {

/// State of an interrupted stage, in the folder of the stage.
inline constexpr const char* kCheckpoint = "checkpoint.safetensors";

}  // namespace tt3d::run
