#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/joint_errors/scenario_file.h"

namespace robostress {

// A servo as Rhoban's BAM describes it (Duclusaud, Passault et al., "Extended Friction Models for
// the Physics Simulation of Servo Actuators", arXiv 2410.08650; github.com/Rhoban/bam,
// bam/model.py): a JSON object of "model" (m1 to m6), "actuator" and a number per parameter. With m
// the motor's torque and e the external torque at the joint [Nm], both with their signs, and dq its
// velocity [rad/s], friction resists with at most
//   F = friction_base + G + S (friction_stribeck + G_s + Q)
//   S        = exp(-|dq / dtheta_stribeck|^alpha)
//   m3, m4:  G = load_friction_base |e - m|, G_s = load_friction_stribeck |e - m|
//   m5, m6:  G = |load_friction_external e - load_friction_motor m|, G_s likewise of *_stribeck
//   m6:      Q = load_friction_external_quad e^2 where |e| < |m|, load_friction_motor_quad m^2
//            where |e| > |m|, and 0 where e and m have the same sign
// and a torque of -friction_viscous dq. m1 is friction_base and friction_viscous alone, m2 has S,
// m3 has G, m4 both. What a model has not is 0 here.
struct BamParameters {
  std::string file, actuator;
  int model = 1;                          // 1 to 6
  double kt = 0, R = 0, armature = 0;     // [Nm/A], [ohm], [kg m^2]; 0: the file has none
  double current_limit = 0;               // [A]; 0: the file has none
  double friction_base = 0;               // [Nm]
  double friction_stribeck = 0;           // [Nm]
  double friction_viscous = 0;            // [Nm s/rad]
  double dtheta_stribeck = 1, alpha = 2;  // [rad/s], [1]
  double load_friction_base = 0, load_friction_stribeck = 0;                     // [1]
  double load_friction_motor = 0, load_friction_external = 0;                    // [1]
  double load_friction_motor_stribeck = 0, load_friction_external_stribeck = 0;  // [1]
  double load_friction_motor_quad = 0, load_friction_external_quad = 0;          // [1/Nm]
  std::vector<std::string> unused;  // "q_offset 0.02: why"; of keys that friction does not take
};

// INVALID_ARGUMENT names file, field, value and remedy.
absl::StatusOr<BamParameters> ReadBamParameters(const std::string& file);
absl::StatusOr<BamParameters> ParseBamParameters(const std::string& file, const std::string& json);

// F above [Nm].
double BamDryFriction(const BamParameters& p, double motor, double external, double dq);

// What of it the effect library expresses:
//   stribeck_friction         Fc = friction_base, Fs = Fc + friction_stribeck, sigma_v =
//                             friction_viscous, and vs = dtheta_stribeck Gamma(1 + 1 / alpha) /
//                             Gamma(3/2): the library's exponent is 2, and so its curve encloses
//                             the same area; the same law where alpha is 2
//   load_dependent_friction   mu = load_friction_motor, or load_friction_base
//   gravity_dependent_friction  mu = load_friction_external, or load_friction_base
// G = mu_m |m| + mu_g |e| is BAM's where m and e have opposite signs and gravity is all that is
// external: the motor holds or lifts. Where gravity helps the motor BAM has the difference instead.
struct BamEffects {
  std::vector<ScenarioEffect> effects;  // of joint 0; those that are absent are not listed
  std::vector<std::string> left_out;    // sentences: parameter, value, why
};
BamEffects EffectsOfBam(const BamParameters& p);

// The largest |friction of EffectsOfBam - F| [Nm] for |dq| up to 10 rad/s and loads up to `load`
// [Nm]: without load; where gravity opposes the motor; where it helps it.
struct BamDifference {
  double unloaded = 0, opposing = 0, helping = 0;
};
BamDifference LargestBamDifference(const BamParameters& p, double load);

// These effects at `joints` of the robot (indices). INVALID_ARGUMENT where the arm's scenarios may
// not hold a value, with its range.
absl::StatusOr<ScenarioFile> ScenarioOfBam(const BamParameters& p, const std::vector<int>& joints,
                                           const RobotDescription& robot);
// The joint entry of a calibration rig: servo, armature and effects. To be filled in is what BAM
// keeps with its logs: the gain kp [V/rad] and supply vin [V], or of a servo that BAM drives by a
// current or a torque kp [Nm/rad] and kd [Nm s/rad].
std::string RigJointOfBam(const BamParameters& p, absl::string_view joint);

}  // namespace robostress
