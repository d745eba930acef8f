#pragma once

#include <string>

#include "absl/status/status.h"
#include "calibration/fidelity/fidelity_study.h"

namespace robostress::calibration {

std::string FidelityJson(const FidelityOptions& options, const FidelityResult& result);
// Mean and spread of every side over the phases [mm]: phase,time_s,measured_mean,measured_std, ...
std::string FidelityCsv(const FidelityResult& result);
// Deviation against time: measured mean and spread, fitted model, Gaussian noise, grasp marked.
std::string FidelitySvg(const FidelityResult& result);
// The same with the numbers, as a page that needs nothing else.
std::string FidelityHtml(const FidelityOptions& options, const FidelityResult& result);
// For the terminal.
std::string FidelityTable(const FidelityResult& result);

// fidelity.json, profiles.csv, fidelity.svg, fidelity.html, and measured/replays.csv of a simulated
// measured side: the form that --measured reads.
absl::Status WriteFidelity(const std::string& dir, const FidelityOptions& options,
                           const FidelityResult& result);

}  // namespace robostress::calibration
