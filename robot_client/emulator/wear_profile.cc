#include "robot_client/emulator/wear_profile.h"

#include "absl/strings/str_cat.h"
#include "common/joint_errors/scenario_file.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

// Friction and backlash of a joint as delivered.
struct Joint {
  double coulomb;   // [Nm]
  double viscous;   // [Nm s/rad]
  double backlash;  // half-width [rad]
};
// Coulomb friction: MuJoCo Menagerie's agilex_piper has 0.3 Nm at every joint; a Piper of firmware
// S-V1.8-6 draws 0.5 to 0.6 A at rest between moves (piper_sdk issue 119), 0.5 to 0.7 Nm, which
// bounds it from above. The wrist's drives have a quarter of the shoulder's torque, and are given
// half its friction. Viscous friction: a tenth of the
// Coulomb friction per rad/s, the ratio of the paper's arm (2.175 to 0.348 Nm, 0.48 to 0.048 Nm).
// Backlash: the paper's nominal values for proximal and distal joints.
constexpr std::array<Joint, kJoints> kNew = {{{0.30, 0.030, 0.00087},
                                              {0.30, 0.030, 0.00087},
                                              {0.30, 0.030, 0.00087},
                                              {0.15, 0.015, 0.00087},
                                              {0.15, 0.015, 0.0013},
                                              {0.15, 0.015, 0.0013}}};
// Static over Coulomb friction and Stribeck velocity: the paper's arm, 3.48 to 2.175 Nm; 0.15
// rad/s.
constexpr double kStaticOverCoulomb = 1.6;
constexpr double kStribeckVelocity = 0.15;
// Compliance of the transmission: the paper's nominal distal joint over the wider torque range,
// 4000 Nm/rad, its frequency and damping.
constexpr double kStiffness = 4000, kFrequency = 22.5, kDamping = 0.7;
// One year of use: the mildest severity of the paper's wear scale (tab:levels, L1): friction times
// 1.5, backlash times 5, stiffness halved.
constexpr double kUsedFriction = 1.5, kUsedBacklash = 5, kUsedCompliance = 2;
// The controller's gravity model: the paper's nominal residual is 5 to 10 per cent.
constexpr double kFeedforward = 0.95;
// From a frame to the planner. Measured end-to-end lags of Piper controllers are not published;
// 60 ms is the lower end of what the motion of deployed arms suggests (60 to 150 ms with planning
// and servo, which the emulator adds by itself).
constexpr double kCommandLag = 0.06;

WearProfile Profile(const std::string& name, double friction, double backlash, double compliance) {
  WearProfile profile;
  profile.name = name;
  profile.gravity_feedforward.fill(kFeedforward);
  profile.command_lag_s = kCommandLag;
  for (int j = 0; j < kJoints; ++j) {
    const double coulomb = friction * kNew[j].coulomb;
    profile.effects.push_back(
        {j,
         "stribeck_friction",
         {coulomb, kStaticOverCoulomb * coulomb, kStribeckVelocity, friction * kNew[j].viscous}});
    profile.effects.push_back({j, "backlash", {backlash * kNew[j].backlash}});
    profile.effects.push_back({j, "compliance", {kStiffness / compliance, kFrequency, kDamping}});
  }
  return profile;
}

absl::StatusOr<WearProfile> FromFile(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const ScenarioFile file, ReadScenarioFile(path, kPiper));
  if (file.base != "clean")
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": base: ", file.base,
                     " is a scenario of the Panda; a Piper's profile has base: clean"));
  WearProfile profile = Profile(ScenarioLabel(path), 1, 1, 1);
  profile.effects = file.effects;
  return profile;
}

}  // namespace

absl::StatusOr<WearProfile> MakeWearProfile(const std::string& name) {
  if (name == "new") return Profile(name, 1, 1, 1);
  if (name == "used_one_year") return Profile(name, kUsedFriction, kUsedBacklash, kUsedCompliance);
  if (IsScenarioFile(name)) return FromFile(name);
  return absl::InvalidArgumentError(
      absl::StrCat("profile '", name,
                   "' is unknown; known: new, used_one_year, or the path of a scenario "
                   "file that ends in .yaml"));
}

}  // namespace robostress::piper
