#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "tt3d/config.h"
#include "tt3d/keys.h"

/// Command-line options for configuration keys. Description, unit, range and default come from the
/// declaration of the key.
namespace tt3d::cli {

/// Adds the option `flag`, which sets the key `name` of `keys`. The options behind `keys` must
/// outlive the parsing.
CLI::Option* add_key_option(CLI::App& command, const std::string& flag, const KeyList& keys,
                            const std::string& name);

/// Adds the option `flag`, which appends an assignment of the configuration key `name`. Relative
/// paths become absolute.
CLI::Option* add_assignment(CLI::App& command, const std::string& flag, const std::string& name,
                            std::vector<run::Assignment>& assignments);

}  // namespace tt3d::cli
