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
constexpr double kRidge = 1e-9;         // of a column's own product
constexpr double kPlain = 1e4;          // times the noise: more of it helps nobody
constexpr double kRest = 1;             // [s] before a motion
constexpr double kReadingNoise = 1e-4;  // [rad, m] where torques are compared
constexpr int kSmoothing = MeasuredLog::kSmoothing;

// A log in which `joint` is asked for `command` and the others stay.
MeasuredLog LogOf(const Rig& rig, int joint, const JointSensitivities::Setup& setup,
                  const std::vector<double>& command) {
  MeasuredLog log;
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

// Lets the joint make the motion that `model` makes of the command, from where it stands at rest.
void MoveBy(const JointModel& model, const Rig& rig, const Plant& plant, int joint,
            const JointSensitivities::Setup& setup, const std::vector<double>& command,
            JointRecord& record) {
  const size_t rest = static_cast<size_t>(std::lround(kRest / setup.dt));
  std::vector<double> whole(rest, command[0]);
  whole.insert(whole.end(), command.begin(), command.end());
  MeasuredLog log = LogOf(rig, joint, setup, whole);
  SetMotion(log.joints[joint], whole, Differences(whole, setup.dt));
  const JointTrack track{&log, joint, plant.single(), plant.Rows(joint, log)};
  std::vector<double> q(whole.size()), dq(whole.size());
  JointSimulation(track).PredictMotion(
      model, 0, 0, {}, {.readings = absl::MakeSpan(q), .velocities = absl::MakeSpan(dq)});
  SetMotion(record, {q.begin() + static_cast<std::ptrdiff_t>(rest), q.end()},
            {dq.begin() + static_cast<std::ptrdiff_t>(rest), dq.end()});
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

// Of the starts of an effect the first, the last and one between; of starts that differ in sign one
// is enough.
std::vector<Hypothesis> SomeStarts(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales) {
  std::vector<Hypothesis> all = WithEffect(base, effect, scales);
  const auto negative = [&](const Hypothesis& h) {
    return std::any_of(effect.amplitudes.begin(), effect.amplitudes.end(),
                       [&](int amplitude) { return h.model.effects.back().values[amplitude] < 0; });
  };
  const std::vector<Hypothesis> whole = all;
  std::erase_if(all, negative);
  if (all.empty()) all = whole;
  if (all.size() <= kMostStarts) return all;
  return {all.front(), all[all.size() / 2], all.back()};
}

}  // namespace

absl::StatusOr<JointSensitivities> JointSensitivities::Measure(
    const Rig& rig, const Plant& plant, int joint, const Setup& setup,
    const std::vector<std::vector<double>>& motions) {
  const RigJoint& declared = rig.joints[joint];
  RS_ASSIGN_OR_RETURN(JointModel model, DeclaredModel(rig, plant, joint));
  const bool moves = model.input == JointInput::kPositionTarget;
  // Who plays a motion logs its torque; what drives the joint is then not chosen by the motion.
  if (!moves) model.input = JointInput::kInverse;
  std::vector<MeasuredLog> logs;
  for (const std::vector<double>& motion : motions) {
    logs.push_back(LogOf(rig, joint, setup, motion));
    JointRecord& record = logs.back().joints[joint];
    if (moves) {
      MoveBy(model, rig, plant, joint, setup, motion, record);
    } else {
      SetMotion(record, motion, Differences(motion, setup.dt));
      record.tau.assign(motion.size(), 0);
      JointSimulation({&logs.back(), joint, plant.single(), plant.Rows(joint, logs.back())})
          .Predict(model, 0, {}, {}, absl::MakeSpan(record.tau));
    }
    SetStartNoise(record, moves ? setup.noise : kReadingNoise);
  }
  const std::vector<JointTrack> tracks = MakeTracks(plant, logs, joint);
  const SignalScales scales = MeasureScales(declared, tracks);
  RS_ASSIGN_OR_RETURN(const Hypothesis base,
                      DeclaredHypothesis(declared, model, scales, MeanInertia(tracks)));
  JointSensitivities result;
  result.free_ = static_cast<int>(base.free.size());
  std::vector<Hypothesis> starts;
  for (const Candidate& candidate : CandidatesFor(model, {}, true)) {
    const EffectInfo& effect = *candidate.effect;
    const bool wanted =
        setup.effects.empty() ||
        std::find(setup.effects.begin(), setup.effects.end(), effect.type) != setup.effects.end();
    if (!wanted || effect.thermal) continue;
    std::vector<Hypothesis> own = SomeStarts(base, effect, scales);
    result.effects_.push_back(effect.type);
    result.columns_.push_back(
        {result.free_ + static_cast<int>(starts.size()), static_cast<int>(own.size())});
    for (Hypothesis& h : own) starts.push_back(std::move(h));
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
    sensitivities.leftCols(result.free_) = problem.Jacobian(base, base.x, at_base, all);
    for (size_t k = 0; k < starts.size(); ++k)
      sensitivities.col(result.free_ + static_cast<int>(k)) =
          problem.Projected(ModelAt(starts[k], starts[k].x), all) - at_base;
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
      for (int c = 0; c < free_; ++c) known.push_back(c);
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
  double sum = 0;
  for (const Sight& sight : SightsIn(product))
    sum += std::log1p(std::pow(std::min(sight.times_noise, kPlain), 2));
  return effects_.empty() ? 0 : sum / static_cast<double>(effects_.size());
}

}  // namespace robostress::calibration
