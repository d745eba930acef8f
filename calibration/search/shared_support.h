#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "calibration/model/plant.h"
#include "calibration/search/calibration_report.h"

namespace robostress::calibration {

// What another joint of an arm says of an effect that acts on the whole arm.
struct OtherJoint {
  std::string joint;
  double without = 0, with = 0;  // projected error of its fit logs, fitted without it and with it
  double change = 0;             // of its prediction, at the same parameters
  double floor = 0;
  bool agrees = false;  // it found the effect by itself, as large (Agree)
};

// Whether an effect of the whole arm, as a base that tilts or a payload, may be claimed at one
// joint: another joint must have found it by itself, or be fitted better with it where it changes
// the prediction by more than the noise; and none clearly worse. Empty: it may; else why not.
std::string ObjectionOf(const std::string& effect, const std::vector<OtherJoint>& others);

// Whether two joints found one effect of one size: every parameter that both fitted within 10 %, or
// 3 standard errors of the difference.
bool Agree(const AddedEffectReport& one, const AddedEffectReport& other);

// Whether a joint's effect would show at other joints of its arm as well.
bool ActsOnTheWholeArm(const std::string& effect);

// `rig` with what `after` found at its joints besides `effect`, as it was found: what else a joint
// lacks may hide whether it has the effect.
Rig WithOtherFindings(Rig rig, const Rig& after, const std::string& effect);

// Of the other joints of `rig`, each with its declared model.
absl::StatusOr<std::vector<OtherJoint>> AskOtherJoints(const Rig& rig, const Plant& plant,
                                                       const std::vector<MeasuredLog>& logs,
                                                       int claimant, const DeclaredEffect& effect);

}  // namespace robostress::calibration
