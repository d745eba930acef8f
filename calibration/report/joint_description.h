#pragma once

#include "calibration/search/calibration_report.h"
#include "calibration/search/joint_case.h"
#include "calibration/search/joint_search.h"

namespace robostress::calibration {

// Tells what was found: errors before and after, what was added, what is left, and the verdict.
JointReport DescribeJoint(const JointCase& joint, const Finding& finding);

}  // namespace robostress::calibration
