#include "calibration/search/next_experiment.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/check.h"

namespace robostress::calibration {
namespace {

constexpr double kLongest = 20;        // [s] of a run
constexpr double kMassShare = 0.3;     // of the joint's inertia, that a known mass adds
constexpr double kLoadShare = 0.5;     // of a transmission's torque, that a load adds
constexpr double kTorqueNoise = 0.01;  // of its torque, of a sensor that measures it
constexpr double kWorthASensor = 2;    // times as far apart, over the noise, as the best run

// What a run has other than the log that it is made of.
struct Change {
  std::string words;  // behind "the motion of log_0.csv"
  double speed = 1, size = 1, gain = 1, load = 0, mass = 0;
};

double At(const std::vector<double>& values, double place) {
  const size_t row = std::min(static_cast<size_t>(place), values.size() - 1);
  const size_t next = std::min(row + 1, values.size() - 1);
  const double share = std::clamp(place - static_cast<double>(row), 0.0, 1.0);
  return (1 - share) * values[row] + share * values[next];
}

double MeanOf(absl::Span<const double> values) {
  double sum = 0;
  for (const double value : values) sum += value / static_cast<double>(values.size());
  return sum;
}

// One run of one joint, and all that its simulation reads.
class Run {
 public:
  Run(const JointTrack& of, const Change& change) : log_(*of.log), track_(of), change_(change) {
    const double dt = log_.dt;
    const int rows = std::min(static_cast<int>((of.log->rows - 1) / change.speed),
                              static_cast<int>(kLongest / dt));
    log_.rows = std::max(2, rows);
    log_.absent.clear();
    for (JointRecord& record : log_.joints) Hasten(record);
    track_.log = &log_;
    if (!track_.single) HastenPlant(of.rows);
    Shrink(own());
    track_.known_mass += change.mass;
    for (double& torque : own().tau) torque *= 1 + change.load;
  }
  Run(const Run&) = delete;

  // Of a servo: the motion that `model` makes of the command.
  void MoveBy(const JointModel& model) {
    JointRecord& record = own();
    std::vector<double> q(log_.rows), dq(log_.rows);
    JointSimulation(track_).PredictMotion(
        Changed(model), 0, 0, {},
        {.readings = absl::MakeSpan(q), .velocities = absl::MakeSpan(dq)});
    record.q_smooth = record.q = q;
    record.dq = dq;
    for (int i = 0; i + 1 < log_.rows; ++i) record.ddq[i] = (dq[i + 1] - dq[i]) / log_.dt;
    record.motion = {record.q_smooth, record.dq, record.ddq, {}};
  }
  void SetTorque(std::vector<double> torque) { own().tau = std::move(torque); }

  std::vector<double> Predict(const JointModel& model, int window) const {
    std::vector<double> predicted(log_.rows);
    JointSimulation(track_).Predict(Changed(model), window, {}, {}, absl::MakeSpan(predicted));
    if (model.input != JointInput::kTransmission) return predicted;
    Centre(predicted);  // two encoders have two zeros
    return predicted;
  }

  // What other sensors would read, each about its mean: they have zeros of their own.
  struct Readings {
    std::vector<double> motor, link, torque;
  };
  Readings ReadElsewhere(const JointModel& model, int window) const {
    const std::vector<double> none(log_.rows);
    std::vector<double> own = none;
    Readings read{none, none, none};
    JointSimulation(track_).PredictMotion(Changed(model), window, 0, {},
                                          {.readings = absl::MakeSpan(own),
                                           .motor = absl::MakeSpan(read.motor),
                                           .link = absl::MakeSpan(read.link),
                                           .drive = absl::MakeSpan(read.torque)});
    for (auto* values : {&read.motor, &read.link, &read.torque}) Centre(*values);
    return read;
  }

 private:
  static void Centre(std::vector<double>& values) {
    const double mean = MeanOf(values);
    for (double& value : values) value -= mean;
  }

  JointRecord& own() { return log_.joints[track_.joint]; }

  void Hasten(JointRecord& record) const {
    const double s = change_.speed;
    const auto hasten = [&](std::vector<double>& channel, double factor) {
      if (channel.empty()) return;
      std::vector<double> result;
      for (int i = 0; i < log_.rows; ++i) result.push_back(factor * At(channel, i * s));
      channel = std::move(result);
    };
    for (auto* channel : {&record.command, &record.q, &record.q_motor, &record.tau,
                          &record.temperature, &record.enable, &record.q_smooth, &record.motion.q})
      hasten(*channel, 1);
    for (auto* channel : {&record.dq, &record.motion.dq}) hasten(*channel, s);
    for (auto* channel : {&record.ddq, &record.motion.ddq, &record.motion.rise})
      hasten(*channel, s * s);
  }
  void HastenPlant(const std::vector<PlantRow>& rows) {
    track_.rows.clear();
    for (int i = 0; i < log_.rows; ++i) {
      const auto at = static_cast<size_t>(i * change_.speed);
      track_.rows.push_back(rows[std::min(at, rows.size() - 1)]);
      track_.rows.back().coupling *= change_.speed * change_.speed;
      track_.rows.back().coupling_rise *= change_.speed * change_.speed;
    }
  }
  void Shrink(JointRecord& record) const {
    const auto shrink = [&](std::vector<double>& channel, double about) {
      for (double& value : channel) value = about + change_.size * (value - about);
    };
    const double middle = record.q_smooth.empty() ? 0 : MeanOf(record.q_smooth);
    for (auto* channel : {&record.command, &record.q, &record.q_smooth, &record.q_motor})
      shrink(*channel, middle);
    for (auto* channel : {&record.dq, &record.ddq}) shrink(*channel, 0);
  }
  JointModel Changed(JointModel model) const {
    model.servo.kp *= change_.gain;
    model.servo.kd *= std::sqrt(change_.gain);
    return model;
  }

  MeasuredLog log_;
  JointTrack track_;
  const Change change_;
};

double RmsBetween(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return std::sqrt(sum / static_cast<double>(std::max<size_t>(1, a.size())));
}

// [kg] that adds kMassShare of the joint's inertia; 0: nothing that the joint moves is known.
double KnownMass(const JointTrack& track, const JointModel& model) {
  const PlantRow& row = track.rows.front();
  if (row.payload_inertia <= 0) return 0;
  const double mass = kMassShare * (model.armature + row.inertia) / row.payload_inertia;
  return std::stod(absl::StrFormat("%.1g", mass));
}

std::vector<Change> Changes(const JointTrack& track, const JointModel& model) {
  std::vector<Change> changes = {{.words = "at twice the speed", .speed = 2},
                                 {.words = "at half the speed", .speed = 0.5},
                                 {.words = "at a fifth of the speed", .speed = 0.2}};
  // A posture's terms hold near it.
  if (track.single) changes.push_back({.words = "at a third of its size", .size = 1.0 / 3});
  if (model.input == JointInput::kTransmission) {
    changes.push_back({.words = "under half as much load again", .load = kLoadShare});
    return changes;
  }
  if (const double mass = KnownMass(track, model); mass > 0)
    changes.push_back(
        {.words = absl::StrFormat("with a known %.3g kg at the tip", mass), .mass = mass});
  if (model.input != JointInput::kPositionTarget) return changes;
  changes.push_back({.words = "at half the servo's gains", .gain = 0.5});
  changes.push_back({.words = "at twice the servo's gains", .gain = 2});
  return changes;
}

double RmsOf(const std::vector<double>& values) {
  return RmsBetween(values, std::vector<double>(values.size(), 0));
}

const JointTrack& LongestFitted(const JointProblem& problem) {
  const JointTrack* longest = &problem.tracks().front();
  for (const JointTrack& track : problem.tracks())
    if (track.log->role == LogRole::kFit &&
        (longest->log->role != LogRole::kFit || track.log->rows > longest->log->rows))
      longest = &track;
  return *longest;
}

// Least of models[0] to any other.
double Apart(const JointTrack& track, const std::vector<JointModel>& models, const Change& change,
             int window) {
  Run run(track, change);
  if (models[0].input == JointInput::kPositionTarget) run.MoveBy(models[0]);
  if (models[0].input == JointInput::kInverse) run.SetTorque(run.Predict(models[0], window));
  const std::vector<double> first = run.Predict(models[0], window);
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 1; i < models.size(); ++i)
    least = std::min(least, RmsBetween(first, run.Predict(models[i], window)));
  return least;
}

// The best of a second encoder, an instrument outside and a torque sensor, where it is worth more
// than a run that is `times_noise` apart.
NextExperiment::Sensor BestSensor(const JointTrack& track, const std::vector<JointModel>& models,
                                  double times_noise, int window) {
  Run run(track, {});
  if (models[0].input == JointInput::kPositionTarget) run.MoveBy(models[0]);
  const Run::Readings first = run.ReadElsewhere(models[0], window);
  const double far = std::numeric_limits<double>::infinity();
  NextExperiment::Sensor motor{"the motor's angle, before the transmission", far, false},
      link{"the joint's angle by an instrument outside", far, false},
      torque{"the motor's torque", far, true};
  for (size_t i = 1; i < models.size(); ++i) {
    const Run::Readings other = run.ReadElsewhere(models[i], window);
    motor.apart = std::min(motor.apart, RmsBetween(first.motor, other.motor));
    link.apart = std::min(link.apart, RmsBetween(first.link, other.link));
    torque.apart = std::min(torque.apart, RmsBetween(first.torque, other.torque));
  }
  const auto over_noise = [&](const NextExperiment::Sensor& sensor) {
    const double noise = sensor.torque ? kTorqueNoise * RmsOf(first.torque) : track.record().noise;
    return sensor.apart / std::max(noise, 1e-300);
  };
  // A torque that drives the model is measured already.
  if (models[0].input == JointInput::kTorque) torque.apart = 0;
  const NextExperiment::Sensor best =
      std::max({motor, link, torque},
               [&](const auto& a, const auto& b) { return over_noise(a) < over_noise(b); });
  const bool worth = over_noise(best) >= std::max(1.0, kWorthASensor * times_noise);
  return worth && std::isfinite(best.apart) ? best : NextExperiment::Sensor{};
}

bool IsMotion(JointInput input) {
  return input == JointInput::kPositionTarget || input == JointInput::kTorque;
}

}  // namespace

NextExperiment ProposeExperiment(const JointProblem& problem,
                                 const std::vector<JointModel>& models) {
  NextExperiment best;
  if (models.size() < 2) return best;
  std::vector<JointModel> own = models;
  const JointTrack& track = LongestFitted(problem);
  best.torque = own[0].input == JointInput::kInverse || own[0].input == JointInput::kTorque;
  for (JointModel& model : own) {
    const auto with = WithOverrides(model, track.record().name, track.log->overrides);
    RS_CHECK(with.ok());
    model = *with;
  }
  const std::vector<JointModel> logged = own;
  for (JointModel& model : own) {
    // A torque that was logged drives another machine elsewhere: its motion is prescribed.
    if (best.torque) model.input = JointInput::kInverse;
  }
  const std::string name = std::filesystem::path(track.log->file).filename().string();
  best.log = track.log->file;
  best.noise = best.torque ? kTorqueNoise * RmsOf(track.record().tau) : track.record().noise;
  best.now = Apart(track, own, {}, problem.window());
  for (const Change& change : Changes(track, own[0])) {
    const double apart = Apart(track, own, change, problem.window());
    if (!(apart > best.apart) || !std::isfinite(apart)) continue;
    best.apart = apart;
    best.what = absl::StrCat("the motion of ", name, " ", change.words);
    best.speed = change.speed, best.size = change.size, best.gain = change.gain;
    best.load = change.load, best.mass = change.mass;
  }
  if (IsMotion(logged[0].input)) {
    const double times_noise = best.apart / std::max(best.noise, 1e-300);
    best.sensor = BestSensor(track, logged, times_noise, problem.window());
    if (!best.sensor.what.empty() && times_noise < 1) best.what.clear();
  }
  return best;
}

}  // namespace robostress::calibration
