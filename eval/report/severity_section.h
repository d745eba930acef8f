#pragma once

#include <string>
#include <vector>

#include "eval/statistics/summary.h"

namespace robostress {

// Policies that were run at several severity levels, as in the tables.
std::vector<std::string> PoliciesWithLevels(const Summary& summary);
// Success over severity levels of every scenario (rows) and suite (columns), as the paper's
// fig:supp_severity: one line per method with Wilson's interval behind it, n in every panel's
// title. SVG; empty when the policy has one level.
std::string SeverityFigure(const Summary& summary, const std::string& policy);
// The figures, and the average over scenarios and suites; empty when no policy has several levels.
std::string SeveritySection(const Summary& summary);

}  // namespace robostress
