#pragma once

#include "common/joint_errors/options.h"
#include "common/joint_errors/scenarios.h"

// Torque stage: Stribeck friction (paper, Eq. stribeck),
//   eta_fric = -s(dq) [Fc + (Fs - Fc) exp(-(dq / vs)^2)] - sigma_v dq,
// with dq the joint velocity [rad/s], Fc and Fs the kinetic and static friction torque [Nm], vs the
// Stribeck velocity [rad/s], sigma_v the viscous coefficient [Nm s/rad]. The law is the choice of
// s:
//   sgn    s = sgn(dq), the paper's. In discrete time a joint near rest chatters, and so creeps
//   where a real
//          one would hold.
//   tanh   s = tanh(dq / width): smooth, no chatter, creeps viscously near zero.
//   stick  set-valued: s dq = |dq|, and |s| <= 1 where the velocity after the sub-step is zero.
namespace robostress {

// Fc + (Fs - Fc) exp(-(dq / vs)^2), the magnitude of the dry part [Nm].
double StribeckMagnitude(const JointErrorParameters& p, double dq);

// Laws sgn and tanh for one joint [Nm].
double StribeckTorque(const JointErrorParameters& p, double dq, FrictionLaw law, double tanh_width);

}  // namespace robostress
