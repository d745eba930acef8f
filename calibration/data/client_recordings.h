#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"

namespace robostress::calibration {

// Whether `run` is a directory that robot_client left (robot_client/README.md).
bool IsClientRun(const std::string& run);

// The free motion in a run of robot_client: what samples.csv holds while ticks.csv says RUN, MOVE
// or HOLD, one episode or way each; a sample that was lost, or came four periods late, begins
// another. Fewer than `at_least` of them are cut into equal parts, so that some can be held out. A
// row's torque is the mean over it of the arm's readings at both ends, its command what was sent
// last; contacts are not known.
// Errors name file, line, column and remedy.
absl::StatusOr<std::vector<RecordedEpisode>> EpisodesOfClientRun(const std::string& run,
                                                                 int at_least);

// What rigs call the arm's joints, in order, by the run's arm.json; nothing: a run from before
// there was one. INVALID_ARGUMENT: it is no list of names.
absl::StatusOr<std::optional<std::vector<std::string>>> JointNamesOfClientRun(
    const std::string& run);

// How the joints of an arm answer targets (adapter/joint_response.h), as a rig: every joint is a
// unit mass of its own with a servo and these two effects, all of them fitted.
inline constexpr char kResponseDelay[] = "transport_delay";
inline constexpr char kResponseDrag[] = "quadratic_viscous_friction";
RecordedArm ArmResponse(const std::string& rig_name, int joints);

// The Piper of robot_client/emulator without a scene, the payload [kg] in its closed gripper.
// Armatures are fitted: nobody has published a Piper's rotors.
RecordedArm PiperOfRecordings(const std::string& rig_name, double payload_kg);

}  // namespace robostress::calibration
