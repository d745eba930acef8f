#pragma once

#include <string>
#include <vector>

#include "robot_client/piper/arm_report.h"

namespace robostress::piper {

// A page of about 45 lines of at most 100 characters: state, joints, gripper, limits, frames, other
// senders, what is wrong and what to do.
std::string ReportPage(const ArmReport& report, const std::vector<Finding>& findings);

// The same in one line, without what was answered to questions.
std::string ReportLine(const ArmReport& report, const std::vector<Finding>& findings);

// One line of JSON, schema "robostress.arm_report.v1"; every key is always there, null where the
// arm has not said it. docs/results/arm-monitor.md documents the keys.
std::string ReportJson(const ArmReport& report, const std::vector<Finding>& findings);

}  // namespace robostress::piper
