#pragma once

#include <string>

#include "eval/report.h"

namespace robostress {

// The report as one HTML page that needs nothing else: style, plots and videos are inside it.
std::string ReportPage(const RunData& run, const Summary& summary, const ReportOptions& options);

// Plots that the page and the figures folder share.
std::string SuccessPlot(const SuccessTable& table);
std::string DifferencePlot(const SuccessTable& table);

}  // namespace robostress
