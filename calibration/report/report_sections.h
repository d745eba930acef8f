#pragma once

#include <string>

#include "calibration/search/calibration_report.h"

namespace robostress::calibration {

// The story of one joint as HTML, in order: declared, how far off, what the residual looks like,
// what was tried, what was accepted and why, before and after, what remains. Parts of which the
// report says nothing are left out. n_surrogates: the least p-value that can occur is 1 / (n + 1).
std::string JointSections(const JointReport& joint, int n_surrogates);

}  // namespace robostress::calibration
