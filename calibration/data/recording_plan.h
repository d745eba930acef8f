#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recording_statistics.h"
#include "calibration/data/rig.h"

namespace robostress::calibration {

// What the user knows of a recording.
struct RecordingOptions {
  std::vector<std::string> joints;  // empty: those that move, of the messages that are most
  std::string topic;                // channel of the positions; empty: chosen
  std::string commands;             // channel of the commands, however far they are; empty: chosen
  // Whether commands stand by their stamps or by the recorder's times.
  enum class CommandTimes { kChosen, kStamps, kRecorder };
  CommandTimes command_times = CommandTimes::kChosen;
  // Factor from the recording's angles to radians (metres of a slide); 0: what the recording says.
  double to_rad = 0;
  std::map<std::string, double> to_rad_of;  // of these joints
  // What drives the joints of a rig that is taken over; others: commands, or without them torques.
  std::map<std::string, JointInput> inputs;
  double rate_hz = 0;  // of rows that have no times of their own; 0: what the file says
};

struct PlannedJoint {
  std::string name;  // in the rig
  // Signals; -1: there is none.
  int q = -1, dq = -1, tau = -1, command = -1;
  std::string command_because;  // why this is its command
  bool command_in_row = false;  // whether it stands in the message of the position
  JointInput input = JointInput::kPositionTarget;
  double to_rad = 1;
};

// Which of a recording's signals become a rig, and what of the recording is said in sentences.
struct RecordingPlan {
  std::vector<PlannedJoint> joints;  // empty: no rig; why_none says why
  std::string why_none;
  size_t channel = 0;           // of the positions
  std::string channel_because;  // why not another one that holds the same joints; empty: no matter
  // Channels of commands that stand by the recorder's times: their stamps are of another clock.
  std::set<size_t> by_recorder;
  bool by_stamp = false;  // whether rows stand at header.stamp, else at the recorder's time
  double rate_hz = 0;
  double made_up_rate_hz = 0;  // RecordingOptions::rate_hz
  double dt = 0;               // [s] between two rows
  double longest_piece_s = 0;
  std::string model;                   // file of the first rig's model; empty: to be filled in
  std::vector<std::string> sentences;  // what was left out and why
};

// INVALID_ARGUMENT where the options name what is not there.
absl::StatusOr<RecordingPlan> PlanRecording(const RecordingStatistics& statistics,
                                            const RecordingOptions& options);

// Whether a joint is one by its name: its numbers are seldom angles, rather percent of its way,
// metres or counts.
bool IsGripper(const std::string& joint);

inline constexpr int64_t kLeastRows = 50;  // of a log (measured_log.cc)
// A joint that spans less stands still [rad].
inline constexpr double kStill = 0.01;

}  // namespace robostress::calibration
