#pragma once

#include <string>

#include "eval/report/report.h"

namespace robostress {

// The report as one HTML page that needs nothing else: style, plots and videos are inside it.
std::string ReportPage(const RunData& run, const Summary& summary, const ReportOptions& options);

}  // namespace robostress
