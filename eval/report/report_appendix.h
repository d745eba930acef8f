#pragma once

#include <string>

#include "eval/report/report.h"

namespace robostress {

// Sections of the report page that follow the numbers.

// Films of paired rollouts, methods side by side; empty when the run filmed nothing. Films beyond
// the options' limits are counted, not shown.
std::string VideoSection(const RunData& run, const ReportOptions& options);
// Configuration, versions, and how to repeat the run.
std::string SetupSection(const RunData& run);
// What the numbers do not show.
std::string LimitsSection(const RunData& run, const Summary& summary, const SuccessTable& main);

}  // namespace robostress
