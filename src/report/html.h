#pragma once

#include <ATen/core/Tensor.h>

#include <map>
#include <string>
#include <string_view>

/// Small helpers to write HTML.
namespace tt3d::report {

/// Joins the ends of a range, and stands for a value that is absent.
inline constexpr const char* kDash = "\u2013";

/// Escapes text for HTML: & < > " ' become entities. For content and quoted attributes.
[[nodiscard]] std::string escape(std::string_view text);

/// Replaces each {{key}} of a template by its value. Values are HTML and are not expanded again.
/// Throws std::logic_error for a key without a value.
[[nodiscard]] std::string fill(std::string_view text,
                               const std::map<std::string, std::string>& values);

/// <section id="..."><h2>title</h2>body</section>, or "" for an empty body.
[[nodiscard]] std::string section(std::string_view id, std::string_view title,
                                  const std::string& body);

/// Fills the template of the page; sections without a value are left out.
[[nodiscard]] std::string page(std::map<std::string, std::string> parts);

/// Cells of a table; the content is HTML. `label`: name of the column, shown when a narrow page
/// stacks the cells.
[[nodiscard]] std::string head_cell(const std::string& html);
[[nodiscard]] std::string row_head(const std::string& html);
[[nodiscard]] std::string cell(const std::string& label, const std::string& html);
/// One entry of a <dl>: name and value, both HTML.
[[nodiscard]] std::string fact(const std::string& name, const std::string& value);
/// A table in its own region. The region scrolls if the table is too wide, and the keyboard can
/// reach it.
[[nodiscard]] std::string table(const std::string& name, const std::string& head,
                                const std::string& body);

/// Picture [H,W,3] uint8 with the longer side at most `max_size`, as a data: address of a JPEG.
/// Throws InputError for another shape or type.
[[nodiscard]] std::string jpeg_address(const at::Tensor& image, int64_t max_size, int quality);

/// "93.0 %" for 0.93.
[[nodiscard]] std::string percent(double share);
/// 12345 as "12,345".
[[nodiscard]] std::string thousands(int64_t number);
/// Seconds as "1.2 s", "4 min 05 s" or "2 h 05 min".
[[nodiscard]] std::string duration(double seconds);

}  // namespace tt3d::report
