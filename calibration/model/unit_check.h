#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/measured_log.h"
#include "calibration/model/plant.h"

namespace robostress::calibration {

// Refuses logs that are not in radians (or metres) and newton metres by what is physically possible
// for the declared model, as far as a log by itself does not tell (log_units.h). The error names
// file, joint, what is impossible and the factor that mends it:
// - a joint travels farther than between its stops;
// - the servo asks for 180 / pi times the torque that was logged;
// - the drive's torque is more than 100 times, or the opposite of, what the motion asks of the
// model;
// - a link gains more kinetic energy than its drive and gravity have given it;
// - a link that gravity pulls at turns at accelerations, or a slide at speeds, that no robot has;
// - gravity acts as it does on the positions taken as degrees, and not as they stand.
// A motion that is slow or small in radians does nothing of this. Of a linear joint (no gravity, no
// torque logged, no stops) no unit follows: its logs pass. Returns the joints of which this is so:
// nothing would be impossible either if their motion were larger by 180 / pi (of a slide 1000).
absl::StatusOr<std::vector<std::string>> CheckUnits(const Rig& rig, const Plant& plant,
                                                    const std::vector<MeasuredLog>& logs);

}  // namespace robostress::calibration
