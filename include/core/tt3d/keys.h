#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "tt3d/enums.h"

/// Configuration keys. An options struct declares its keys once, in its member function `keys`:
///
///     struct BlurOptions {
///       double sigma = 1;
///       void keys(KeyList& key) { key("sigma", sigma, {0, 10}, "pixels", "largest sigma"); }
///     };
///
/// The command line, TOML files, `run.json`, `tt3d config` and the tables of the documentation all
/// read these declarations.
namespace tt3d {

/// The value of a key. Enums and paths are strings.
using KeyValue =
    std::variant<bool, int64_t, double, std::string, std::vector<std::string>, std::vector<double>>;

/// One key, bound to a member of an options struct.
struct Key {
  std::string name;     ///< full name with its groups: "attack.eot.blur"
  std::string meaning;  ///< description, one line
  std::string unit;     ///< empty: none
  std::string range;    ///< accepted values; empty: every value of the type
  bool path = false;    ///< true for a file or folder; relative paths in a file are relative to its
                        ///< folder
  std::function<KeyValue()> get;
  /// Throws InputError "expected ..." and leaves the member as it is.
  std::function<void(const KeyValue&)> set;
};

/// The lowest and the highest accepted value; both are included.
struct KeyRange {
  double low, high;
};

/// Collects the keys of options structs, in the order of their declaration.
class KeyList {
 public:
  [[nodiscard]] const std::vector<Key>& all() const& { return keys_; }
  [[nodiscard]] std::vector<Key> all() && { return std::move(keys_); }
  /// The key with this name. Throws InputError that names the nearest key.
  [[nodiscard]] const Key& find(const std::string& name) const;

  /// Adds the keys of `options` with the names GROUP.KEY.
  template <typename Options>
  void group(const std::string& name, Options& options) {
    const std::string outer = prefix_;
    prefix_ += name + ".";
    options.keys(*this);
    prefix_ = outer;
  }

  void operator()(const char* name, bool& member, const char* meaning);
  void operator()(const char* name, int64_t& member, KeyRange range, const char* unit,
                  const char* meaning);
  void operator()(const char* name, int& member, KeyRange range, const char* unit,
                  const char* meaning);
  void operator()(const char* name, uint64_t& member, KeyRange range, const char* unit,
                  const char* meaning);
  void operator()(const char* name, double& member, KeyRange range, const char* unit,
                  const char* meaning);
  void operator()(const char* name, std::string& member, const char* meaning);
  void operator()(const char* name, std::filesystem::path& member, const char* meaning);
  void operator()(const char* name, std::vector<std::string>& member, const char* meaning);
  void operator()(const char* name, std::vector<double>& member, KeyRange range,
                  const char* meaning);
  /// One of the names of an enum.
  template <NamedEnum E>
  void operator()(const char* name, E& member, const char* meaning) {
    choice(
        name, names_of<E>(), meaning, [&member] { return name_of(member); },
        [&member](const std::string& text) { member = parse_enum<E>(text); });
  }
  /// Some of the names of an enum.
  template <NamedEnum E>
  void operator()(const char* name, std::vector<E>& member, const char* meaning) {
    choices(
        name, names_of<E>(), meaning,
        [&member] {
          std::vector<std::string> texts;
          texts.reserve(member.size());
          for (const E e : member) texts.push_back(name_of(e));
          return texts;
        },
        [&member](const std::vector<std::string>& texts) {
          std::vector<E> values;
          values.reserve(texts.size());
          for (const std::string& text : texts) values.push_back(parse_enum<E>(text));
          member = values;
        });
  }
  /// One of several names that are known only at run time.
  void one_of(const char* name, std::string& member, const std::vector<std::string>& names,
              const char* meaning);

 private:
  void choice(const char* name, const std::vector<std::string>& names, const char* meaning,
              const std::function<std::string()>& get,
              const std::function<void(const std::string&)>& set);
  void choices(const char* name, const std::vector<std::string>& names, const char* meaning,
               const std::function<std::vector<std::string>()>& get,
               const std::function<void(const std::vector<std::string>&)>& set);
  template <typename T>
  void integer(const char* name, T& member, KeyRange range, const char* unit, const char* meaning);
  void add(Key key) { keys_.push_back(std::move(key)); }

  std::string prefix_;
  std::vector<Key> keys_;
};

}  // namespace tt3d
