#pragma once

#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "calibration/data/measured_log.h"
#include "calibration/model/effect_chain.h"
#include "calibration/model/joint_model.h"
#include "calibration/model/plant.h"
#include "calibration/model/posture.h"

namespace robostress::calibration {

// One joint in one log: what its model is driven with and compared to.
struct JointTrack {
  const MeasuredLog* log = nullptr;
  int joint = 0;               // index in the rig
  bool single = true;          // of the plant
  std::vector<PlantRow> rows;  // one, or one per row of the log
  double known_mass = 0;       // [kg] at the payload's place, beside the model and its errors
  const JointRecord& record() const { return log->joints[joint]; }
  // What predictions are compared with: q, or tau of input inverse.
  const std::vector<double>& measured(JointInput input) const {
    return input == JointInput::kInverse ? record().tau : record().q;
  }
};

std::vector<JointTrack> MakeTracks(const Plant& plant, const std::vector<MeasuredLog>& logs,
                                   int joint);
// Of the rows of all tracks, without armature [kg m^2].
double MeanInertia(const std::vector<JointTrack>& tracks);

// Predicts a track with a model: the simulation kernel of calibration.
//
// Free runs start from the measured position and velocity every `window` rows and go on with the
// model's alone; the hidden states of effects are led along the measured motion before. One
// sub-step is a drift-kick-drift leapfrog: second order, no drift of energy; damping and the
// servo's kd act implicitly; dry friction stops a joint within the sub-step (friction law `stick`).
// Commands hold over a row.
class JointSimulation {
 public:
  static constexpr double kWarmUp = 0.25;  // [s] of leading before a free run
  // Bristles remember a way, not a time, and a motor may dwell in a gap: their state is led through
  // the windows of a span one after the other.
  static constexpr double kLeadSpan = 10;      // [s]
  static constexpr double kLongWarmUp = 5;     // [s] before the span
  static constexpr double kMaxSubStep = 1e-3;  // [s]
  // Of a row between two encoders: a motor turns between rows, and a gap is taken up there.
  static constexpr int kMotorSteps = 8;

  explicit JointSimulation(const JointTrack& track);
  ~JointSimulation();

  // Added to where free runs start.
  struct StartOffset {
    double q = 0;   // [rad]
    double dq = 0;  // [rad/s]
  };
  // predicted [rows]. window [rows]: 0 is the whole log. `chosen` [windows]: rows of windows that
  // it holds zero for may be left as they are; empty: all.
  void Predict(const JointModel& model, int window, const std::vector<char>& chosen,
               StartOffset offset, absl::Span<double> predicted);
  // What free runs write, each [rows], or empty where nobody asks.
  struct Motion {
    absl::Span<double> readings;    // [rad]
    absl::Span<double> velocities;  // [rad/s]
    absl::Span<double> motor;       // [rad] before the transmission
    absl::Span<double> link;        // [rad] behind it, as it is and not as it is read
    absl::Span<double> drive;       // [Nm] of the motor, mean until the next row
  };
  // Free runs that start at row 0, at row `shift`, and every window after. `motion` has readings.
  void PredictMotion(const JointModel& model, int window, int shift, StartOffset offset,
                     const Motion& motion);

 private:
  struct State;
  // At a share of the way to the next row.
  void Describe(const EffectChain& chain, int row, double share, double q, JointMoment& moment);
  // Of ArrivingCommands, to a row.
  int StepsOf(const JointModel& model) const {
    return model.input == JointInput::kTransmission ? kMotorSteps : sub_steps_;
  }
  void FreeRun(const JointModel& model, EffectChain& chain, int window,
               const std::vector<char>& chosen, StartOffset offset, int shift,
               const Motion& motion);
  // One free run, rows start ... end - 1.
  void Run(const JointModel& model, EffectChain& chain, int start, int end, State state,
           StartOffset offset, const Motion& motion);
  void Transmission(EffectChain& chain, absl::Span<double> predicted);
  double Load(const JointModel& model, EffectChain& chain, int row, JointMoment& moment);
  void Inverse(const JointModel& model, EffectChain& chain, absl::Span<double> predicted);
  // The motor's torque [Nm].
  double SubStep(const JointModel& model, EffectChain& chain, int row, double command,
                 State& state);
  JointMoment MeasuredMoment(const JointModel& model, const EffectChain& chain, int row, int step,
                             const State& state);
  double LinkSpeed(int row) const;
  double SpeedInto(int row) const;
  // Steps of a row while leading: only an oscillation needs the simulation's.
  int LeadSteps(const EffectChain& chain) const { return chain.oscillates ? sub_steps_ : 1; }
  int LeadFrom(int start, const EffectChain& chain) const;
  void BeginLead(const JointModel& model, EffectChain& chain, int first, State& state);
  void Lead(const JointModel& model, EffectChain& chain, int first, int last, State& state);
  const PlantRow& plant(int row) const {
    return track_.rows[track_.single ? 0 : static_cast<size_t>(row)];
  }

  // Whether the drive is on.
  bool Enabled(int row) const {
    const std::vector<double>& enable = track_.record().enable;
    return enable.empty() || enable[row] >= 0.5;
  }

  const JointTrack& track_;
  int sub_steps_;
  double h_;
  // After the command stage [rows * sub_steps]; of a transmission [rows * kMotorSteps].
  std::vector<double> commands_;
  Posture posture_;
};

}  // namespace robostress::calibration
