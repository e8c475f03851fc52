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

std::string where(const ReportView& view) {
  return fmt::format("azimuth {:.0f}\u00b0, elevation {:.0f}\u00b0", view.azimuth_deg,
                     view.elevation_deg);
}

/// A target hit differs in colour, symbol and spoken text.
std::string answer_row(const ReportVictimAnswer& answer) {
  return fmt::format(
      "<li class=\"{}\"><span class=\"victim\">{}</span><span class=\"answer\">"
      "<span class=\"mark\" aria-hidden=\"true\">{}</span>"
      "<span class=\"spoken\">{} </span>{} <b>{:.0f}\u00a0%</b></span></li>",
      answer.is_target ? "hit" : "miss", escape(answer.victim),
      answer.is_target ? "\u25c9" : "\u25cb",
      answer.is_target ? "target:" : "not the target:", escape(answer.answer),
      100 * answer.probability);
}

std::string card(const ReportView& view) {
  std::string html = "<figure class=\"view\"><div class=\"pair\">";
  if (view.clean.defined()) {
    html += "<div>" + picture(view.clean, "clean object, " + where(view)) + "<i>clean</i></div>";
  }
  html += "<div>" + picture(view.adversarial, "adversarial object, " + where(view)) +
          "<i>adversarial</i></div></div>\n<figcaption>" + where(view) + "</figcaption>\n<ul>";
  for (const ReportVictimAnswer& answer : view.answers) html += answer_row(answer);
  return html + "</ul></figure>\n";
}

}  // namespace

std::string contact_sheet(const std::vector<ReportView>& views, const std::string& target) {
  if (views.empty()) return "";
  const std::string name = target.empty() ? "the target class" : "\u201c" + target + "\u201d";
  std::string html =
      "<p>What each model says to the adversarial picture. <span class=\"hit key\">"
      "<span class=\"mark\" aria-hidden=\"true\">\u25c9</span> says " +
      escape(name) +
      "</span> <span class=\"miss key\"><span class=\"mark\" aria-hidden=\"true\">\u25cb</span> "
      "says something else</span></p>\n<div class=\"sheet\">\n";
  for (const ReportView& view : views) html += card(view);
  return html + "</div>\n";
}

std::string gallery(const std::vector<ReportImage>& images) {
  if (images.empty()) return "";
  std::string html = "<div class=\"sheet\">\n";
  for (const ReportImage& one : images) {
    html += "<figure class=\"view\">" + picture(one.image, one.caption) + "<figcaption>" +
            escape(one.caption) + "</figcaption></figure>\n";
  }
  return html + "</div>\n";
}

}  // namespace tt3d::report
