#pragma once

#include "absl/types/span.h"
#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/stick_friction.h"

namespace robostress {

// The order in which a chain acts in a sub-step: what a controller asks for goes through the
// command and the drive stage, the torque stage adds to it, friction that sticks is solved for all
// joints at once, the motors' limits end it. The arm then moves by its own mechanics; its
// transmissions (JointChain::MoveErrors, MoveEffects) and readings follow.
//
// Plant is what a chain needs to know of the arm in this sub-step:
//   Vector Limited(Vector)         torques within the motors' limits [Nm]; an arm that cuts what it
//                                  is asked for before may give them back
//   Vector Net(Vector)             all torques on the joints when these are applied [Nm]
//   Mass MassMatrix()              of the joints [kg m^2]; Inverse, a type, is that of its inverse
//   Vector Velocities()            [rad/s]
//   double rest, h                 dry friction beside the chain's [Nm], the sub-step [s]
// outside [Nm]: torques that reach the joints past the motors. Returns what goes to the joints.
template <class Vector, class Plant>
Vector SubStepTorque(JointChain& chain, absl::Span<JointMoment> moments, const Vector& asked,
                     const Vector& outside, const Plant& plant) {
  Vector torque = asked;
  const auto values = absl::MakeSpan(torque.data(), moments.size());
  chain.Drive(moments, values);
  chain.AddTorques(moments, values);
  torque += outside;
  if (chain.sticks() || plant.rest > 0) {
    torque = WithDryFriction<typename Plant::Inverse>(
        plant.MassMatrix(), torque, plant.Net(plant.Limited(torque)), plant.Velocities(),
        chain.inertia(), chain.dry(), plant.rest, plant.h);
  }
  return plant.Limited(torque);
}

}  // namespace robostress
