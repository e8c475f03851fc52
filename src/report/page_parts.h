#pragma once

/// The page's template, style and script, compiled in from the files beside this one.
namespace tt3d::report {

extern const char* const kPageHtml;
extern const char* const kPageCss;
extern const char* const kViewerJs;

}  // namespace tt3d::report
