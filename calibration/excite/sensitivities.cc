#include "calibration/excite/sensitivities.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "calibration/data/local_polynomial.h"
#include "calibration/search/joint_problem.h"
#include "calibration/search/parallel.h"
#include "calibration/search/signatures.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kMostStarts = 3;          // of an effect, of those that a fit would try
constexpr double kShown = 3;            // times the noise
constexpr double kShare = 0.1;          // of an effect, whose sensitivity is that to the whole
constexpr double kRidge = 1e-9;         // of a column's own product
constexpr double kPlain = 100;          // times the noise: more of it helps nobody
constexpr double kRest = 1;             // [s] before a motion
constexpr double kReadingNoise = 1e-4;  // [rad, m] where torques are compared
constexpr int kSmoothing = MeasuredLog::kSmoothing;

// A log in which `joint` is asked for `command` and the others stay.
MeasuredLog LogOf(const Rig& rig, int joint, const JointSensitivities::Setup& setup,
                  const std::vector<double>& command,
                  const std::map<std::string, double>& overrides) {
  MeasuredLog log;
  log.overrides = overrides;
  log.file = "designed";
  log.dt = setup.dt;
  log.rows = static_cast<int>(command.size());
  const std::vector<double> still(log.rows, 0);
  for (size_t i = 0; i < rig.joints.size(); ++i) {
    JointRecord record;
    record.name = rig.joints[i].name;
    record.dt = setup.dt;
    record.noise = record.still_noise = setup.noise;
    record.q =
        static_cast<int>(i) == joint ? command : std::vector<double>(log.rows, setup.centre[i]);
    record.command = record.q_motor = record.q_smooth = record.q;
    record.dq = record.ddq = still;
    record.motion = {record.q_smooth, record.dq, record.ddq, {}};
    log.joints.push_back(std::move(record));
  }
  return log;
}

// Lets the joint move as `q` does.
void SetMotion(JointRecord& record, std::vector<double> q, std::vector<double> dq) {
  const double dt = record.dt;
  for (size_t i = 0; i + 1 < q.size(); ++i) record.ddq[i] = (dq[i + 1] - dq[i]) / dt;
  record.q = record.q_smooth = std::move(q);
  record.dq = std::move(dq);
  record.motion = {record.q_smooth, record.dq, record.ddq, {}};
}

std::vector<double> Differences(const std::vector<double>& q, double dt) {
  std::vector<double> dq(q.size(), 0);
  for (size_t i = 1; i + 1 < q.size(); ++i) dq[i] = (q[i + 1] - q[i - 1]) / (2 * dt);
  return dq;
}

double KnownMassIn(const MeasuredLog& log, const std::string& joint) {
  const auto known = log.overrides.find(absl::StrCat(joint, ".", kKnownMass));
  return known == log.overrides.end() ? 0 : known->second;
}

// Lets the joint make the motion that `model` makes of the command, from where it stands at rest.
void MoveBy(const JointModel& model, const Rig& rig, const Plant& plant, int joint,
            const JointSensitivities::Setup& setup, const JointMotionAsked& asked,
            JointRecord& record) {
  const size_t rest = static_cast<size_t>(std::lround(kRest / setup.dt));
  std::vector<double> whole(rest, asked.q[0]);
  whole.insert(whole.end(), asked.q.begin(), asked.q.end());
  MeasuredLog log = LogOf(rig, joint, setup, whole, asked.overrides);
  SetMotion(log.joints[joint], whole, Differences(whole, setup.dt));
  const JointTrack track{&log, joint, plant.single(), plant.Rows(joint, log),
                         KnownMassIn(log, record.name)};
  std::vector<double> q(whole.size()), dq(whole.size());
  JointSimulation(track).PredictMotion(
      model, 0, 0, {}, {.readings = absl::MakeSpan(q), .velocities = absl::MakeSpan(dq)});
  SetMotion(record, {q.begin() + static_cast<std::ptrdiff_t>(rest), q.end()},
            {dq.begin() + static_cast<std::ptrdiff_t>(rest), dq.end()});
}

// Takes the place of the free command_shift (WithEffect).
bool IsDelay(const std::string& effect) {
  return effect == "transport_delay" || effect == "servo_lag";
}

// What noise of readings leaves of the states that free runs start from.
void SetStartNoise(JointRecord& record, double noise) {
  RandomStream random(StreamKey("readings of a design"));
  std::vector<double> noisy = record.q;
  for (double& q : noisy) q += noise * random.Normal();
  const SmoothSignal smooth = SmoothMotion(noisy, record.dt, kSmoothing);
  record.start_noise_q = smooth.value_noise;
  record.start_noise_dq = smooth.first_noise;
  record.acceleration_noise = smooth.second_noise;
}

// With `share` of the effect that `whole` has last.
JointModel ShareOf(const JointModel& whole, double share) {
  JointModel model = whole;
  EffectInstance& effect = model.effects.back();
  for (const int amplitude : effect.info->amplitudes) effect.values[amplitude] *= share;
  return model;
}

// Response to the whole of something, of a share that shows as kShown times the noise:
// `beyond(share)` is what readings then are beyond those without.
template <class F>
Eigen::VectorXd PerWhole(const F& beyond, double noise) {
  double share = kShare;
  Eigen::VectorXd shown = beyond(share);
  const double rms = shown.norm() / std::sqrt(static_cast<double>(shown.size()));
  if (rms > 0 && std::isfinite(rms)) {
    share = std::min(1.0, share * kShown * noise / rms);
    shown = beyond(share);
  }
  return shown / share;
}

// What is absent where its parameter is large begins to act at once, and is taken whole.
Eigen::VectorXd SensitivityTo(const JointProblem& problem, const JointModel& whole,
                              const Eigen::VectorXd& at_base, double noise) {
  const EffectInfo& effect = *whole.effects.back().info;
  const auto beyond = [&](double share) -> Eigen::VectorXd {
    return problem.Projected(ShareOf(whole, share), problem.All()) - at_base;
  };
  for (const int amplitude : effect.amplitudes)
    if (effect.parameters[amplitude].inverse) return beyond(1);
  return PerWhole(beyond, noise);
}

Eigen::VectorXd SensitivityTo(const JointProblem& problem, const Hypothesis& base, int parameter,
                              const Eigen::VectorXd& at_base, double noise) {
  return PerWhole(
      [&](double share) -> Eigen::VectorXd {
        Eigen::VectorXd x = base.x;
        x[parameter] += share;
        return problem.Projected(ModelAt(base, x), problem.All()) - at_base;
      },
      noise);
}

// Of the starts of an effect the first, the last and one between; of starts that differ in sign one
// is enough.
std::vector<JointModel> SomeStarts(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales) {
  std::vector<JointModel> all, positive;
  for (const Hypothesis& h : WithEffect(base, effect, scales)) {
    all.push_back(ModelAt(h, h.x));
    const std::vector<double>& values = all.back().effects.back().values;
    if (std::all_of(effect.amplitudes.begin(), effect.amplitudes.end(),
                    [&](int amplitude) { return values[amplitude] >= 0; }))
      positive.push_back(all.back());
  }
  if (!positive.empty()) all = std::move(positive);
  if (all.size() <= kMostStarts) return all;
  return {all.front(), all[all.size() / 2], all.back()};
}

JointModel AsFound(const Hypothesis& base, const EffectInfo& effect, const SignalScales& scales,
                   const std::map<std::string, double>& values) {
  const Hypothesis h = WithEffect(base, effect, scales).front();
  JointModel model = ModelAt(h, h.x);
  for (size_t i = 0; i < effect.parameters.size(); ++i) {
    const auto value = values.find(effect.parameters[i].name);
    if (value != values.end()) model.effects.back().values[i] = value->second;
  }
  return model;
}

}  // namespace

absl::StatusOr<JointSensitivities> JointSensitivities::Measure(
    const Rig& rig, const Plant& plant, int joint, const Setup& setup,
    const std::vector<JointMotionAsked>& motions) {
  const RigJoint& declared = rig.joints[joint];
  RS_ASSIGN_OR_RETURN(JointModel model, DeclaredModel(rig, plant, joint));
  const bool moves = model.input == JointInput::kPositionTarget;
  // Who plays a motion logs its torque; what drives the joint is then not chosen by the motion.
  if (!moves) model.input = JointInput::kInverse;
  std::vector<MeasuredLog> logs;
  for (const JointMotionAsked& motion : motions) {
    logs.push_back(LogOf(rig, joint, setup, motion.q, motion.overrides));
    JointRecord& record = logs.back().joints[joint];
    RS_ASSIGN_OR_RETURN(const JointModel then,
                        WithOverrides(model, declared.name, motion.overrides));
    if (moves) {
      MoveBy(then, rig, plant, joint, setup, motion, record);
    } else {
      SetMotion(record, motion.q, Differences(motion.q, setup.dt));
      record.tau.assign(motion.q.size(), 0);
      JointSimulation({&logs.back(), joint, plant.single(), plant.Rows(joint, logs.back()),
                       KnownMassIn(logs.back(), declared.name)})
          .Predict(then, 0, {}, {}, absl::MakeSpan(record.tau));
    }
    SetStartNoise(record, moves ? setup.noise : kReadingNoise);
  }
  const std::vector<JointTrack> tracks = MakeTracks(plant, logs, joint);
  const SignalScales scales = MeasureScales(declared, tracks);
  RS_ASSIGN_OR_RETURN(const Hypothesis base,
                      DeclaredHypothesis(declared, model, scales, MeanInertia(tracks)));
  JointSensitivities result;
  result.free_ = static_cast<int>(base.free.size());
  for (int k = 0; k < result.free_; ++k)
    if (base.free[k].path == "command_shift") result.shift_ = k;
  std::vector<JointModel> starts;
  for (const Candidate& candidate : CandidatesFor(model, {}, true)) {
    const EffectInfo& effect = *candidate.effect;
    const bool wanted =
        setup.effects.empty() ||
        std::find(setup.effects.begin(), setup.effects.end(), effect.type) != setup.effects.end();
    if (!wanted || effect.thermal) continue;
    const auto found = setup.found.find(effect.type);
    std::vector<JointModel> own = found == setup.found.end()
                                      ? SomeStarts(base, effect, scales)
                                      : std::vector{AsFound(base, effect, scales, found->second)};
    result.effects_.push_back(effect.type);
    result.counts_.push_back(setup.found.empty() || found != setup.found.end());
    result.columns_.push_back(
        {result.free_ + static_cast<int>(starts.size()), static_cast<int>(own.size())});
    for (JointModel& start : own) starts.push_back(std::move(start));
  }
  for (const std::string& name : setup.effects) {
    RS_RETURN_IF_ERROR(FindEffect(name).status());
    if (std::find(result.effects_.begin(), result.effects_.end(), name) != result.effects_.end())
      continue;
    return absl::InvalidArgumentError(
        absl::StrCat("effect '", name, "' cannot be seen by this motion of joint ", declared.name,
                     "; those that can are ", absl::StrJoin(result.effects_, ", ")));
  }
  const int window = std::max(1, static_cast<int>(std::lround(rig.metric.window_s / setup.dt)));
  const int columns = result.free_ + static_cast<int>(starts.size());
  result.products_.resize(tracks.size());
  ParallelFor(static_cast<int>(tracks.size()), [&](int i) {
    JointProblem problem(declared.name, {tracks[i]}, moves ? window : 0);
    const JointModel now = ModelAt(base, base.x);
    problem.LinearizeStarts(now);
    const WindowSet all = problem.All();
    const Eigen::VectorXd at_base = problem.Projected(now, all);
    Eigen::MatrixXd sensitivities(at_base.size(), columns);
    for (int k = 0; k < result.free_; ++k)
      sensitivities.col(k) = SensitivityTo(problem, base, k, at_base, setup.noise);
    for (size_t k = 0; k < starts.size(); ++k)
      sensitivities.col(result.free_ + static_cast<int>(k)) =
          SensitivityTo(problem, starts[k], at_base, setup.noise);
    // A prediction that diverges says nothing.
    for (int c = 0; c < columns; ++c)
      if (!sensitivities.col(c).allFinite()) sensitivities.col(c).setZero();
    result.products_[i] = sensitivities.transpose() * sensitivities *
                          (problem.stride() / (setup.noise * setup.noise));
  });
  return result;
}

std::vector<JointSensitivities::Sight> JointSensitivities::SightsIn(
    const Eigen::MatrixXd& product) const {
  std::vector<Sight> sights;
  for (size_t i = 0; i < effects_.size(); ++i) {
    Sight sight;
    double least = std::numeric_limits<double>::infinity();
    for (int k = -1; k < static_cast<int>(effects_.size()); ++k) {
      if (k == static_cast<int>(i) || (k < 0 && effects_.size() > 1)) continue;
      // The declared model's parameters, the rival's starts, and the effect itself behind them.
      std::vector<int> known;
      for (int c = 0; c < free_; ++c)
        if (c != shift_ || !IsDelay(effects_[i])) known.push_back(c);
      for (int c = 0; k >= 0 && c < columns_[k].count; ++c) known.push_back(columns_[k].first + c);
      Eigen::MatrixXd inner = product(known, known);
      Eigen::VectorXd scale = inner.diagonal().cwiseSqrt();
      for (int c = 0; c < scale.size(); ++c) scale[c] = scale[c] > 0 ? 1 / scale[c] : 0;
      inner = scale.asDiagonal() * inner * scale.asDiagonal();
      inner.diagonal().array() += kRidge;
      const Eigen::LDLT<Eigen::MatrixXd> solved(inner);
      double mean = 0;
      for (int c = 0; c < columns_[i].count; ++c) {
        const int own = columns_[i].first + c;
        const Eigen::VectorXd with = scale.asDiagonal() * product(known, own);
        const double left = product(own, own) - with.dot(solved.solve(with));
        mean += std::max(0.0, left) / columns_[i].count;
      }
      if (mean >= least) continue;
      least = mean;
      sight = {std::sqrt(mean), k};
    }
    sights.push_back(sight);
  }
  return sights;
}

double JointSensitivities::Utility(const Eigen::MatrixXd& product) const {
  double sum = 0, count = 0;
  const std::vector<Sight> sights = SightsIn(product);
  for (size_t i = 0; i < sights.size(); ++i) {
    if (!counts_[i]) continue;
    sum += std::log1p(std::pow(std::min(sights[i].times_noise, kPlain), 2));
    count += 1;
  }
  return count > 0 ? sum / count : 0;
}

}  // namespace robostress::calibration
