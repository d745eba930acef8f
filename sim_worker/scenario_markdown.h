#pragma once

#include <string>
#include <vector>

#include "common/joint_errors/scenarios.h"

namespace robostress {

// The computed joint error parameters as a Markdown table, five significant digits: one line per
// scenario and run of joints that are equal in everything but beta, whose column lists every joint.
// "a → b" runs from the episode's first to its last control step, or over the first 0.1 s of a
// grasp; "–" is a component that injects nothing.
std::string ParameterMarkdown(const std::vector<Scenario>& scenarios);

// Severity factors of levels 1 to 5 (paper, tab:supp_severity_levels), read off the scenarios.
std::string SeverityLevelMarkdown();

// Natural frequency sqrt(K / M_eff) and damping ratio D / (2 sqrt(K M_eff)) of the compliance at
// every level.
std::string ComplianceMarkdown();

}  // namespace robostress
