#pragma once

#include <vector>

namespace robostress::calibration {

// Standard deviation [s] of the moments at which a signal was read about the moments that its rows
// give, from noise that grows with speed: the noise of a reading is still^2 + (timing dq)^2. The
// noise is that of differences of several orders, which agree on noise and not on a motion.
struct ReadingNoise {
  double still = 0;   // [rad]
  double timing = 0;  // [s]; 0: the noise does not grow with speed
};
ReadingNoise NoiseBySpeed(const std::vector<double>& signal, const std::vector<double>& dq);

// A slow reading in steps, as of a temperature, on lines through the middles of its steps: it is
// known best where it steps. One with more values than steps can be is as it was.
std::vector<double> BetweenSteps(std::vector<double> reading);

// Rows from one step of a command to the next, where the log draws lines between steps that hold:
// it bends at every such row, and nowhere else. 0: it does not.
int RowsBetweenBends(const std::vector<double>& command);
// Whether a command bends at every `rows`-th row at most, as moves with straight parts do that were
// logged like one of which RowsBetweenBends says so.
bool BendsEvery(const std::vector<double>& command, int rows);

// Share of the steps of a command that pass through a row between. Lines that were drawn through
// rows and read at other times put one there as often as a row was shorter before than it is now:
// the share is that ratio. 0: the steps are sharp, or there are few.
double DrawnSteps(const std::vector<double>& command);

// Mean of the command that held, from each row to the next, where its steps were drawn as
// `DrawnSteps` says: the row between tells when a new command began.
std::vector<double> MeansOfDrawnSteps(const std::vector<double>& command, double share);

// The command that steps where `command` bends, every `rows` rows.
std::vector<double> StepsOfLines(const std::vector<double>& command, int rows);

}  // namespace robostress::calibration
