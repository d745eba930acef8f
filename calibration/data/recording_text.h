#pragma once

#include <string>

#include "calibration/data/recording_plan.h"

namespace robostress::calibration {

// What `robostress log inspect` prints of a recording: channels with rates, jitter and gaps; units
// and why; which joints move how; what the log can and cannot show. Names of the file are printed
// without control characters.
std::string DescribeRecording(const RecordingStatistics& statistics, const RecordingPlan& plan);

}  // namespace robostress::calibration
