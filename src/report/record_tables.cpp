#include "record_tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <set>

#include "contact_sheet.h"
#include "figures.h"
#include "html.h"

namespace tt3d::report {
namespace {

std::string renderer_words(const record::RendererRecord& renderer) {
  return escape(renderer.name) + (renderer.lit ? ", lit" : ", unlit");
}

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

/// The synonyms of a class: "hen, biddy" has two.
std::set<std::string> names_in(const record::ClassId& id) {
  std::set<std::string> names;
  std::string name;
  for (const char c : id.name + ",") {
    if (c == ',') {
      if (!name.empty()) names.insert(lower(name));
      name.clear();
    } else if (c != ' ' || !name.empty()) {
      name += c;
    }
  }
  return names;
}

/// A phrase, followed by the badge "target" or "true class".
std::string marked_phrase(const std::string& phrase, const OwnEvaluation& own) {
  const std::string role = phrase_role(phrase, own);
  if (role.empty()) return escape(phrase);
  return fmt::format("{} <span class=\"role {}\">{}</span>", escape(phrase),
                     role == "target" ? "seen" : "unseen", role);
}

/// A share, followed by its number of frames.
std::string share_of_frames(const record::FrameShare& share) {
  return fmt::format("<b>{}</b> <span class=\"interval\">of {}</span>", percent(share.asr),
                     share.frames);
}

/// The background labels of a video, in the order of its first victim.
std::vector<std::string> labels_of(const record::VideoRecord& video) {
  std::vector<std::string> labels;
  for (const record::VideoVictim& victim : video.victims) {
    for (const auto& [label, share] : victim.backgrounds) {
      if (std::find(labels.begin(), labels.end(), label) == labels.end()) labels.push_back(label);
    }
  }
  return labels;
}

std::string video_table(const record::VideoRecord& video, const std::string& name) {
  const std::vector<std::string> labels = labels_of(video);
  const auto shown = [](const std::string& label) {
    return label.empty() ? std::string("no label") : escape(label);
  };
  std::string head = head_cell("model") + head_cell("all frames"), body;
  for (const std::string& label : labels) head += head_cell(shown(label));
  for (const record::VideoVictim& victim : video.victims) {
    body +=
        "<tr>" + row_head(escape(victim.name)) + cell("all frames", share_of_frames(victim.all));
    for (const std::string& label : labels) {
      const auto share = victim.backgrounds.find(label);
      body += cell(shown(label),
                   share == victim.backgrounds.end() ? kDash : share_of_frames(share->second));
    }
    body += "</tr>\n";
  }
  return table("Video " + name, head, body);
}

std::string geometry_facts(const record::GeometryRecord& g) {
  return fact("Chamfer distance", fmt::format("{:.3g}", g.chamfer)) +
         fact("Hausdorff distance", fmt::format("{:.3g}", g.hausdorff)) +
         fact("Mean turn of normals", fmt::format("{:.1f}\u00b0", g.normal_deviation_deg)) +
         fact("Self-intersecting faces", std::to_string(g.self_intersecting_faces)) +
         fact("Self-intersecting, clean", std::to_string(g.self_intersecting_faces_clean));
}

/// The rate of the model with that name, or a dash.
std::string rate_of(const record::EvaluationRecord& evaluation, const std::string& model) {
  for (const record::VictimRecord& victim : evaluation.victims) {
    if (victim.name == model) return percent(victim.asr);
  }
  return kDash;
}

}  // namespace

std::string phrase_role(const std::string& phrase, const OwnEvaluation& own) {
  if (!own) return "";
  if (names_in(own->target).contains(lower(phrase))) return "target";
  const bool named = own->true_class && names_in(*own->true_class).contains(lower(phrase));
  return named ? "true class" : "";
}

std::string task_words(const std::string& task) {
  if (task == "detect") return "detection";
  if (task == "caption") return "captions";
  return task == "zeroshot" ? "zero-shot classification" : task;
}

std::string renderer_table(const OwnEvaluation& own,
                           const std::vector<record::EvaluationRecord>& others) {
  if (others.empty() || !own) return "";
  std::vector<const record::EvaluationRecord*> all = {&*own};
  for (const record::EvaluationRecord& other : others) all.push_back(&other);
  std::string head = head_cell("renderer and background"), body;
  for (const record::VictimRecord& victim : own->victims) head += head_cell(escape(victim.name));
  for (const record::EvaluationRecord* e : all) {
    // Records of slow renderers often have fewer views.
    body += "<tr>" + row_head(fmt::format("{}, {}, {} views", renderer_words(e->renderer),
                                          escape(e->background), e->views.count));
    for (const record::VictimRecord& victim : own->victims) {
      body += cell(escape(victim.name), rate_of(*e, victim.name));
    }
    body += "</tr>\n";
  }
  return table("By renderer", head, body);
}

std::string task_table(const std::vector<record::JudgeRecord>& judges, const OwnEvaluation& own) {
  std::string head, body;
  for (const record::JudgeRecord& judge : judges) {
    for (const auto& [phrase, share] : judge.shares) {
      body += "<tr>" + row_head(escape(task_words(judge.task))) +
              cell("phrase", marked_phrase(phrase, own)) +
              cell("found in", "<b>" + percent(share) + "</b>") +
              cell("views", std::to_string(judge.views.count)) +
              cell("renderer", renderer_words(judge.renderer)) +
              cell("model", escape(std::filesystem::path(judge.model).filename().string())) +
              "</tr>\n";
    }
  }
  if (body.empty()) return "";
  for (const char* name : {"task", "phrase", "found in", "views", "renderer", "model"}) {
    head += head_cell(name);
  }
  return table("By task", head, body) +
         "<p class=\"note\">Models of other tasks, run on views of the adversarial object: the "
         "share of views in which each phrase was found.</p>\n";
}

std::string video_parts(const std::vector<ShownVideo>& videos) {
  if (videos.empty()) return "";
  std::string html =
      "<p>The share of sampled frames that each model assigns to the target class, over all and by "
      "background.</p>\n";
  for (const ShownVideo& video : videos) {
    const std::string name = escape(std::filesystem::path(video.record.video).filename().string());
    html += "<h3>" + name + "</h3>\n" + video_table(video.record, name) +
            frame_strip(video.frames, name, video.record.target.name);
  }
  return html;
}

std::string geometry_list(const OwnEvaluation& own,
                          const std::vector<record::EvaluationRecord>& others) {
  std::string facts;
  if (own && own->geometry) facts = geometry_facts(*own->geometry);
  for (const record::EvaluationRecord& other : others) {
    if (facts.empty() && other.geometry) facts = geometry_facts(*other.geometry);
  }
  if (facts.empty()) return "";
  return "<h3>Shape against the clean object</h3>\n<dl class=\"quality\">\n" + facts +
         "</dl>\n<p class=\"note\">Distances in the object's units.</p>\n";
}

}  // namespace tt3d::report
