#pragma once

#include <string>

#include "calibration/report/report_numbers.h"
#include "calibration/search/calibration_report.h"

namespace robostress::calibration {

// Pictures of a joint's report as SVG; empty where the report holds nothing to draw. The declared
// model is orange, the model after calibration blue, in all of them.
inline constexpr char kDeclaredColor[] = "#d55e00", kAfterColor[] = "#0072b2";

// Measured, declared and after over a stretch, and below it both residuals.
std::string ExamplePlot(const ExampleReport& example, bool added, const DisplayUnit& unit);
// The residual's means against position, velocity, load, time, or its spectrum (log axes).
std::string StructurePlot(const StructureCurve& curve, bool added, const DisplayUnit& unit);
// Share of the residual that each candidate explains, and what chance reaches.
std::string RoundPlot(const RoundReport& round, int number, const JointReport& joint);
// Whether `type`, or both of a pair, are among the effects that were added to the joint.
bool IsPartOf(const std::string& type, const JointReport& joint);
// The last part of a path: pages name no folders of the machine they were made on.
std::string FileName(const std::string& path);
// Declared and after on the logs of every role, with the noise floor.
std::string ErrorPlot(const JointReport& joint, const DisplayUnit& unit);

}  // namespace robostress::calibration
