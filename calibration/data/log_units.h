#pragma once

#include <string>
#include <vector>

namespace robostress::calibration {

// The unit whose numbers are `ratio` times those in SI, with the factor that mends them: "degrees:
// multiply them by 0.0174533". Known are degrees, thousandths, and counts of encoders with 2^10 to
// 2^24 a turn; within `tolerance` of them (0.05: 5 %). Empty: none of them.
std::string UnitOfRatio(double ratio, double tolerance);

// The same of a velocity over the derivative of the position: also turns a minute, and one that
// counts the other way. What no unit explains and is less than half or more than twice the
// derivative is said to be none.
std::string FaultOfVelocity(double ratio, double tolerance);

// The same of a clock whose rows are `ratio` times as far apart as they are declared: milliseconds,
// microseconds, nanoseconds.
std::string UnitOfClock(double ratio, double tolerance);

// Whether readings are counts of an encoder: whole numbers, over a hundred of them.
bool AreCounts(const std::vector<double>& readings);

}  // namespace robostress::calibration
