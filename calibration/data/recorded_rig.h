#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"

namespace robostress::calibration {

// One recorded episode of an arm, in the form that every recorder is brought to: rows at a uniform
// rate, torques that hold over a row.
struct RecordedEpisode {
  std::string name;   // of its logs and its condition: "task0_episode3"
  std::string group;  // what it was a run of, for the transfer role: "tabletop_goal task 0"
  double rate_hz = 0;
  std::vector<double> t;                   // [rows] s
  std::vector<std::vector<double>> q, dq;  // [joints][rows] rad, rad/s; dq may be empty
  std::vector<std::vector<double>> tau;    // [joints][rows] Nm, asked of the motors
  std::vector<std::vector<double>>
      command;                    // [joints][rows] rad, asked of the servos; may be empty
  std::vector<double> contact_N;  // [rows] contact forces on the arm; empty: not measured
};

// What is needed of a robot beside its episodes.
struct RecordedArm {
  std::string name;                 // of the rig
  std::string model_file;           // name of the MJCF beside the rig
  std::string mjcf;                 // its text
  std::vector<std::string> joints;  // of the MJCF, in the order of RecordedEpisode::q
  VelocitySide velocity = VelocitySide::kReading;  // of RecordedEpisode::dq
  std::vector<std::string> fit;                    // declared parameters that every joint fits
  // kPositionTarget: `servo` and `effects` are declared of every joint, RecordedEpisode::command
  // drives it.
  JointInput input = JointInput::kTorque;
  Servo servo;
  std::vector<DeclaredEffect> effects;
  // Instead of all that but name and joints: a rig whose model and joints are taken over as they
  // stand; `joints` are of it.
  std::optional<Rig> declared;
};

// An arm of `rig`, and its episodes of those channels alone that the rig has. `names`: what the rig
// calls the episodes' joints, in order; empty: it has all of them. INVALID_ARGUMENT where they do
// not fit, or where its joints are not driven alike, by targets or by torques.
absl::StatusOr<RecordedArm> ArmOfRig(const Rig& rig, std::vector<std::string> names,
                                     std::vector<RecordedEpisode>* episodes);

struct RecordedRigOptions {
  // Rows while contacts push harder than this are left out, with `contact_margin_s` on both sides:
  // the rig's model has no objects, and what an object does to a joint is no error of the joint.
  double contact_limit_N = 1;
  double contact_margin_s = 0.05;
  // What is left falls into pieces, each a log; shorter ones are dropped.
  double min_piece_s = 0.4;
  // Noise to add to the angles [rad], and kVelocityNoise times that to the velocities: a
  // simulator's readings are exact, a robot's are not, and a trace that knows no noise takes the
  // last digits of the integrators for effects. Seeded.
  static constexpr double kVelocityNoise = 10;  // [1/s]
  double encoder_noise = 2e-5;
  uint64_t seed = 0;
  double window_s = 0.25;  // metric.window_s
  int held_out_every = 3;  // of the episodes of a group, the last of so many is held out
  bool transfer = true;    // the last group is the transfer regime, where there are several
};

struct RecordedRigSummary {
  std::string rig_file;
  int episodes = 0, pieces = 0;
  // Left out: near contacts, pieces that are short or in which a joint stands still.
  double seconds = 0, seconds_left_out = 0;
  std::array<int, 3> logs_of_role{};  // fit, held_out, transfer
};

// Writes out/rig.yaml, the model and one CSV per piece. Roles go by episode, so that no episode is
// both fitted and held out: with groups in the order of their first episode, the last group is
// transfer (if transfer is on and there are two or more); of every other group each
// held_out_every-th episode is held_out; the rest is fit. Every piece of an episode has the
// episode's name as its condition, and folds go by condition. The other joints'
// motion is what was measured. FailedPrecondition where too little free motion is left.
absl::StatusOr<RecordedRigSummary> WriteRecordedRig(const RecordedArm& arm,
                                                    const std::vector<RecordedEpisode>& episodes,
                                                    const RecordedRigOptions& options,
                                                    const std::string& out);

}  // namespace robostress::calibration
