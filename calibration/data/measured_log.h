#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"

namespace robostress::calibration {

// Position and velocity per row, and of the acceleration until the next row its mean and how much
// it rises, as a line [rad, rad/s, rad/s^2, rad/s^2]. Where nobody knows a rise it is empty.
struct JointMotion {
  std::vector<double> q, dq, ddq, rise;
};

// What one joint did in one run, on a uniform clock. Channels that the input does not need and the
// file does not have are empty.
struct JointRecord {
  std::string name;
  std::vector<double> command;      // q_cmd_<joint> [rad]
  std::vector<double> q;            // q_<joint>; of a transmission q_link_<joint> [rad]
  std::vector<double> q_motor;      // q_motor_<joint> [rad], of a transmission
  std::vector<double> tau;          // tau_<joint> [Nm]
  std::vector<double> temperature;  // temp_<joint> [deg C]
  std::vector<double> enable;       // 0 where the drive is off; empty: always on
  // From q (of a transmission q_motor) by local quadratics, and what noise is in them
  // [rad, rad/s, rad/s^2]; dq is dq_<joint> where the file has it and it is the derivative of q
  // with no more noise.
  std::vector<double> q_smooth, dq, ddq;
  bool velocity_logged = false;    // dq is the file's
  bool velocity_of_motor = false;  // and the motor's (VelocitySide::kMotor)
  // What the other joints of an arm see of this one: those, or what AidArmMotions makes of them.
  JointMotion motion;
  double start_noise_q = 0, start_noise_dq = 0, acceleration_noise = 0;
  // [rad] standard deviation of q about those; of a transmission of both readings together.
  double noise = 0;
  // Where rows were read at other moments than the log says, the noise grows with speed: its part
  // at rest [rad], and the deviation of those moments [s]. timing_noise 0: `noise` is all.
  double still_noise = 0, timing_noise = 0;
  // Readings were drawn through by lines, which cut the corners of a motion by up to ddq dt^2 / 8.
  bool drawn = false;
  double dt = 0;  // [s]
  // Where the log draws lines between commands that may have held: the command that steps, and the
  // rows from one step to the next; 0: there is no such doubt.
  std::vector<double> stepped_command;
  int step_rows = 0;
  // Variance of the noise over rows first ... first + count - 1 [rad^2].
  double NoiseVariance(int first, int count) const;
};

struct MeasuredLog {
  std::string file, condition;
  LogRole role = LogRole::kFit;
  std::map<std::string, double> overrides;
  double dt = 0;  // [s]
  int rows = 0;
  std::vector<JointRecord> joints;  // in the order of the rig
  // [rows] lost by the recorder and filled in: kFilled, or kGuessed where what was filled in is off
  // by more than the noise, so that a free run can not go on through it; else 0. Empty: none.
  std::vector<char> absent;
  static constexpr char kFilled = 1, kGuessed = 2;
  static constexpr int kSmoothing = 12;  // rows each side, at most, that a state is read from
  int lost_rows = 0;
  double clock_jitter = 0;         // [rows] that channels were resampled for; 0: they were not
  std::vector<std::string> notes;  // what the reader found and what it did about it
};

// Means of a value at rows with that of the next row; the last one as it is.
std::vector<double> UntilNextRow(std::vector<double> at_rows);

// Reads a log of `rig` and gates it: header, numbers, clock (jitter, gaps, rate), wraps, constant
// channels, excitation, saturation. Errors name file, line, column, value and remedy; what can be
// repaired is, and is noted.
absl::StatusOr<MeasuredLog> ReadMeasuredLog(const Rig& rig, const RigLog& log);

}  // namespace robostress::calibration
