#include "calibration/search/verdict.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"

namespace robostress::calibration {
namespace {

constexpr double kAtFloor = 1.15;    // times the floor counts as noise
constexpr double kWhite = 1.5;       // the same of what is white
constexpr double kNearFloor = 3.0;   // the most that may be left under a name
constexpr double kKernel = 0.002;    // of the declared error: the simulation's own may be as large
constexpr double kMinor = 0.01;      // of the same: what is left beside a large effect
constexpr double kFarFromFloor = 5;  // the most of that
constexpr double kUnnamed = 1.5;     // where nothing is found: less than this is not claimed
constexpr double kFewUnnamed = 4.0;  // the same of a few free runs that are far off
constexpr double kFewPushed = 12.0;  // the same of a joint that others push where it nearly rests
constexpr double kExplained = 0.97;  // of the excess energy: hardly anything remains
constexpr double kExplainedToNoise = 0.7;
constexpr double kTransferLoss = 1.05;  // worse than declared by more than this: no mechanism

bool IsNoise(const Evidence::Regime& regime, bool pushed) {
  return regime.bulk <= kUnnamed * regime.floor &&
         regime.declared <= (pushed ? kFewPushed : kFewUnnamed) * regime.floor;
}

// Of a declared model to which nothing was added.
std::string WhatIsLeft(const Evidence& e, const Evidence::Regime& worst) {
  const double floor = std::max(e.floor, 1e-300), own = std::max(worst.floor, 1e-300);
  std::string text = absl::StrFormat(
      "the declared model leaves %.2f times the noise of the readings", e.declared / floor);
  if (e.declared > kUnnamed * floor)
    absl::StrAppendFormat(&text, ", %.2f without the tenth of the free runs that is farthest off",
                          e.declared_bulk / floor);
  if (!worst.log.empty() && !IsNoise(worst, e.pushed))
    absl::StrAppendFormat(&text, "; most in %s, %.2f times (%.2f)", worst.log, worst.declared / own,
                          worst.bulk / own);
  return text;
}

Judgement WithoutEffects(const Evidence& e) {
  std::vector<Evidence::Regime> regimes = e.regimes;
  regimes.push_back({"", e.declared, e.declared_bulk, e.floor});
  const auto more_than_noise = [&](const Evidence::Regime& regime) {
    return std::make_pair(!IsNoise(regime, e.pushed), regime.bulk / std::max(regime.floor, 1e-300));
  };
  const Evidence::Regime worst = *std::max_element(
      regimes.begin(), regimes.end(),
      [&](const auto& a, const auto& b) { return more_than_noise(a) < more_than_noise(b); });
  if (IsNoise(worst, e.pushed)) return {Verdict::kDeclaredSufficient, WhatIsLeft(e, worst), 0};
  return {Verdict::kUnattributed,
          absl::StrCat(WhatIsLeft(e, worst),
                       !e.searched     ? "; nothing was searched"
                       : e.significant ? "; no candidate passes every test"
                                       : "; no candidate explains more of it than chance does"),
          0};
}

// Empty: what was added may be told as a mechanism.
std::string WhyNoMechanism(const Evidence& e, double explained) {
  if (!e.doubts.empty())
    return absl::StrCat("what was added can not be what the machine is: ",
                        absl::StrJoin(e.doubts, "; "));
  if (e.transfer_declared > 0 && e.transfer_after > kTransferLoss * e.transfer_declared)
    return "what was added makes the transfer logs worse";
  const bool noise_only = !e.inverse && e.after <= (e.after_is_white ? kWhite : kAtFloor) * e.floor;
  // Where a declared model would be sufficient less is asked of what was added.
  const bool as_sufficient = IsNoise({"", e.after, e.after_bulk, e.floor}, e.pushed);
  if (!noise_only && explained < (as_sufficient ? kExplainedToNoise : kExplained))
    return absl::StrFormat(
        "what was added explains %.1f %% of the excess over noise, and the rest has no name",
        100 * explained);
  // Of a right model a few free runs may stick where the machine slipped.
  const bool few_runs = e.after_bulk <= kUnnamed * e.floor;
  const bool resolved = e.after <= kKernel * e.declared ||
                        (e.after <= kMinor * e.declared && e.after <= kFarFromFloor * e.floor);
  if (!e.inverse && e.after > kNearFloor * e.floor && !few_runs && !resolved)
    return absl::StrFormat(
        "what was added leaves %.1f times the noise, and no more than %.1f is left under a name",
        e.after / std::max(e.floor, 1e-300), kNearFloor);
  return "";
}

}  // namespace

const char* VerdictName(Verdict verdict) {
  switch (verdict) {
    case Verdict::kAttributed:
      return "attributed";
    case Verdict::kAmbiguous:
      return "ambiguous";
    case Verdict::kReducedNotAttributed:
      return "reduced_not_attributed";
    case Verdict::kUnattributed:
      return "unattributed";
    case Verdict::kDeclaredSufficient:
      return "declared_sufficient";
    case Verdict::kNotTestable:
      return "not_testable";
  }
  return "";
}

Judgement Judge(const Evidence& e) {
  const double floor = e.floor * e.floor;
  const double before = std::max(0.0, e.declared * e.declared - floor);
  const double later = std::max(0.0, e.after * e.after - floor);
  const double explained = before > 0 ? 1 - later / before : 0, percent = 100 * explained;
  if (e.windows < kMinWindows)
    return {Verdict::kNotTestable,
            absl::StrFormat("the logs hold %d free runs, fewer than %d", e.windows, kMinWindows),
            0};
  if (e.effects == 0) return WithoutEffects(e);
  if (std::string reason = WhyNoMechanism(e, explained); !reason.empty())
    return {Verdict::kReducedNotAttributed, std::move(reason), explained};
  return {
      e.ambiguous ? Verdict::kAmbiguous : Verdict::kAttributed,
      absl::StrFormat("what was added explains %.1f %% of the excess over noise%s", percent,
                      e.ambiguous ? ", and so do others of its group" : ", and nothing else does"),
      explained};
}

Verdict Combine(const std::vector<JointReport>& joints) {
  const auto any = [&](Verdict verdict) {
    return std::any_of(joints.begin(), joints.end(),
                       [&](const JointReport& joint) { return joint.verdict == verdict; });
  };
  const bool open = any(Verdict::kUnattributed) || any(Verdict::kReducedNotAttributed);
  const bool named =
      any(Verdict::kAttributed) || any(Verdict::kAmbiguous) || any(Verdict::kReducedNotAttributed);
  if (open) return named ? Verdict::kReducedNotAttributed : Verdict::kUnattributed;
  if (any(Verdict::kAmbiguous)) return Verdict::kAmbiguous;
  if (any(Verdict::kAttributed)) return Verdict::kAttributed;
  return any(Verdict::kDeclaredSufficient) ? Verdict::kDeclaredSufficient : Verdict::kNotTestable;
}

}  // namespace robostress::calibration
