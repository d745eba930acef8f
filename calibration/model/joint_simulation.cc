#include "calibration/model/joint_simulation.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "calibration/model/arriving_commands.h"
#include "common/joint_errors/stick_friction.h"

namespace robostress::calibration {

namespace {
constexpr double kRunaway = 1e4;         // [rad]
constexpr double kSameSlope = 1e-3;      // of the servo's: less is no limit
constexpr double kObserverRate = 50;     // [1/s]
constexpr double kSureOfRest = 3;        // standard deviations between two readings
constexpr double kMostLoadSlope = 0.95;  // [Nm/Nm] of friction by the torque that it loads
}  // namespace

struct JointSimulation::State {
  double t = 0, q = 0, dq = 0, offset = 0;
  bool alone = false;  // the motor moves in a gap, and the link stands
};

namespace {

// Torque asked of the motor, and how it falls with the velocity [Nm s/rad] where it is not at a
// limit.
struct Asked {
  double torque = 0, slope = 0;
};

Asked ServoTorque(const Servo& servo, double command, double q, double dq) {
  if (servo.type == Servo::Type::kDcMotor) {
    const double voltage = std::clamp(servo.kp * (command - q), -servo.vin, servo.vin);
    const double back = servo.kt * servo.kt / servo.R;
    return {servo.kt / servo.R * voltage - back * dq, back};
  }
  const double torque = servo.kp * (command - q) - servo.kd * dq;
  if (std::abs(torque) > servo.torque_limit) return {std::copysign(servo.torque_limit, torque), 0};
  return {torque, servo.kd};
}

}  // namespace

std::vector<JointTrack> MakeTracks(const Plant& plant, const std::vector<MeasuredLog>& logs,
                                   int joint) {
  std::vector<JointTrack> tracks;
  for (const MeasuredLog& log : logs) {
    tracks.push_back({&log, joint, plant.single(), plant.Rows(joint, log)});
    const auto known = log.overrides.find(absl::StrCat(log.joints[joint].name, ".", kKnownMass));
    if (known != log.overrides.end()) tracks.back().known_mass = known->second;
  }
  return tracks;
}

double MeanInertia(const std::vector<JointTrack>& tracks) {
  double sum = 0, count = 0;
  for (const JointTrack& track : tracks)
    for (const PlantRow& row : track.rows) sum += row.inertia, count += 1;
  return count > 0 ? sum / count : 0;
}

JointSimulation::JointSimulation(const JointTrack& track) : track_(track) {
  sub_steps_ = std::max(1, static_cast<int>(std::ceil(track.log->dt / kMaxSubStep - 1e-6)));
  h_ = track.log->dt / sub_steps_;
}

JointSimulation::~JointSimulation() = default;

void JointSimulation::Predict(const JointModel& model, int window, const std::vector<char>& chosen,
                              StartOffset offset, absl::Span<double> predicted) {
  EffectChain chain(model);
  commands_ = ArrivingCommands(track_, model, chain, StepsOf(model));
  switch (model.input) {
    case JointInput::kPositionTarget:
    case JointInput::kTorque:
      return FreeRun(model, chain, window, chosen, offset, 0, {.readings = predicted});
    case JointInput::kTransmission:
      return Transmission(chain, predicted);
    case JointInput::kInverse:
      return Inverse(model, chain, predicted);
  }
}

void JointSimulation::PredictMotion(const JointModel& model, int window, int shift,
                                    StartOffset offset, const Motion& motion) {
  EffectChain chain(model);
  commands_ = ArrivingCommands(track_, model, chain, StepsOf(model));
  FreeRun(model, chain, window, {}, offset, shift, motion);
}

// Fills what depends on posture and time alone.
void JointSimulation::Describe(const EffectChain& chain, int row, double share, double q,
                               JointMoment& moment) {
  const PlantRow& p = plant(row);
  if (track_.single && (p.gravity.a != 0 || p.gravity.b != 0 || chain.needs_payload ||
                        chain.needs_tilt || track_.known_mass > 0))
    posture_.Turn(q);
  const auto value = [&](const PlantTerm& term) {
    return Evaluate(term, track_.single, posture_.cosine, posture_.sine, q, p.q_ref);
  };
  moment.gravity = value(p.gravity);
  if (chain.needs_payload || track_.known_mass > 0) {
    moment.payload_gravity = value(p.payload_gravity);
    moment.payload_inertia = p.payload_inertia;
  }
  if (chain.needs_tilt) {
    for (int i = 0; i < 2; ++i) moment.tilt_gravity[i] = value(p.tilt_gravity[i]);
  }
  if (!track_.record().temperature.empty()) moment.temperature = track_.record().temperature[row];
  if (chain.partner < 0) return;
  const JointRecord& partner = track_.log->joints[chain.partner];
  if (chain.at_rows) {
    moment.coupled_q = partner.q_smooth[row];
    moment.coupled_dq = partner.dq[row];
    moment.coupled_ddq = partner.ddq[row];
    return;
  }
  const size_t next = std::min(row + 1, track_.log->rows - 1);
  const auto at_share = [&](const std::vector<double>& values) {
    return values[row] + share * (values[next] - values[row]);
  };
  moment.coupled_q = at_share(partner.q_smooth);
  moment.coupled_dq = at_share(partner.motion.dq);
  moment.coupled_ddq = partner.motion.ddq[row];
  if (!partner.motion.rise.empty()) moment.coupled_ddq += (share - 0.5) * partner.motion.rise[row];
}

double JointSimulation::SubStep(const JointModel& model, EffectChain& chain, int row,
                                double command, State& s) {
  const PlantRow& p = plant(row);
  const double lead = 0.5 * h_ - model.force_lag;
  const double middle = s.q + lead * s.dq;
  JointMoment moment;
  moment.t = s.t;
  moment.h = h_;
  moment.q = middle;
  moment.dq = s.dq;
  const double share = (s.t + 0.5 * h_) / track_.log->dt - row;
  Describe(chain, row, share, middle, moment);

  Asked asked{command, 0};
  if (model.input == JointInput::kPositionTarget) {
    const double side = model.servo.feedback == ServoFeedback::kMotor
                            ? middle
                            : middle + chain.OffsetAt(middle, 0.5 * h_);
    asked = ServoTorque(model.servo, command, chain.Reading(side), s.dq);
  }
  if (!Enabled(row)) asked = {};
  moment.drive = model.torque_gain * chain.Drive(asked.torque, moment);
  const double servo_slope = asked.slope;
  asked.slope *= model.torque_gain * chain.DriveSlope(asked.torque, moment);
  DryFriction lasting{model.frictionloss, model.frictionloss};
  double held = moment.drive + model.torque_offset -
                model.mass_scale * (moment.gravity + p.coupling + (share - 0.5) * p.coupling_rise) -
                track_.known_mass * moment.payload_gravity -
                model.stiffness * (middle - model.spring_rest) - model.damping * s.dq;
  double inertia =
      model.armature + model.mass_scale * p.inertia + track_.known_mass * p.payload_inertia;
  for (JointEffect* effect : chain.with_memory) held += effect->Torque(moment, lasting);
  if (chain.needs_payload)
    for (const JointChain::Link& link : chain.stage(EffectStage::kJoint))
      inertia += link.effect->Inertia(moment);
  // Exact for damping and kd while the other torques hold, up to x^3 of x = h d / M:
  // h / M (1 - e^-x) / x; positive and without overshoot for every x.
  const auto kick_of = [&](double slope) {
    const double x = h_ * (model.damping + slope) / inertia;
    return h_ / (inertia * (1 + x * (1.0 / 2 + x / 12)));
  };
  double kick = kick_of(asked.slope);
  const auto stroke_at = [&](double dq) {
    moment.dq = dq;
    DryFriction dry = lasting;
    double torque = held;
    for (JointEffect* effect : chain.memoryless) torque += effect->Torque(moment, dry);
    return AdvanceDry(s.dq, torque, dry, kick / h_, h_);
  };
  DryStroke stroke = stroke_at(s.dq);
  // Friction that falls with the velocity drives itself: taken at the middle of the sub-step.
  double mean = 0.5 * (s.dq + stroke.dq);
  if (!chain.memoryless.empty() && mean * s.dq > 0) stroke = stroke_at(mean);
  // Where the torque reaches a limit within the sub-step, or leaves one, its mean by Simpson's
  // rule.
  const double asked_last = asked.torque - servo_slope * (stroke.dq - s.dq);
  if (const double last = model.torque_gain * servo_slope * chain.DriveSlope(asked_last, moment);
      std::abs(last - asked.slope) > kSameSlope * servo_slope) {
    const auto drive_at = [&](double torque) {
      return model.torque_gain * chain.Drive(torque, moment);
    };
    const double drive = (drive_at(asked.torque) + 4 * drive_at(0.5 * (asked.torque + asked_last)) +
                          drive_at(asked_last)) /
                         6;
    held += drive - moment.drive;
    moment.drive = drive;
    asked.slope = 0;
    kick = kick_of(0);
    stroke = stroke_at(s.dq + 0.5 * (stroke.dq - s.dq));
    mean = 0.5 * (s.dq + stroke.dq);
  }
  // Until now it was the motor's torque at the velocity that the sub-step began with.
  moment.drive -= asked.slope * (mean - s.dq);
  s.q += stroke.way;
  s.dq = stroke.dq;
  s.t += h_;
  moment.q = s.q;
  moment.dq = s.dq;
  s.offset = chain.Offset(moment);
  return moment.drive;
}

// The moment at the beginning of a step of a row, as measured; the velocity is the step's. The
// motor's angle is the link's less the offset; inside a gap, where the link says nothing of it, it
// follows the motor's velocity where that was logged, else the model's own motion.
JointMoment JointSimulation::MeasuredMoment(const JointModel& model, const EffectChain& chain,
                                            int row, int step, const State& s) {
  const JointRecord& record = track_.record();
  const int steps = LeadSteps(chain);
  const double share = static_cast<double>(step) / steps;
  const int next = std::min(row + 1, track_.log->rows - 1);
  const double link =
      chain.LinkOf(record.q_smooth[row] + share * (record.q_smooth[next] - record.q_smooth[row]));
  JointMoment moment;
  moment.h = track_.log->dt / steps;
  moment.t = (row + share) * track_.log->dt;
  const double middle = (step + 0.5) / steps;
  moment.dq = record.dq[row] + middle * (record.dq[next] - record.dq[row]);
  moment.q = chain.MovesAlone(moment.dq) ? s.q : chain.MotorOf(link);
  moment.dq /= chain.SpeedRatio(moment.q);
  Describe(chain, row, middle, moment.q, moment);
  const double command =
      commands_[static_cast<size_t>(row) * sub_steps_ + step * sub_steps_ / steps];
  double asked = command;
  if (model.input == JointInput::kPositionTarget) {
    const double side = model.servo.feedback == ServoFeedback::kMotor ? moment.q : link;
    asked = ServoTorque(model.servo, command, chain.Reading(side), moment.dq).torque;
  }
  if (!Enabled(row)) asked = 0;
  moment.drive = model.torque_gain * chain.Drive(asked, moment);
  return moment;
}

// The link's velocity until the next row. Where it comes to rest between two rows the smoothed one
// rounds the corner, and the readings say it.
double JointSimulation::LinkSpeed(int row) const {
  const JointRecord& record = track_.record();
  const int next = std::min(row + 1, track_.log->rows - 1), from = next - 1;
  const double read = (record.q[next] - record.q[from]) / track_.log->dt;
  const double noise = kSureOfRest * std::sqrt(2.0) * record.noise / track_.log->dt;
  if (std::abs(read - record.dq[row]) <= noise) return record.dq[row];
  return std::abs(read) > noise ? read : 0;
}

// The link's velocity at a row, from the readings before it alone; 0 where they end at rest.
double JointSimulation::SpeedInto(int row) const {
  const JointRecord& record = track_.record();
  if (row < 2) return record.dq[row];
  const double last = (record.q[row] - record.q[row - 1]) / track_.log->dt;
  const double ahead = 1.5 * last - 0.5 * (record.q[row - 1] - record.q[row - 2]) / track_.log->dt;
  return ahead * last > 0 ? ahead : 0;
}

// The row from which the state of row `start` is led. Where memory is long it is the same for all
// windows of a span, whichever are chosen: they are led one after the other.
int JointSimulation::LeadFrom(int start, const EffectChain& chain) const {
  const double dt = track_.log->dt;
  if (!chain.has_state) return std::max(0, start - 1);
  if (!chain.remembers_way()) return std::max(0, start - static_cast<int>(kWarmUp / dt));
  const int span = std::max(1, static_cast<int>(kLeadSpan / dt));
  return std::max(0, start / span * span - static_cast<int>(kLongWarmUp / dt));
}

void JointSimulation::BeginLead(const JointModel& model, EffectChain& chain, int first, State& s) {
  const JointRecord& record = track_.record();
  s = {.q = chain.LinkOf(record.q_smooth[first]), .dq = record.dq[first]};
  chain.Reset({.h = h_});  // of the lead before
  const JointMoment moment = MeasuredMoment(model, chain, first, 0, s);
  chain.Reset(moment);
  s.offset = chain.Offset(moment);
}

// Along the measured motion, rows first ... last - 1; leaves the state at row `last`.
void JointSimulation::Lead(const JointModel& model, EffectChain& chain, int first, int last,
                           State& s) {
  const JointRecord& record = track_.record();
  // Critically damped, as an alpha-beta filter.
  const double dt = track_.log->dt, z = std::exp(-kObserverRate * dt);
  for (int row = first; row < last; ++row) {
    s.t = row * dt;
    if (chain.oscillates) {
      for (int i = 0; i < sub_steps_; ++i)
        SubStep(model, chain, row, commands_[static_cast<size_t>(row) * sub_steps_ + i], s);
      const double ahead = chain.LinkOf(record.q_smooth[row + 1]) - s.q - s.offset;
      if (chain.MovesAlone(s.dq)) continue;
      s.q += (1 - z * z) * ahead;
      s.dq += (1 - z) * (1 - z) / dt * ahead;
      continue;
    }
    // The motor turns round where the link comes to rest, perhaps within this row.
    const bool rests = chain.MovesAlone(LinkSpeed(row));
    if (!record.velocity_of_motor &&
        (rests || (!s.alone && chain.MovesAlone(LinkSpeed(row + 1))))) {
      if (!s.alone) {
        s.q = chain.MotorOf(chain.LinkOf(record.q[row]));
        s.dq = rests ? 0 : SpeedInto(row);
      }
      s.alone = true;
      for (int i = 0; i < sub_steps_; ++i)
        SubStep(model, chain, row, commands_[static_cast<size_t>(row) * sub_steps_ + i], s);
      continue;
    }
    s.alone = false;
    for (int i = 0; i < LeadSteps(chain); ++i) {
      const JointMoment moment = MeasuredMoment(model, chain, row, i, s);
      DryFriction ignored;
      for (JointEffect* effect : chain.with_memory) effect->Torque(moment, ignored);
      s.offset = chain.Offset(moment);
      s.q = moment.q + moment.h * moment.dq;
      s.dq = moment.dq;
    }
  }
  s.t = last * dt;
  const bool alone = chain.MovesAlone(LinkSpeed(last));
  if (!alone) {
    s.q = chain.MotorOf(chain.LinkOf(record.q_smooth[last]));
    s.offset = chain.OffsetAt(s.q);
  }
  if (record.velocity_of_motor) {
    s.dq = record.dq[last];
  } else if (!alone && !chain.oscillates) {
    s.dq = record.dq[last] / chain.SpeedRatio(s.q);
  }
}

void JointSimulation::FreeRun(const JointModel& model, EffectChain& chain, int window,
                              const std::vector<char>& chosen, StartOffset offset, int shift,
                              const Motion& motion) {
  const int rows = track_.log->rows;
  if (window <= 0) window = rows;
  State led;
  int led_from = -1, led_to = 0;
  for (int start = 0, end = 0; start < rows; start = end) {
    end = std::min(rows, start == 0 && shift > 0 ? shift : start + window);
    if (!chosen.empty() && chosen[start / window] == 0) continue;
    if (const int from = LeadFrom(start, chain); from != led_from) {
      BeginLead(model, chain, from, led);
      led_from = led_to = from;
    }
    Lead(model, chain, led_to, start, led);
    led_to = start;
    if (chain.has_state) {
      EffectChain own = chain.Copy();
      Run(model, own, start, end, led, offset, motion);
    } else {
      Run(model, chain, start, end, led, offset, motion);
    }
  }
}

void JointSimulation::Run(const JointModel& model, EffectChain& chain, int start, int end, State s,
                          StartOffset offset, const Motion& motion) {
  s.q += offset.q;
  s.dq += offset.dq;
  for (int row = start; row < end; ++row) {
    // A model that runs away is far off, but a number: fits then turn back.
    if (!(std::abs(s.q) < kRunaway)) s = {s.t, std::copysign(kRunaway, s.q)};
    motion.readings[row] = chain.Reading(s.q + s.offset);
    if (!motion.velocities.empty()) motion.velocities[row] = s.dq;
    if (!motion.motor.empty()) motion.motor[row] = s.q;
    if (!motion.link.empty()) motion.link[row] = s.q + s.offset;
    double drive = 0;
    for (int i = 0; i < sub_steps_; ++i)
      drive += SubStep(model, chain, row, commands_[static_cast<size_t>(row) * sub_steps_ + i], s);
    if (!motion.drive.empty()) motion.drive[row] = drive / sub_steps_;
  }
}

void JointSimulation::Transmission(EffectChain& chain, absl::Span<double> predicted) {
  const JointRecord& record = track_.record();
  const int rows = track_.log->rows, steps = chain.has_state ? kMotorSteps : 1;
  const auto between = [&](const std::vector<double>& values, int row, double share) {
    if (values.empty()) return 0.0;
    return values[row] + share * (values[std::min(row + 1, rows - 1)] - values[row]);
  };
  JointMoment moment;
  moment.h = track_.log->dt / steps;
  moment.q = commands_[0];
  moment.drive = between(record.tau, 0, 0);
  chain.Reset(moment);
  for (int row = 0; row < rows; ++row) {
    for (int i = 0; i < steps; ++i) {
      const double share = static_cast<double>(i) / steps;
      moment.t = (row + share) * track_.log->dt;
      moment.q = commands_[static_cast<size_t>(row) * kMotorSteps + i];
      moment.dq = between(record.dq, row, share);
      moment.drive = between(record.tau, row, share);
      const double offset = chain.Offset(moment);
      if (i == 0) predicted[row] = chain.Reading(moment.q + offset);
    }
  }
}

// The motor's torque that the measured motion of a row asks for. Friction that depends on this
// torque takes it from here and never from the log, where it would explain the torque by itself: as
// it grows in proportion to its size, the line through two points meets it.
double JointSimulation::Load(const JointModel& model, EffectChain& chain, int row,
                             JointMoment& moment) {
  const JointRecord& record = track_.record();
  const PlantRow& p = plant(row);
  DryFriction lasting{model.frictionloss, model.frictionloss};
  double inertia =
      model.armature + model.mass_scale * p.inertia + track_.known_mass * p.payload_inertia;
  double held = model.mass_scale * (moment.gravity + p.coupling) - model.torque_offset +
                track_.known_mass * moment.payload_gravity +
                model.stiffness * (moment.q - model.spring_rest) + model.damping * moment.dq;
  for (const JointChain::Link& link : chain.stage(EffectStage::kJoint)) {
    if (link.effect->Reads() & kDriveField) continue;
    held -= link.effect->Torque(moment, lasting);
    inertia += link.effect->Inertia(moment);
  }
  held += inertia * record.ddq[row];
  // Smooth through rest, where the direction is noise.
  const double speed = 2 * record.start_noise_dq;
  const double direction = std::tanh(moment.dq / std::max(speed, 1e-9));
  const auto load_at = [&](double drive) {
    moment.drive = drive;
    DryFriction dry = lasting;
    double torque = held;
    for (JointEffect* effect : chain.of_drive) torque -= effect->Torque(moment, dry);
    return torque + direction * std::max(0.0, direction > 0 ? dry.forward : dry.backward);
  };
  const double first = load_at(0);
  if (chain.of_drive.empty() || first == 0) return first;
  const double slope = (load_at(first) - first) / first;
  return first / (1 - std::min(slope, kMostLoadSlope));
}

void JointSimulation::Inverse(const JointModel& model, EffectChain& chain,
                              absl::Span<double> predicted) {
  const JointRecord& record = track_.record();
  JointMoment moment;
  moment.h = track_.log->dt;
  for (int row = 0; row < track_.log->rows; ++row) {
    moment.t = row * moment.h;
    moment.q = chain.LinkOf(record.q_smooth[row]);
    moment.dq = record.dq[row];
    Describe(chain, row, 0, moment.q, moment);
    if (row == 0) chain.Reset(moment);
    const double load = Load(model, chain, row, moment);
    predicted[row] = chain.Asked(load / model.torque_gain, record.tau[row], moment);
  }
}

}  // namespace robostress::calibration
