#include "html.h"

#include <ATen/ATen.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "page_parts.h"
#include "tt3d/core.h"
#include "tt3d/image.h"
#include "tt3d/version.h"

namespace tt3d::report {

std::string escape(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string fill(std::string_view text, const std::map<std::string, std::string>& values) {
  std::string out;
  size_t at = 0;
  for (size_t open = text.find("{{"); open != text.npos; open = text.find("{{", at)) {
    const size_t close = text.find("}}", open);
    if (close == text.npos) break;
    const std::string key(text.substr(open + 2, close - open - 2));
    const auto value = values.find(key);
    if (value == values.end()) throw std::logic_error("report template: no value for " + key);
    out.append(text.substr(at, open - at)).append(value->second);
    at = close + 2;
  }
  return out.append(text.substr(at));
}

std::string page(std::map<std::string, std::string> parts) {
  for (const char* part : {"headline", "objects", "results", "renderers", "tasks", "videos",
                           "spheres", "quality", "sheet", "curves", "stages", "provenance"}) {
    parts.try_emplace(part);
  }
  parts.try_emplace("style", kPageCss);
  parts.try_emplace("version", kVersion);
  return fill(kPageHtml, parts);
}

std::string head_cell(const std::string& html) { return "<th scope=\"col\">" + html + "</th>"; }

std::string row_head(const std::string& html) { return "<th scope=\"row\">" + html + "</th>"; }

std::string cell(const std::string& label, const std::string& html) {
  return "<td data-label=\"" + label + "\">" + html + "</td>";
}

std::string fact(const std::string& name, const std::string& value) {
  return "<div><dt>" + name + "</dt><dd>" + value + "</dd></div>\n";
}

std::string table(const std::string& name, const std::string& head, const std::string& body) {
  return "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"" + name +
         "\"><table class=\"results\"><thead><tr>" + head + "</tr></thead>\n<tbody>\n" + body +
         "</tbody></table></div>\n";
}

std::string section(std::string_view id, std::string_view title, const std::string& body) {
  if (body.empty()) return "";
  return fmt::format(
      "<section id=\"{0}\" aria-labelledby=\"{0}-title\">\n"
      "<h2 id=\"{0}-title\">{1}</h2>\n{2}</section>\n",
      id, escape(title), body);
}

std::string jpeg_address(const at::Tensor& image, int64_t max_size, int quality) {
  if (!image.defined() || image.dim() != 3 || image.size(2) != 3 || image.numel() == 0 ||
      image.scalar_type() != at::kByte) {
    throw InputError("report: pictures are [H,W,3] uint8 and not empty");
  }
  const int64_t longer = std::max(image.size(0), image.size(1));
  at::Tensor small = image.cpu();
  if (longer > max_size) {
    const auto side = [&](int64_t n) { return std::max<int64_t>(1, n * max_size / longer); };
    const at::Tensor planes = small.to(at::kFloat).div(255).permute({2, 0, 1}).contiguous();
    small =
        image::to_uint8(at::adaptive_avg_pool2d(planes, {side(image.size(0)), side(image.size(1))})
                            .permute({1, 2, 0})
                            .contiguous());
  }
  return "data:image/jpeg;base64," + base64(image::encode_jpeg(small.contiguous(), quality));
}

std::string percent(double share) { return fmt::format("{:.1f}\u00a0%", 100 * share); }

std::string thousands(int64_t number) {
  std::string digits = std::to_string(number);
  const auto first = static_cast<int64_t>(number < 0 ? 1 : 0);
  for (int64_t at = static_cast<int64_t>(digits.size()) - 3; at > first; at -= 3) {
    digits.insert(static_cast<size_t>(at), 1, ',');
  }
  return digits;
}

std::string duration(double seconds) {
  if (seconds < 60) return fmt::format("{:.1f}\u00a0s", seconds);
  const auto whole = static_cast<int64_t>(std::llround(seconds));
  if (whole < 3600) return fmt::format("{}\u00a0min {:02}\u00a0s", whole / 60, whole % 60);
  return fmt::format("{}\u00a0h {:02}\u00a0min", whole / 3600, whole % 3600 / 60);
}

}  // namespace tt3d::report
