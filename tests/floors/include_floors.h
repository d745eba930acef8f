#pragma once

#include <map>
#include <string>
#include <vector>

namespace robostress {

// A source tree as the checker sees it: path from the root -> the included names, in order. System
// headers keep their brackets ("<torch/types.h>"), ours do not ("common/types.h").
using IncludeGraph = std::map<std::string, std::vector<std::string>>;

// Includes of one file's text.
std::vector<std::string> IncludesOf(const std::string& text);
// Every .h and .cc under the folders that have a floor.
IncludeGraph ReadTree(const std::string& root);
// One sentence per include that climbs, goes sideways, or reaches a library its floor must not
// know; empty when all are in order.
std::vector<std::string> CheckFloors(const IncludeGraph& graph);

}  // namespace robostress
