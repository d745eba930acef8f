#pragma once

#include <string>
#include <vector>

#include "nlohmann/json.hpp"

namespace robostress::generator {

// What a threshold of verdict.cc decides by, of one traced rig.
struct Traced {
  bool hidden = false;   // something the library knows
  bool outside = false;  // something that it does not
  // Over noise, of the joint and log where most is left of the declared model: without the worst
  // tenth of the free runs, and all of them.
  double bulk = 0, all = 0;
  bool added = false, right = false;  // right: all that was added, or one of its group, is there
  double left = 0;                    // over noise, after what was added
  double explained = 0;               // of the excess over noise
};

// Of report.json and truth.json.
Traced ReadTraced(const nlohmann::json& report, const nlohmann::json& truth);

// Markdown: what each limit costs if it is moved and nothing else is. Read off finished traces: a
// search that was let go on by another limit may find more.
std::string ThresholdRates(const std::vector<Traced>& rigs);

}  // namespace robostress::generator
