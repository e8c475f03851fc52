#include "key_options.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <functional>

namespace tt3d::cli {
namespace {

std::string description(const Key& key) {
  std::string text = key.meaning;
  if (!key.unit.empty() && key.unit != "path") text += " [" + key.unit + "]";
  const bool listed = !key.range.empty() && !key.range.starts_with("list of strings");
  return listed ? text + " (" + key.range + ")" : text;
}

/// The default in the help text; empty if the help text shows none.
std::string shown_default(const KeyValue& value) {
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  if (const auto* number = std::get_if<int64_t>(&value)) return std::to_string(*number);
  if (const auto* number = std::get_if<double>(&value)) return fmt::format("{}", *number);
  return "";
}

/// Converts a text to a value of the type of the key. Throws InputError that names the option.
KeyValue parse(const std::string& flag, const Key& key, const std::string& text) {
  const KeyValue now = key.get();
  if (std::holds_alternative<std::string>(now)) {
    const bool relative = key.path && !text.empty();
    return relative ? std::filesystem::absolute(text).string() : text;
  }
  try {
    return run::parse_assignment("value=" + text).value;
  } catch (const InputError&) {
    throw InputError(flag + " " + text + ": expected " + key.range);
  }
}

using Take = std::function<void(const KeyValue&)>;

CLI::Option* add_option(CLI::App& command, const std::string& flag, const Key& key,
                        const Take& take) {
  const KeyValue now = key.get();
  if (std::holds_alternative<bool>(now)) {
    return command.add_flag_callback(
        flag, [take] { take(true); }, key.meaning);
  }
  if (std::holds_alternative<std::vector<std::string>>(now)) {
    return command.add_option_function<std::vector<std::string>>(
        flag, [take](const std::vector<std::string>& texts) { take(texts); }, description(key));
  }
  CLI::Option* option = command.add_option_function<std::string>(
      flag, [flag, key, take](const std::string& text) { take(parse(flag, key, text)); },
      description(key));
  if (std::holds_alternative<int64_t>(now)) option->type_name("INT");
  if (std::holds_alternative<double>(now)) option->type_name("FLOAT");
  const std::string text = shown_default(now);
  if (!text.empty()) option->default_str(text);
  return option;
}

}  // namespace

CLI::Option* add_key_option(CLI::App& command, const std::string& flag, const KeyList& keys,
                            const std::string& name) {
  const Key& key = keys.find(name);
  return add_option(command, flag, key, [flag, key](const KeyValue& value) {
    try {
      key.set(value);
    } catch (const InputError& error) {
      throw InputError(flag + ": " + error.what());
    }
  });
}

CLI::Option* add_assignment(CLI::App& command, const std::string& flag, const std::string& name,
                            std::vector<run::Assignment>& assignments) {
  run::RunConfig defaults;
  const Key key = run::keys_of(defaults).find(name);
  // The key is bound to `defaults`. Use only its declaration and the type of its value.
  Key declared = key;
  declared.get = [value = key.get()] { return value; };
  declared.set = nullptr;
  return add_option(command, flag, declared, [&assignments, name](const KeyValue& value) {
    assignments.push_back({name, value});
  });
}

}  // namespace tt3d::cli
