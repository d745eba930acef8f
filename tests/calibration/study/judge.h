#pragma once

#include <string>
#include <vector>

#include "nlohmann/json.hpp"

namespace robostress::generator {

// What a trace said, beside what was true.
enum class Outcome {
  kNamed,       // attributed to what is there, and to nothing else
  kGrouped,     // ambiguous, and what is there is in the group
  kListed,      // reduced_not_attributed, and what is there is among the effects
  kHedged,      // something is missing, but no word of what is there, and no claim
  kOneOfTwo,    // two are there; one is told, and what is left is no more than noise
  kMissed,      // declared_sufficient or not_testable though something is missing
  kWrong,       // attributed to what is not there: the worst
  kWrongGroup,  // ambiguous within a group that what is there is not in
  kNothing,     // rightly: nothing is missing
  kFalseAlarm,  // nothing is missing, and it said that something is
  kRefused,     // the program failed
};
const char* OutcomeName(Outcome outcome);

struct Judged {
  Outcome outcome = Outcome::kRefused;
  std::string said;  // verdict and effects, for people
};

// report.json against truth.json (README of tests/calibration). An effect outside the library is
// rightly reduced or unattributed; attributed to an effect that is near it counts as kListed.
Judged Judge(const nlohmann::json& report, const nlohmann::json& truth);

// Two-sided interval for a share of `count` in n: Clopper and Pearson 1934.
std::pair<double, double> ClopperPearson(int count, int n, double confidence = 0.95);

}  // namespace robostress::generator
