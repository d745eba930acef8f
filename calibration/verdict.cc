#include "calibration/calibration_report.h"

namespace robostress::calibration {

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

}  // namespace robostress::calibration
