#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "eval/report/result_file.h"

namespace robostress {

inline constexpr double kResultRounding = 1e-6;  // of numbers that must agree with one another
inline constexpr size_t kMostContradictions = 20;

// Where the parts of a result file contradict one another: cells that name what is not declared or
// stand twice, means that are not those of their scenarios. A line each; after kMostContradictions
// one more.
std::vector<std::string> ContradictionsOf(const ResultFile& file);

}  // namespace robostress
