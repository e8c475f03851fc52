#pragma once

namespace tt3d::model {

/// data/imagenet1k.tsv: one line per class, "index TAB WordNet id TAB names separated by ', '".
extern const char* const kImagenetTable;

}  // namespace tt3d::model
