#pragma once

#include <string>
#include <vector>

#include "common/random.h"
#include "tests/calibration/generator/generated_rig.h"

namespace robostress::generator {

// In the order of Hardship.
const std::vector<std::string>& HardshipNames();

// How a recorder spoils rows that were taken well: rows are lost, or all channels are drawn through
// by lines and read at other times. Other hardships leave a recording as it is.
Recording Spoil(const Recording& recording, Hardship hardship, RandomStream random);

// Of the rate that rows were taken at.
double LoggedRate(Hardship hardship, double rate_hz);

}  // namespace robostress::generator
