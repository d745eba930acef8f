#pragma once

#include "common/joint_errors/scenarios.h"

namespace robostress {

// FactorsAt for one joint, without allocating.
SeverityFactors FactorOfJoint(const Scenario& scenario, int joint, double progress, double grasp);

}  // namespace robostress
