#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/joint_errors/effects/joint_effect.h"

namespace robostress {

// The quantity of which a parameter is a multiple, so that bounds and starts fit a watch as well as
// an excavator. Signals of the joint: torque T, position P, velocity V, sample time dt.
enum class EffectScale {
  kOne,
  kTorque,              // T [Nm]
  kPosition,            // P [rad]
  kVelocity,            // V [rad/s]
  kSample,              // dt [s]
  kTorquePerPosition,   // T / P
  kTorquePerPosition2,  // T / P^2
  kTorquePerPosition3,  // T / P^3
  kTorquePerVelocity,   // T / V
  kTorquePerVelocity2,  // T / V^2
  kTorquePerSecond,     // T / 1 s
  kPayload,             // T over the gravity torque of 1 kg [kg]
  // Acceleration A; temperature that a log rises by, K.
  kTorquePerAcceleration,    // T / A
  kTorquePerKelvin,          // T / K
  kTorquePerVelocityKelvin,  // T / (V K)
  kColdest,                  // the lowest temperature logged [deg C], whatever the start says
};

struct EffectParameter {
  std::string name;
  std::string unit;  // of a hinge
  EffectScale scale = EffectScale::kOne;
  double lower = 0, upper = 0;  // bounds, in multiples of the scale
  // Where fits begin, in multiples of the scale; several where the error is not smooth or has
  // several minima.
  std::vector<double> starts;
  // The parameter is large when the effect is absent: fits move in 1 / value, neutral is 0 there,
  // and bounds and starts above are of 1 / (value in multiples of the scale).
  bool inverse = false;
  bool fixed = false;  // keeps its first start unless a rig asks for a fit
  bool late = false;   // and unless the effect is there and much is left that it may explain
};

// One row of the library: everything about an effect that is not its code.
struct EffectInfo {
  std::string type;
  EffectStage stage = EffectStage::kJoint;
  std::vector<EffectParameter> parameters;
  // Without these at zero (1 / value for `inverse`) the effect is absent. Indices.
  std::vector<int> amplitudes;
  std::string equation;
  std::string needs;                // what data must contain to tell it
  std::vector<std::string> mimics;  // effects that look alike on poor data
  std::string separated_by;         // the experiment that tells it from those
  std::function<std::unique_ptr<JointEffect>()> make;
  bool coupled = false;  // it reads the motion of another joint, its partner
  bool thermal = false;  // it reads the joint's temperature
  // It limits a servo's position command, in that command's unit. Where a chain is given torques
  // instead (scenarios, the Python library), nothing is what it was fitted as.
  bool of_position = false;
};

// Every effect, in the order of the design.
const std::vector<EffectInfo>& EffectLibrary();
// NotFound lists the known names.
absl::StatusOr<const EffectInfo*> FindEffect(const std::string& type);
// Index of a parameter; NotFound lists the known ones.
absl::StatusOr<int> FindParameter(const EffectInfo& effect, const std::string& name);

const char* StageName(EffectStage stage);

}  // namespace robostress
