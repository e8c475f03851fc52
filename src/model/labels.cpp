#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <sstream>

#include "card.h"
#include "imagenet_table.h"

namespace tt3d::model {
namespace {

std::vector<std::string> split_names(const std::string& text) {
  std::vector<std::string> names;
  for (size_t start = 0; start <= text.size();) {
    const size_t end = std::min(text.find(", ", start), text.size());
    names.push_back(text.substr(start, end - start));
    start = end + 2;
  }
  return names;
}

std::vector<ImagenetClass> parse_table() {
  std::vector<ImagenetClass> classes;
  std::istringstream lines(kImagenetTable);
  std::string index, wnid, names;
  while (std::getline(lines, index, '\t') && std::getline(lines, wnid, '\t') &&
         std::getline(lines, names)) {
    classes.push_back({wnid, split_names(names)});
  }
  return classes;
}

}  // namespace

const std::vector<ImagenetClass>& imagenet_classes() {
  static const std::vector<ImagenetClass> classes = parse_table();
  return classes;
}

namespace {

constexpr size_t kListed = 8;

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

/// All names of a class, lower case.
std::vector<std::string> names_of(const ModelCard& card, size_t index) {
  std::vector<std::string> names{lower(card.labels[index])};
  if (card.wnids.empty()) return names;
  const auto& synonyms = model::imagenet_classes()[index].names;
  std::string whole;
  for (const std::string& name : synonyms) {
    names.push_back(lower(name));
    whole += (whole.empty() ? "" : ", ") + names.back();
  }
  names.push_back(whole);
  return names;
}

ClassId class_at(const ModelCard& card, size_t index) {
  return {static_cast<int64_t>(index), card.wnids.empty() ? "" : card.wnids[index],
          card.labels[index]};
}

std::string describe(const ClassId& one) {
  return fmt::format("{}{} {}", one.index, one.wnid.empty() ? "" : " " + one.wnid, one.name);
}

bool is_number(const std::string& text) {
  return !text.empty() && text.size() < 10 &&
         std::all_of(text.begin(), text.end(), [](unsigned char c) { return std::isdigit(c); });
}

bool is_wnid(const std::string& text) {
  return text.size() == 9 && text[0] == 'n' && is_number(text.substr(1));
}

ClassId class_of_number(const std::string& text, const ModelCard& card) {
  const auto index = static_cast<size_t>(std::stol(text));
  if (index < card.labels.size()) return class_at(card, index);
  throw InputError(fmt::format("class {}: model {} has classes 0 to {}", text, card.name,
                               card.labels.size() - 1));
}

ClassId class_of_wnid(const std::string& text, const ModelCard& card) {
  const auto found = std::find(card.wnids.begin(), card.wnids.end(), text);
  if (found != card.wnids.end()) {
    return class_at(card, static_cast<size_t>(found - card.wnids.begin()));
  }
  throw InputError(
      fmt::format("class '{}': not a WordNet id that model {} knows", text, card.name));
}

/// The nearest name, and names that contain the word.
std::string suggestions(const std::string& word, const ModelCard& card) {
  std::vector<std::string> all, near;
  for (size_t i = 0; i < card.labels.size(); ++i) {
    for (const std::string& name : names_of(card, i)) {
      all.push_back(name);
      const bool holds = word.size() > 2 && name.find(word) != std::string::npos;
      if (holds && near.size() < kListed && name.find(", ") == std::string::npos) {
        near.push_back(name);
      }
    }
  }
  const std::string nearest = nearest_name(word, all);
  if (!nearest.empty()) near.insert(near.begin(), nearest);
  std::string text;
  for (const std::string& name : near) {
    if (text.find("'" + name + "'") == std::string::npos) {
      text += (text.empty() ? "'" : ", '") + name + "'";
    }
  }
  return text;
}

}  // namespace

namespace {

std::string trimmed(const std::string& text) {
  const size_t from = text.find_first_not_of(' ');
  if (from == std::string::npos) return "";
  return text.substr(from, text.find_last_not_of(' ') + 1 - from);
}

/// True if `name` stands for the label set of a card.
bool is_label_set(const std::string& name, const ModelCard& card) {
  const std::string word = lower(name), set = lower(card.label_set);
  if (word.empty()) return false;
  return word == set || word == set.substr(0, set.find('-')) || word == lower(card.name);
}

/// True if `text` is a list of classes, one for each label set: SET=CLASS,SET=CLASS.
bool names_label_sets(const std::string& text) {
  const size_t equals = text.find('=');
  return equals != std::string::npos && equals < text.find(',');
}

/// A class for each label set, in the order given. A comma without '=' belongs to the class name.
std::vector<std::pair<std::string, std::string>> classes_by_set(const std::string& text) {
  std::vector<std::pair<std::string, std::string>> classes;
  for (size_t start = 0; start < text.size();) {
    const size_t equals = text.find('=', start);
    const size_t next = text.find('=', equals + 1);
    const size_t end = next == std::string::npos ? text.size() : text.rfind(',', next);
    if (end == std::string::npos || end <= equals + 1) {
      throw InputError(fmt::format("class '{}': expected SET=CLASS,SET=CLASS", text));
    }
    classes.emplace_back(trimmed(text.substr(start, equals - start)),
                         trimmed(text.substr(equals + 1, end - equals - 1)));
    start = end + 1;
  }
  return classes;
}

std::string class_for(const std::string& text, const ModelCard& card) {
  for (const auto& [set, one] : classes_by_set(text)) {
    if (is_label_set(set, card)) return one;
  }
  const std::string name = card.label_set.empty() ? card.name : card.label_set;
  throw InputError(fmt::format("class '{}': has no class for model {}; add {}=CLASS", text,
                               card.name, name.substr(0, name.find('-'))));
}

}  // namespace

void check_same_class(const std::string& text, const std::vector<const ModelCard*>& cards,
                      const std::string& option) {
  if (!is_number(text)) return;
  for (const ModelCard* card : cards) {
    if (card->labels == cards.front()->labels) continue;
    throw InputError(
        fmt::format("{} {}: an index means another class in {} than in {}, because their labels "
                    "differ; give a name, or SET=CLASS,SET=CLASS (docs/model.md)",
                    option, text, card->name, cards.front()->name));
  }
}

ClassId find_class(const std::string& text, const ModelCard& card) {
  if (names_label_sets(text)) return find_class(class_for(text, card), card);
  if (is_number(text)) return class_of_number(text, card);
  if (is_wnid(text)) return class_of_wnid(text, card);
  const std::string word = lower(text);
  std::vector<ClassId> found;
  for (size_t i = 0; i < card.labels.size(); ++i) {
    const auto names = names_of(card, i);
    if (std::find(names.begin(), names.end(), word) != names.end()) {
      found.push_back(class_at(card, i));
    }
  }
  if (found.size() == 1) return found.front();
  if (found.empty()) {
    const std::string near = suggestions(word, card);
    throw InputError(fmt::format("class '{}': model {} has no such class{}", text, card.name,
                                 near.empty() ? "" : "; near: " + near));
  }
  std::string candidates;
  for (const ClassId& one : found) {
    candidates += (candidates.empty() ? "" : "; ") + describe(one);
  }
  throw InputError(fmt::format("class '{}' is ambiguous, give the index: {}", text, candidates));
}

}  // namespace tt3d::model
