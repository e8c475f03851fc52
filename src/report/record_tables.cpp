#include "record_tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <set>

#include "contact_sheet.h"

namespace tt3d::report {
namespace {

constexpr const char* kNone = "\u2013";

std::string renderer_words(const Json& record) {
  const Json renderer = member(record, "renderer"), lit = member(renderer, "lit");
  return escape(text(renderer, "name")) +
         (lit.is_boolean() && lit.get<bool>() ? ", lit" : ", unlit");
}

/// How many views a record is of: fewer than the run's own is common, as renderers are slow.
std::string view_words(const Json& record) {
  const auto views = number(member(record, "views"), "count");
  return views ? fmt::format(", {:.0f} views", *views) : "";
}

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

/// The synonyms of a class: "hen, biddy" are two.
std::set<std::string> names_of(const Json& category) {
  std::set<std::string> names;
  std::string name;
  for (const char c : text(category, "name") + ",") {
    if (c == ',') {
      if (!name.empty()) names.insert(lower(name));
      name.clear();
    } else if (c != ' ' || !name.empty()) {
      name += c;
    }
  }
  return names;
}

/// A phrase with "target" or "true class" as a mark behind it.
std::string marked_phrase(const std::string& phrase, const Json& own) {
  const std::string role = phrase_role(phrase, own);
  if (role.empty()) return escape(phrase);
  return fmt::format("{} <span class=\"role {}\">{}</span>", escape(phrase),
                     role == "target" ? "seen" : "unseen", role);
}

/// A share with the number of frames it is of.
std::string share_of_frames(const Json& share) {
  const auto asr = number(share, "asr"), frames = number(share, "frames");
  if (!asr || !frames) return kNone;
  return fmt::format("<b>{}</b> <span class=\"interval\">of {:.0f}</span>", percent(*asr), *frames);
}

/// The background labels of a video, in the order of its first victim.
std::vector<std::string> labels_of(const Json& video) {
  std::vector<std::string> labels;
  for (const Json& victim : member(video, "victims")) {
    const Json groups = member(victim, "backgrounds");
    for (const auto& [label, share] : groups.items()) {
      if (std::find(labels.begin(), labels.end(), label) == labels.end()) labels.push_back(label);
    }
  }
  return labels;
}

std::string video_name(const Json& video) {
  return escape(std::filesystem::path(text(video, "video")).filename().string());
}

std::string video_table(const Json& video) {
  const std::vector<std::string> labels = labels_of(video);
  const auto shown = [](const std::string& label) {
    return label.empty() ? std::string("no label") : escape(label);
  };
  std::string head = head_cell("model") + head_cell("all frames"), body;
  for (const std::string& label : labels) head += head_cell(shown(label));
  for (const Json& victim : member(video, "victims")) {
    body += "<tr>" + row_head(escape(text(victim, "name"))) +
            cell("all frames", share_of_frames(victim));
    const Json groups = member(victim, "backgrounds");
    for (const std::string& label : labels) {
      body += cell(shown(label), share_of_frames(member(groups, label)));
    }
    body += "</tr>\n";
  }
  return table("Video " + video_name(video), head, body);
}

std::string fact(const std::string& name, const std::string& value) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd></div>\n";
}

std::string geometry_facts(const Json& geometry) {
  std::string facts;
  const auto add = [&](const char* name, const char* key, const char* format) {
    if (const auto value = number(geometry, key)) {
      facts += fact(name, fmt::format(fmt::runtime(format), *value));
    }
  };
  add("Chamfer distance", "chamfer", "{:.3g}");
  add("Hausdorff distance", "hausdorff", "{:.3g}");
  add("Mean turn of normals", "normal_deviation_deg", "{:.1f}\u00b0");
  add("Self-intersecting faces", "self_intersecting_faces", "{:.0f}");
  add("Self-intersecting, clean", "self_intersecting_faces_clean", "{:.0f}");
  return facts;
}

}  // namespace

std::string phrase_role(const std::string& phrase, const Json& own) {
  if (names_of(member(own, "target")).contains(lower(phrase))) return "target";
  return names_of(member(own, "true_class")).contains(lower(phrase)) ? "true class" : "";
}

std::string task_words(const std::string& task) {
  if (task == "detect") return "detection";
  if (task == "caption") return "captions";
  return task == "zeroshot" ? "zero-shot classification" : task;
}

std::string renderer_table(const Json& own, const std::vector<std::string>& others) {
  if (others.empty()) return "";
  std::vector<Json> records = {own};
  for (const std::string& text : others) {
    records.push_back(parse_json(text, "another renderer's record"));
  }
  std::string head = head_cell("renderer and background"), body;
  for (const Json& victim : member(own, "victims")) head += head_cell(escape(text(victim, "name")));
  for (const Json& record : records) {
    body += "<tr>" + row_head(renderer_words(record) + ", " + escape(text(record, "background")) +
                              view_words(record));
    for (const Json& victim : member(own, "victims")) {
      std::optional<double> rate;
      for (const Json& other : member(record, "victims")) {
        if (text(other, "name") == text(victim, "name")) rate = number(other, "asr");
      }
      body += cell(escape(text(victim, "name")), rate ? percent(*rate) : kNone);
    }
    body += "</tr>\n";
  }
  return table("By renderer", head, body);
}

std::string task_table(const std::vector<std::string>& judges, const Json& own) {
  std::string body;
  for (const std::string& judge : judges) {
    const Json record = parse_json(judge, "a judge's record");
    const Json shares = member(record, "shares");
    const auto views = number(member(record, "views"), "count");
    for (const auto& [phrase, share] : shares.items()) {
      body +=
          "<tr>" + row_head(escape(task_words(text(record, "task")))) +
          cell("phrase", marked_phrase(phrase, own)) +
          cell("found in",
               share.is_number() ? "<b>" + percent(share.get<double>()) + "</b>" : kNone) +
          cell("views", views ? fmt::format("{:.0f}", *views) : kNone) +
          cell("renderer", renderer_words(record)) +
          cell("model", escape(std::filesystem::path(text(record, "model")).filename().string())) +
          "</tr>\n";
    }
  }
  if (body.empty()) return "";
  std::string head;
  for (const char* name : {"task", "phrase", "found in", "views", "renderer", "model"}) {
    head += head_cell(name);
  }
  return table("By task", head, body) +
         "<p class=\"note\">Models that do other work than classify, asked about views of the "
         "adversarial object: the share in which each phrase was found.</p>\n";
}

std::string video_parts(const std::vector<ReportVideo>& videos) {
  if (videos.empty()) return "";
  std::string html =
      "<p>The share of sampled frames that each model assigns to the target class, over all and by "
      "background.</p>\n";
  for (const ReportVideo& video : videos) {
    const Json record = parse_json(video.record_json, "a video's record");
    const std::string name = video_name(record);
    html += "<h3>" + name + "</h3>\n" + video_table(record) +
            frame_strip(video.frames, name, text(member(record, "target"), "name"));
  }
  return html;
}

std::string geometry_list(const Json& own, const std::vector<std::string>& others) {
  std::string facts = geometry_facts(member(own, "geometry"));
  for (size_t i = 0; i < others.size() && facts.empty(); ++i) {
    facts = geometry_facts(member(parse_json(others[i], "another record"), "geometry"));
  }
  if (facts.empty()) return "";
  return "<h3>Shape against the clean object</h3>\n<dl class=\"quality\">\n" + facts +
         "</dl>\n<p class=\"note\">Distances in the object's units.</p>\n";
}

}  // namespace tt3d::report
