#include "adapter/method_options.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

template <class... Parts>
absl::Status Invalid(const MethodOptions& m, const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat("method ", m.method, ": ", parts...));
}

}  // namespace

bool MethodOptions::Compensates() const {
  bool any = false;
  ForEachWay([&any](const auto&) { any = true; });
  return any;
}

bool MethodOptions::ModelsArm() const {
  return Find<IntegralOptions>() != nullptr || Find<FollowingOptions>() != nullptr ||
         Find<CalibratorOptions>() != nullptr || (adapts() && NeedsNominalArm(target));
}

bool MethodOptions::Corrects() const {
  bool any = false;
  ForEachWay([&any]<class Way>(const Way&) {
    any = any || requires { typename Way::Corrector; };
  });
  return any;
}

bool MethodOptions::CarriesOver() const {
  bool carries = false;
  ForEachWay([&carries](const auto& way) { carries = carries || way.carries_over(); });
  return carries;
}

absl::Status MethodOptions::Check() const {
  absl::Status first;
  const char *alone = nullptr, *other = nullptr;
  ForEachWay([&](const auto& way) {
    first.Update(way.Check());
    (way.kWay.alone ? alone : other) = way.kWay.key;
  });
  first.Update(CheckOption("gain", gain, -100, 100));
  first.Update(CheckOption("tracking_gain", tracking_gain, 1e-3, 100));
  first.Update(CheckOption("smoothing", smoothing, 0, 0.99));
  first.Update(CheckOption("execute_steps", execute_steps, 0, 1000));
  if (!first.ok()) return Invalid(*this, first.message());
  const bool bounded = Find<IntegralOptions>() != nullptr || Find<FollowingOptions>() != nullptr;
  if (Find<EnvelopeOptions>() != nullptr &&
      (!bounded || Find<DirectOptions>() != nullptr || Find<LeakyGoalOptions>() != nullptr ||
       Find<CalibratorOptions>() != nullptr)) {
    return Invalid(*this,
                   "envelope_share bounds integral action and model following; give it to a method "
                   "that corrects by these alone");
  }
  if (!arm_model.empty() && (!every_step || Corrects())) {
    return Invalid(*this, "arm_model=", arm_model,
                   " chooses every command; set every_step=true, and turn other corrections off");
  }
  if (every_step && ((!Corrects() && smoothing == 0 && arm_model.empty()) ||
                     (adapts() && target != TargetReference::kSent))) {
    return Invalid(*this,
                   "every_step needs a method that corrects or smooths commands and adapts no "
                   "weights but towards what is sent: direct, ours_integral, ours_following, "
                   "smooth, or target=sent");
  }
  if (panda_dynamics && !ModelsArm()) {
    return Invalid(
        *this,
        "panda_dynamics changes the nominal arm, with which it compares nothing; give it "
        "to ours_integral, ours_following or ours_nominal");
  }
  if (smoothing != 0 && !every_step)
    return Invalid(*this, "smoothing is done at every control step; set every_step=true");
  if (alone == nullptr || other == nullptr) return absl::OkStatus();
  return Invalid(*this, alone, " and ", other, " exclude each other; turn one of them off");
}

absl::Status MethodOptions::CheckJointSpace(const std::string& robot) const {
  if (panda_dynamics) {
    return Invalid(*this, "panda_dynamics models an end-effector controller; robot ", robot,
                   " acts in joint space: set it to false");
  }
  if (NeedsNominalArm(target)) {
    return Invalid(*this, "a nominal target models an end-effector controller; robot ", robot,
                   " acts in joint space: use target executed or intent");
  }
  if (every_step) {
    return Invalid(*this, "every_step is done beside the arm; robot ", robot,
                   " corrects at every step by the disturbance observer of its client");
  }
  if (execute_steps != 0) {
    return Invalid(*this, "execute_steps is done beside the arm; robot ", robot,
                   " executes as many rows as its client is told");
  }
  if (gain != 1.0) {
    return Invalid(*this, "gain ", gain, " would scale absolute joint targets; robot ", robot,
                   " needs gain 1");
  }
  absl::Status status;
  ForEachWay([&](const auto& way) {
    if (way.kWay.in_joint_space) return;
    status = Invalid(*this, absl::StrReplaceAll(way.kWay.name, {{"_", " "}}),
                     " compares with a nominal end-effector controller; robot ", robot,
                     " acts in joint space: use the disturbance observer of its client");
  });
  return status;
}

}  // namespace robostress
