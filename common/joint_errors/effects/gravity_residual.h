#pragma once

#include "common/joint_errors/options.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// Torque stage: gravity-compensation error (paper, Eq. gravity),
//   eta_grav = beta g_j(q),
// with beta >= 0 the residual fraction and g_j [Nm] the controller's gravity torque at zero
// velocity, the one that holds the arm. Added to a controller that already compensates g, the
// literal sign lifts the arm; `payload` is -beta g, the sag that an unknown load causes. [Nm]
inline double GravityResidual(const JointErrorParameters& p, double g, GravitySign sign) {
  return sign == GravitySign::kLiteral ? p.beta * g : -p.beta * g;
}

}  // namespace robostress
