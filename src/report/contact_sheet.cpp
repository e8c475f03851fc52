#include "contact_sheet.h"

#include <fmt/format.h>

#include "html.h"

namespace tt3d::report {
namespace {

constexpr int64_t kThumbnail = 224;  ///< pixels
constexpr int kQuality = 85;

std::string picture(const at::Tensor& image, const std::string& alt) {
  return fmt::format("<img src=\"{}\" alt=\"{}\" loading=\"lazy\">",
                     jpeg_address(image, kThumbnail, kQuality), escape(alt));
}

std::string where(const ShownView& view) {
  return fmt::format("azimuth {:.0f}\u00b0, elevation {:.0f}\u00b0", view.azimuth_deg,
                     view.elevation_deg);
}

/// An answer; the target class differs in colour, symbol and spoken text.
std::string answer_row(const record::Answer& answer) {
  return fmt::format(
      "<li class=\"{}\"><span class=\"victim\">{}</span><span class=\"answer\">"
      "<span class=\"mark\" aria-hidden=\"true\">{}</span>"
      "<span class=\"spoken\">{} </span>{} <b>{:.0f}\u00a0%</b></span></li>",
      answer.is_target ? "hit" : "miss", escape(answer.victim),
      answer.is_target ? "\u25c9" : "\u25cb",
      answer.is_target ? "target:" : "not the target:", escape(answer.answer),
      100 * answer.probability);
}

std::string answer_list(const std::vector<record::Answer>& answers) {
  std::string html = "<ul>";
  for (const record::Answer& answer : answers) html += answer_row(answer);
  return html + "</ul>";
}

/// The legend of the marks.
std::string marks_legend(const std::string& target) {
  const std::string name = target.empty() ? "the target class" : "\u201c" + target + "\u201d";
  return "<span class=\"hit key\"><span class=\"mark\" aria-hidden=\"true\">\u25c9</span> "
         "answers " +
         escape(name) +
         "</span> <span class=\"miss key\"><span class=\"mark\" aria-hidden=\"true\">\u25cb</span> "
         "another answer</span>";
}

std::string frame_card(const ShownFrame& frame) {
  std::string when = fmt::format("{:.1f}\u00a0s", frame.seconds);
  if (!frame.background.empty()) when += ", " + frame.background;
  return "<li class=\"view\">" + picture(frame.picture, "frame at " + when) + "<p>" + escape(when) +
         "</p>" + answer_list(frame.answers) + "</li>\n";
}

std::string card(const ShownView& view) {
  std::string html = "<figure class=\"view\"><div class=\"pair\">";
  if (view.clean.defined()) {
    html += "<div>" + picture(view.clean, "clean object, " + where(view)) + "<i>clean</i></div>";
  }
  html += "<div>" + picture(view.adversarial, "adversarial object, " + where(view)) +
          "<i>adversarial</i></div></div>\n<figcaption>" + where(view) + "</figcaption>\n";
  return html + answer_list(view.answers) + "</figure>\n";
}

}  // namespace

std::string contact_sheet(const std::vector<ShownView>& views, const std::string& target) {
  if (views.empty()) return "";
  std::string html = "<p>The answer of each model for the adversarial picture. " +
                     marks_legend(target) + "</p>\n<div class=\"sheet\">\n";
  for (const ShownView& view : views) html += card(view);
  return html + "</div>\n";
}

std::string frame_strip(const std::vector<ShownFrame>& frames, const std::string& video,
                        const std::string& target) {
  if (frames.empty()) return "";
  std::string html =
      "<p>The answer of each model for a frame. " + marks_legend(target) +
      "</p>\n<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Frames of " + video +
      "\"><ol class=\"strip\">\n";
  for (const ShownFrame& frame : frames) html += frame_card(frame);
  return html + "</ol></div>\n";
}

}  // namespace tt3d::report
