#pragma once

#include <string>
#include <vector>

#include "calibration/search/calibration_report.h"

namespace robostress::calibration {

// What a verdict on one joint rests on. Errors are projected residuals (joint_problem.h) on logs
// that were not fitted, or cross-validated ones where there are none.
struct Evidence {
  double declared = 0, after = 0, floor = 0;
  double declared_bulk = 0;  // without the tenth of the free runs that is farthest off
  double after_bulk = 0;     // the same of what was added
  bool after_is_white = false;
  bool pushed = false;   // by other joints, whose motion is known by readings
  bool inverse = false;  // accelerations are smoothed, and the floor does not count their bias
  double transfer_declared = 0, transfer_after = 0;  // 0: no log of that role
  int effects = 0;
  bool ambiguous = false;           // some effect has rivals
  bool searched = true;             // false: no effect was to be added
  bool significant = false;         // some candidate explains more than chance
  int windows = 0;                  // fitted
  std::vector<std::string> doubts;  // why what was added can not be what the machine is
  // What the declared model leaves of each log.
  struct Regime {
    std::string log;
    double declared = 0, bulk = 0, floor = 0;
  };
  std::vector<Regime> regimes;
};

struct Judgement {
  Verdict verdict = Verdict::kNotTestable;
  std::string because;
  double excess_explained = 0;
};

inline constexpr int kMinWindows = 8;  // free runs that a verdict needs

Judgement Judge(const Evidence& evidence);

// Of a whole rig from its joints.
Verdict Combine(const std::vector<JointReport>& joints);

}  // namespace robostress::calibration
