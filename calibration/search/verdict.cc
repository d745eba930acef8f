#include "calibration/search/verdict.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress::calibration {
namespace {

constexpr double kAtFloor = 1.15;       // times the floor counts as noise
constexpr double kUnnamed = 2.0;        // where nothing is found: less than this is not claimed
constexpr double kFewUnnamed = 20;      // the same of a few free runs that are far off
constexpr double kExplained = 0.97;     // of the excess energy: hardly anything remains
constexpr double kTransferLoss = 1.05;  // worse than declared by more than this: no mechanism
constexpr int kMinWindows = 8;

// Of a declared model to which nothing was added.
std::string WhatIsLeft(const Evidence& e) {
  const double floor = std::max(e.floor, 1e-300);
  std::string text = absl::StrFormat(
      "the declared model leaves %.2f times the noise of the readings", e.declared / floor);
  if (e.declared > kUnnamed * floor)
    absl::StrAppendFormat(&text, ", %.2f without the tenth of the free runs that is farthest off",
                          e.declared_bulk / floor);
  return text;
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
  Judgement judgement;
  judgement.excess_explained = before > 0 ? 1 - later / before : 0;
  const double percent = 100 * judgement.excess_explained;
  if (e.windows < kMinWindows)
    return {Verdict::kNotTestable,
            absl::StrFormat("the logs hold %d free runs, fewer than %d", e.windows, kMinWindows),
            0};
  if (e.effects == 0) {
    const bool noise = e.declared_bulk <= kUnnamed * e.floor && e.declared <= kFewUnnamed * e.floor;
    if (noise || e.declared_white) return {Verdict::kDeclaredSufficient, WhatIsLeft(e), 0};
    return {Verdict::kUnattributed,
            absl::StrCat(WhatIsLeft(e),
                         e.significant ? "; no candidate passes every test"
                                       : "; no candidate explains more of it than chance does"),
            0};
  }
  if (e.transfer_declared > 0 && e.transfer_after > kTransferLoss * e.transfer_declared) {
    judgement.verdict = Verdict::kReducedNotAttributed;
    judgement.because = "what was added makes the transfer logs worse";
    return judgement;
  }
  const bool noise_only = !e.inverse && e.after <= kAtFloor * e.floor;
  if (!noise_only && judgement.excess_explained < kExplained) {
    judgement.verdict = Verdict::kReducedNotAttributed;
    judgement.because = absl::StrFormat(
        "what was added explains %.1f %% of the excess over noise, and the rest "
        "has no name",
        percent);
    return judgement;
  }
  judgement.verdict = e.ambiguous ? Verdict::kAmbiguous : Verdict::kAttributed;
  judgement.because =
      absl::StrFormat("what was added explains %.1f %% of the excess over noise%s", percent,
                      e.ambiguous ? ", and so do others of its group" : ", and nothing else does");
  return judgement;
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
