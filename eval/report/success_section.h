#pragma once

#include <string>

#include "eval/statistics/summary.h"

namespace robostress {

// Success of every table, methods beside each other with the paper's numbers, and the differences
// to base; plots for tables over all suites.
std::string SuccessSection(const Summary& summary);

// Plots that the page and the figures folder share. Every category says how many episodes it is of.
std::string SuccessPlot(const SuccessTable& table);
std::string DifferencePlot(const SuccessTable& table);  // empty when nothing was paired

}  // namespace robostress
