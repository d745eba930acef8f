#pragma once

#include <string>

#include "eval/statistics/summary.h"

namespace robostress {

// How far execution is from the command, per scenario and method; and the same measures before and
// after adaptation, on the same episodes.
std::string ResidualSection(const Summary& summary);
// Means over units along their episodes.
std::string AdaptationSection(const Summary& summary);

}  // namespace robostress
