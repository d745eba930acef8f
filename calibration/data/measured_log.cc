#include "calibration/data/measured_log.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/data/local_polynomial.h"
#include "calibration/data/log_faults.h"
#include "calibration/data/log_units.h"
#include "calibration/data/row_clock.h"
#include "common/csv_table.h"
#include "common/statistics.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr uint64_t kMaxBytes = uint64_t{4} << 30;
constexpr int kMinRows = 50;
constexpr int kSmoothing = MeasuredLog::kSmoothing;
constexpr double kCorner = 1.0 / 8;      // of ddq dt^2
constexpr double kGap = 5;               // in dt; more is refused
constexpr double kRateError = 0.02;      // of the declared rate
constexpr double kBesideATurn = 0.5;     // [rad] a row, of motion while an angle wraps
constexpr double kSpanTolerance = 0.3;   // of a unit, from spans of a command and its answer
constexpr double kFollows = 0.5;         // squared correlation of a velocity and a derivative
constexpr double kGainTolerance = 0.15;  // of a unit, from a velocity and a derivative
constexpr double kSaturated = 0.02;      // share of rows at the largest torque

// Refuses a clock that does not run.
absl::StatusOr<RowClock> CheckClock(const CsvTable& table, const std::vector<double>& t,
                                    double rate_hz) {
  if (t.size() < kMinRows)
    return absl::InvalidArgumentError(absl::StrCat(table.path(), ": has ", t.size(),
                                                   " rows, at least ", kMinRows, " are needed"));
  std::vector<double> steps;
  for (size_t i = 1; i < t.size(); ++i) {
    if (t[i] <= t[i - 1])
      return absl::InvalidArgumentError(absl::StrFormat(
          "%s: t is %.15g after %.15g; the clock must increase", table.Place(i), t[i], t[i - 1]));
    steps.push_back(t[i] - t[i - 1]);
  }
  const double dt = UpperMedian(steps);
  if (std::abs(dt * rate_hz - 1) > kRateError) {
    const std::string unit = UnitOfClock(dt * rate_hz, kRateError);
    return absl::InvalidArgumentError(absl::StrCat(
        table.path(), ": t runs at ", 1 / dt, " rows per second, the rig's rate_hz is ", rate_hz,
        "; ", unit.empty() ? "is t in seconds?" : absl::StrCat("the times are ", unit)));
  }
  RowClock clock;
  double off = 0;
  for (size_t i = 0; i < steps.size(); ++i) {
    if (steps[i] > kGap * dt)
      return absl::InvalidArgumentError(absl::StrCat(table.Place(i + 1), ": a gap of ", steps[i],
                                                     " s (", steps[i] / dt,
                                                     " rows); split the log there"));
    const double rows = std::max(1.0, std::round(steps[i] / dt));
    clock.lost += static_cast<int>(rows) - 1;
    off = std::max(off, std::abs(steps[i] / dt - rows));
  }
  clock.dt = (t.back() - t.front()) / static_cast<double>(steps.size() + clock.lost);
  if (off <= RowClock::kJitter) return clock;
  clock.dt = 1 / rate_hz;
  clock.jitter = off;
  return clock;
}

void NoteClock(const RowClock& clock, size_t rows, double rate_hz,
               std::vector<std::string>& notes) {
  if (clock.jitter > 0)
    notes.push_back(absl::StrCat("the clock jitters by up to ", std::round(clock.jitter * 100),
                                 " % of a row; channels were resampled to ", rate_hz,
                                 " rows per second"));
  if (clock.lost > 0)
    notes.push_back(absl::StrCat(clock.lost, " of ", rows + clock.lost,
                                 " rows are missing; they were filled in, and nothing is compared "
                                 "there"));
}

// Takes jumps by a whole turn out of an angle that was read at `t`. Before anything is drawn
// through its rows: a curve through a jump has values that no turn mends.
int Unwrap(const std::vector<double>& t, double dt, std::vector<double>& angle) {
  int wraps = 0;
  double turn = 0;
  for (size_t i = 1; i < angle.size(); ++i) {
    angle[i] += turn;
    const double jump = angle[i] - angle[i - 1], rows = std::max(1.0, (t[i] - t[i - 1]) / dt);
    if (std::abs(std::abs(jump) - 2 * M_PI) < std::min(kBesideATurn * rows, M_PI / 2)) {
      const double back = jump > 0 ? -2 * M_PI : 2 * M_PI;
      turn += back;
      angle[i] += back;
      ++wraps;
    }
  }
  return wraps;
}

void UnwrapJoint(const std::vector<double>& t, double dt, JointRecord& record,
                 std::vector<std::string>& notes) {
  int wraps = 0;
  for (auto* angle : {&record.q, &record.q_motor, &record.command}) wraps += Unwrap(t, dt, *angle);
  if (wraps == 0) return;
  // Both may have begun on another turn.
  for (auto* angle : {&record.q_motor, &record.command}) {
    if (angle->empty()) continue;
    const double turns = std::round((record.q.front() - angle->front()) / (2 * M_PI));
    for (double& value : *angle) value += 2 * M_PI * turns;
  }
  notes.push_back(absl::StrCat(record.name, ": ", wraps, " jumps by a whole turn taken out"));
}

double RangeOf(const std::vector<double>& values) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  return *high - *low;
}

// Readings in another unit than radians (or metres), as far as the log by itself tells.
absl::Status CheckAngles(const std::string& file, const RigJoint& joint,
                         const JointRecord& record) {
  const bool two_sides = joint.input == JointInput::kTransmission;
  const std::string q = absl::StrCat(two_sides ? "q_link_" : "q_", joint.name);
  const std::string other = absl::StrCat(two_sides ? "q_motor_" : "q_cmd_", joint.name);
  const std::vector<double>& beside = two_sides ? record.q_motor : record.command;
  const double range = RangeOf(record.q), span = beside.empty() ? 0 : RangeOf(beside);
  for (const auto& [name, values] : {std::pair(q, &record.q), std::pair(other, &beside)}) {
    if (!AreCounts(*values)) continue;
    const double counts = RangeOf(*values), rest = name == q ? span : range;
    const bool known = rest > 0 && rest < counts / 20;
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": ", name, " holds whole numbers over a span of ", counts,
        ": counts of an encoder; multiply them by ",
        known ? absl::StrCat(rest / counts, ", which ", name == q ? other : q, " gives")
              : absl::StrCat("2 pi / counts a turn, ", 2 * M_PI / 4096, " at 4096")));
  }
  if (range == 0 || span == 0 || (span < 20 * range && range < 20 * span)) return absl::OkStatus();
  const bool beside_is_larger = span > range;
  const std::string unit =
      UnitOfRatio(beside_is_larger ? span / range : range / span, kSpanTolerance);
  return absl::InvalidArgumentError(absl::StrCat(
      file, ": ", other, " spans ", span, ", ", q, " spans ", range, "; ",
      unit.empty() ? std::string("are both in radians (or metres) at the joint?")
                   : absl::StrCat("the numbers of ", beside_is_larger ? other : q, " are ", unit)));
}

// The table's columns; what the input needs must be there.
class Channels {
 public:
  // Every cell must be a number, also of a column that nobody asks for.
  static absl::StatusOr<Channels> Read(const CsvTable& table) {
    Channels channels(table);
    for (const std::string& name : table.names()) {
      RS_ASSIGN_OR_RETURN(channels.columns_[name], table.Numbers(name));
    }
    return channels;
  }

  absl::StatusOr<std::vector<double>> Need(const std::string& name, const std::string& why) const {
    const auto found = columns_.find(name);
    if (found != columns_.end()) return found->second;
    return absl::InvalidArgumentError(absl::StrCat(table_.path(), ": no column '", name, "'", why,
                                                   "; the file has ",
                                                   absl::StrJoin(table_.names(), ", ")));
  }
  std::vector<double> Optional(const std::string& name) const {
    const auto found = columns_.find(name);
    return found == columns_.end() ? std::vector<double>() : found->second;
  }

 private:
  explicit Channels(const CsvTable& table) : table_(table) {}

  const CsvTable& table_;
  std::map<std::string, std::vector<double>> columns_;
};

absl::StatusOr<JointRecord> ReadJoint(const Channels& channels, const RigJoint& joint) {
  JointRecord record;
  const std::string& name = record.name = joint.name;
  const std::string why = absl::StrCat(", which input of joint '", name, "' needs");
  if (joint.input == JointInput::kTransmission) {
    RS_ASSIGN_OR_RETURN(record.q_motor, channels.Need("q_motor_" + name, why));
    RS_ASSIGN_OR_RETURN(record.q, channels.Need("q_link_" + name, why));
  } else {
    RS_ASSIGN_OR_RETURN(record.q, channels.Need("q_" + name, why));
  }
  record.command = channels.Optional("q_cmd_" + name);
  record.tau = channels.Optional("tau_" + name);
  record.temperature = BetweenSteps(channels.Optional("temp_" + name));
  if (!joint.enable.empty()) {
    RS_ASSIGN_OR_RETURN(record.enable, channels.Need(joint.enable, why));
  }
  if (joint.input == JointInput::kPositionTarget) {
    RS_RETURN_IF_ERROR(channels.Need("q_cmd_" + name, why).status());
  }
  if (joint.input == JointInput::kTorque || joint.input == JointInput::kInverse) {
    RS_RETURN_IF_ERROR(channels.Need("tau_" + name, why).status());
  }
  if (joint.velocity == VelocitySide::kMotor) {
    RS_RETURN_IF_ERROR(channels.Need("dq_" + name, why).status());
  }
  return record;
}

void TakeVelocity(const std::vector<double>& logged, double dt, JointRecord& record) {
  record.dq = logged;
  record.velocity_logged = true;
  record.start_noise_dq = NoiseOfReading(logged);
  record.ddq = SmoothMotion(logged, dt, kSmoothing).first;
}

// Of `values` over `reference`, by least squares.
double GainOver(const std::vector<double>& reference, const std::vector<double>& values) {
  double square = 0, both = 0;
  for (size_t i = 0; i < values.size(); ++i) {
    square += reference[i] * reference[i];
    both += reference[i] * values[i];
  }
  return both / std::max(square, 1e-30);
}

// Takes a logged velocity instead of the derivative of q, which rounds the corners that a torque
// step leaves; from where a free run starts the rounding grows with time. Only where it is the
// derivative: no other gain, no lag (a filter's would pose as an effect), no more noise.
void AdoptVelocity(const std::string& joint, const std::vector<double>& logged, double dt,
                   JointRecord& record, std::vector<std::string>& notes) {
  double bend = 0, ahead = 0;
  for (size_t i = 0; i < logged.size(); ++i) {
    bend += record.ddq[i] * record.ddq[i];
    ahead += record.ddq[i] * (logged[i] - record.dq[i]);
  }
  const double gain = GainOver(record.dq, logged), lag = -ahead / std::max(bend, 1e-30);
  if (std::abs(gain - 1) > 0.03 || std::abs(lag) > 0.5 * dt) {
    const std::string unit = UnitOfRatio(gain, kGainTolerance);
    notes.push_back(absl::StrCat(
        joint, ": dq_", joint, " is ", gain, " times the derivative of the position, ", lag,
        " s behind it; it is not used", unit.empty() ? "" : ". Its numbers are " + unit));
  } else if (NoiseOfReading(logged) <= record.start_noise_dq) {
    TakeVelocity(logged, dt, record);
  }
}

// Rows that are read beside their times make noise that grows with speed.
void NoteTiming(const std::string& joint, double dt, JointRecord& record,
                std::vector<std::string>& notes) {
  const ReadingNoise by_speed = NoiseBySpeed(record.q, record.dq);
  if (by_speed.timing == 0 || by_speed.timing > 0.5 * dt) return;
  const double before = record.noise;
  record.still_noise = by_speed.still;
  record.timing_noise = by_speed.timing;
  record.noise = std::sqrt(record.NoiseVariance(0, static_cast<int>(record.q.size())));
  const double more = std::max(1.0, record.noise / std::max(before, 1e-300));
  record.start_noise_q *= more;
  if (!record.velocity_logged) record.start_noise_dq *= more;
  record.acceleration_noise *= more;
  notes.push_back(absl::StrCat(joint, ": the noise grows with speed: rows were read ",
                               by_speed.timing * 1e3,
                               " ms (one standard deviation) off the times that the log gives; the "
                               "noise floor counts it"));
}

// Lines between the points at which a controller steps may be what the servo saw, or what a
// recorder made of steps.
void FindSteps(JointRecord& record) {
  record.step_rows = RowsBetweenBends(record.command);
  if (record.step_rows == 0) return;
  record.stepped_command = StepsOfLines(record.command, record.step_rows);
}

void UndrawSteps(JointRecord& record, std::vector<std::string>& notes) {
  const double share = DrawnSteps(record.command);
  if (share == 0) return;
  record.drawn = true;
  record.command = MeansOfDrawnSteps(record.command, share);
  notes.push_back(
      absl::StrCat(record.name,
                   ": steps of the command pass through a row between: the log was "
                   "resampled by lines; the steps are put back where the lines say, and "
                   "the noise floor counts the corners that they cut"));
}

absl::Status GateJoint(const std::string& file, const RigJoint& joint,
                       const std::vector<double>& logged_velocity, JointRecord& record, double dt,
                       std::vector<std::string>& notes) {
  const std::vector<double>& motion =
      joint.input == JointInput::kTransmission ? record.q_motor : record.q;
  const SmoothSignal fit = SmoothMotion(motion, dt, kSmoothing);
  record.start_noise_q = fit.value_noise;
  record.start_noise_dq = fit.first_noise;
  record.acceleration_noise = fit.second_noise;
  record.q_smooth = fit.value;
  record.dq = fit.first;
  record.ddq = fit.second;
  if (joint.velocity == VelocitySide::kMotor) {
    const double gain = GainOver(record.dq, logged_velocity);
    // A joint that hardly moves has a gain of noise.
    const bool follows = gain * GainOver(logged_velocity, record.dq) > kFollows;
    if (const std::string fault = FaultOfVelocity(gain, kGainTolerance); follows && !fault.empty())
      return absl::InvalidArgumentError(absl::StrCat(file, ": dq_", joint.name, " is ", gain,
                                                     " times the derivative of q_", joint.name,
                                                     "; ", fault));
    TakeVelocity(logged_velocity, dt, record);
    record.velocity_of_motor = true;
  } else if (!logged_velocity.empty()) {
    AdoptVelocity(joint.name, logged_velocity, dt, record, notes);
  }
  record.motion = {record.q_smooth, record.dq, UntilNextRow(record.ddq), {}};
  record.noise = NoiseOfReading(record.q);
  if (joint.input == JointInput::kTransmission)
    record.noise = std::hypot(record.noise, NoiseOfReading(record.q_motor));
  else
    NoteTiming(joint.name, dt, record, notes);
  const double range = RangeOf(record.q);
  if (range == 0)
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": position of joint '", joint.name, "' is constant, ", record.q.front(),
                     "; the channel is dead or the joint never moved, leave it out of the rig"));
  if (range < 20 * record.noise)
    return absl::FailedPreconditionError(
        absl::StrCat(file, ": joint '", joint.name, "' moves by ", range, " over noise of ",
                     record.noise, "; too little excitation, at least 20 times the noise"));
  if (joint.input == JointInput::kPositionTarget) {
    FindSteps(record);
    record.dt = dt;
    UndrawSteps(record, notes);
    const double asked = RangeOf(record.command);
    if (asked == 0)
      return absl::InvalidArgumentError(
          absl::StrCat(file, ": q_cmd_", joint.name, " is constant, ", record.command.front(),
                       "; the channel is dead, or nothing was asked of the joint"));
  }
  const bool driven = joint.input == JointInput::kTorque || joint.input == JointInput::kInverse;
  if (driven && RangeOf(record.tau) == 0)
    return absl::InvalidArgumentError(absl::StrCat(file, ": tau_", joint.name, " is constant, ",
                                                   record.tau.front(), "; the channel is dead"));
  if (!record.tau.empty()) {
    double peak = 0;
    for (const double tau : record.tau) peak = std::max(peak, std::abs(tau));
    const auto at_peak = std::count_if(record.tau.begin(), record.tau.end(),
                                       [&](double tau) { return std::abs(tau) > 0.9999 * peak; });
    const double share = static_cast<double>(at_peak) / static_cast<double>(record.tau.size());
    if (peak > 0 && share > kSaturated)
      notes.push_back(absl::StrCat(joint.name, ": torque stands at ", peak, " in ",
                                   std::round(share * 100), " % of rows: saturated"));
  }
  return absl::OkStatus();
}

}  // namespace

double JointRecord::NoiseVariance(int first, int count) const {
  if (timing_noise == 0 && !drawn) return noise * noise;
  double sum = 0;
  for (int i = first; i < first + count; ++i) {
    sum += std::pow(timing_noise * dq[i], 2);
    if (drawn) sum += std::pow(kCorner * dt * dt * ddq[i], 2);
  }
  const double still = timing_noise == 0 ? noise : still_noise;
  return still * still + sum / std::max(1, count);
}

std::vector<double> UntilNextRow(std::vector<double> at_rows) {
  for (size_t i = 0; i + 1 < at_rows.size(); ++i) at_rows[i] = 0.5 * (at_rows[i] + at_rows[i + 1]);
  return at_rows;
}

absl::StatusOr<MeasuredLog> ReadMeasuredLog(const Rig& rig, const RigLog& declared) {
  RS_ASSIGN_OR_RETURN(const CsvTable table,
                      CsvTable::Read(declared.file, kMaxBytes, CsvTable::ShortLastLine::kError));
  RS_ASSIGN_OR_RETURN(const Channels channels, Channels::Read(table));
  MeasuredLog log;
  log.file = declared.file;
  log.condition = declared.condition;
  log.role = declared.role;
  log.overrides = declared.overrides;
  RS_ASSIGN_OR_RETURN(const std::vector<double> t, channels.Need("t", " [s]"));
  RS_ASSIGN_OR_RETURN(const RowClock clock, CheckClock(table, t, rig.rate_hz));
  NoteClock(clock, t.size(), rig.rate_hz, log.notes);
  log.dt = clock.dt;
  log.clock_jitter = clock.jitter;
  log.lost_rows = clock.lost;
  std::optional<Resampling> resampling;
  if (clock.resampled()) resampling.emplace(t, clock);
  if (clock.lost > 0) log.absent = resampling->absent();
  for (const RigJoint& joint : rig.joints) {
    RS_ASSIGN_OR_RETURN(JointRecord record, ReadJoint(channels, joint));
    RS_RETURN_IF_ERROR(CheckAngles(declared.file, joint, record));
    UnwrapJoint(t, log.dt, record, log.notes);
    for (auto* channel : {&record.tau, &record.temperature, &record.enable})
      if (resampling && !channel->empty()) *channel = resampling->Lines(*channel);
    for (auto* channel : {&record.command, &record.q, &record.q_motor})
      if (resampling && !channel->empty()) *channel = resampling->Curves(*channel);
    std::vector<double> velocity = channels.Optional("dq_" + joint.name);
    if (resampling && !velocity.empty()) velocity = resampling->Curves(velocity);
    RS_RETURN_IF_ERROR(GateJoint(declared.file, joint, velocity, record, log.dt, log.notes));
    MarkGuesses(record.q, record.noise, log.absent);
    if (joint.input == JointInput::kPositionTarget)
      MarkGuesses(record.command, record.noise, log.absent);
    if (joint.input == JointInput::kTorque)
      MarkGuesses(record.tau, NoiseOfReading(record.tau), log.absent);
    log.joints.push_back(std::move(record));
  }
  log.rows = static_cast<int>(log.joints.front().q.size());
  return log;
}

}  // namespace robostress::calibration
