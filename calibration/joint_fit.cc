#include "calibration/joint_fit.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <future>

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr int kMaxResiduals = 12000;  // of a fit; more rows are thinned out
constexpr double kStep = 1e-4;        // of forward differences, in units of the scale

double RmsOf(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value * value;
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}

// Bounds and scale of a parameter of the declared model.
FreeParameter ModelParameter(const std::string& name, const JointModel& model,
                             const SignalScales& s, double inertia) {
  const double per_velocity = s.torque / s.velocity;
  if (name == "armature") return {name, std::max(inertia, model.armature), 0, 20};
  if (name == "mass_scale") return {name, 1, 0.05, 20};
  if (name == "damping") return {name, per_velocity, 0, 20};
  if (name == "frictionloss") return {name, s.torque, 0, 3};
  if (name == "servo.kp") return {name, model.servo.kp, 0.1, 10};
  if (name == "servo.kd") return {name, model.servo.kd > 0 ? model.servo.kd : per_velocity, 0, 10};
  if (name == "torque_offset") return {name, s.torque, -3, 3};
  if (name == "torque_gain") return {name, 1, 0.1, 10};
  return {name, s.position, -3, 3};  // position_offset
}

FreeParameter EffectFreeParameter(const EffectInfo& effect, size_t index, const SignalScales& s) {
  const EffectParameter& parameter = effect.parameters[index];
  return {absl::StrCat(effect.type, ".", parameter.name), ScaleOf(parameter.scale, s),
          parameter.lower, parameter.upper, parameter.inverse};
}

// Ceres' view of a problem: one block of residuals, one of parameters.
class Cost : public ceres::CostFunction {
 public:
  Cost(const JointProblem& problem, const Hypothesis& h, const std::vector<size_t>& tracks,
       int stride, double unit, int* evaluations)
      : problem_(problem),
        h_(h),
        tracks_(tracks),
        stride_(stride),
        unit_(unit),
        evaluations_(evaluations) {
    mutable_parameter_block_sizes()->push_back(static_cast<int>(h.free.size()));
    int count = 0;
    for (const size_t track : tracks) {
      const int rows = problem.tracks()[track].log->rows;
      count += (rows + stride - 1) / stride;
    }
    set_num_residuals(count);
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::VectorXd x =
        Eigen::Map<const Eigen::VectorXd>(parameters[0], static_cast<int>(h_.free.size()));
    const Eigen::VectorXd r = problem_.Residuals(ModelAt(h_, x), tracks_, stride_) / unit_;
    ++*evaluations_;
    if (!r.allFinite()) return false;
    // Pseudo-Huber at three units, so that a window that bifurcates does not decide.
    const Eigen::ArrayXd a = r.array() / 3, root = (1 + a.square()).sqrt();
    const Eigen::ArrayXd robust = 3 * r.array().sign() * (2 * (root - 1)).max(0).sqrt();
    Eigen::Map<Eigen::VectorXd>(residuals, r.size()) = robust.matrix();
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    const Eigen::MatrixXd J = problem_.Jacobian(h_, x, r * unit_, tracks_, stride_) / unit_;
    if (!J.allFinite()) return false;
    *evaluations_ += static_cast<int>(h_.free.size());
    // d robust / d r = (r / 3) / root / (robust / 3), 1 at zero.
    const Eigen::ArrayXd slope =
        (robust.abs() < 1e-9)
            .select(Eigen::ArrayXd::Ones(r.size()),
                    r.array() / (root * (robust.abs() < 1e-9).select(1.0, robust)));
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
        jacobians[0], r.size(), x.size()) = slope.matrix().asDiagonal() * J;
    return true;
  }

 private:
  const JointProblem& problem_;
  const Hypothesis& h_;
  const std::vector<size_t>& tracks_;
  int stride_;
  double unit_;
  int* evaluations_;
};

}  // namespace

double ScaleOf(EffectScale scale, const SignalScales& s) {
  switch (scale) {
    case EffectScale::kOne:
      return 1;
    case EffectScale::kTorque:
    case EffectScale::kTorquePerSecond:
      return s.torque;
    case EffectScale::kPosition:
      return s.position;
    case EffectScale::kVelocity:
      return s.velocity;
    case EffectScale::kSample:
      return s.sample;
    case EffectScale::kTorquePerPosition:
      return s.torque / s.position;
    case EffectScale::kTorquePerPosition2:
      return s.torque / (s.position * s.position);
    case EffectScale::kTorquePerPosition3:
      return s.torque / (s.position * s.position * s.position);
    case EffectScale::kTorquePerVelocity:
      return s.torque / s.velocity;
    case EffectScale::kTorquePerVelocity2:
      return s.torque / (s.velocity * s.velocity);
    case EffectScale::kPayload:
      return s.payload;
  }
  return 1;
}

SignalScales MeasureScales(const RigJoint& joint, const std::vector<JointTrack>& tracks) {
  SignalScales scales;
  double torque = 0, position = 0, velocity = 0, payload = 0;
  for (const JointTrack& track : tracks) {
    const JointRecord& record = track.record();
    const auto [low, high] = std::minmax_element(record.q_smooth.begin(), record.q_smooth.end());
    position = std::max(position, (*high - *low) / 2);
    velocity = std::max(velocity, RmsOf(record.dq));
    double drive = RmsOf(record.tau);
    if (record.tau.empty() && !record.command.empty()) {
      std::vector<double> asked(record.q.size());
      for (size_t i = 0; i < asked.size(); ++i) {
        asked[i] = joint.servo.kp * (record.command[i] - record.q_smooth[i]);
        if (joint.servo.type == Servo::Type::kDcMotor)
          asked[i] = joint.servo.kt / joint.servo.R *
                     std::clamp(asked[i], -joint.servo.vin, joint.servo.vin);
      }
      drive = RmsOf(asked);
    }
    torque = std::max(torque, drive);
    for (const PlantRow& row : track.rows)
      payload = std::max({payload,
                          std::abs(row.payload_gravity.a) + std::abs(row.payload_gravity.b) +
                              std::abs(row.payload_gravity.c),
                          9.81 * std::sqrt(row.payload_inertia)});
    scales.sample = track.log->dt;
  }
  scales.torque = std::max(torque, 1e-9);
  scales.position = std::max(position, 1e-9);
  scales.velocity = std::max(velocity, 1e-9);
  scales.payload = scales.torque / std::max(payload, 1e-9);
  return scales;
}

absl::StatusOr<Hypothesis> DeclaredHypothesis(const RigJoint& joint, const JointModel& model,
                                              const SignalScales& scales, double inertia) {
  Hypothesis h;
  h.model = model;
  for (const std::string& name : joint.fit)
    h.free.push_back(ModelParameter(name, model, scales, inertia));
  for (size_t i = 0; i < joint.effects.size(); ++i) {
    const EffectInfo& info = *model.effects[i].info;
    for (const std::string& name : joint.effects[i].fit) {
      RS_ASSIGN_OR_RETURN(const int index, FindParameter(info, name));
      h.free.push_back(EffectFreeParameter(info, index, scales));
    }
  }
  h.x.resize(static_cast<int>(h.free.size()));
  for (size_t i = 0; i < h.free.size(); ++i) {
    FreeParameter& parameter = h.free[i];
    RS_ASSIGN_OR_RETURN(const double* value, FindValue(h.model, parameter.path));
    const double x = parameter.FromValue(*value);
    parameter.lower = std::min(parameter.lower, x - std::abs(x));
    parameter.upper = std::max(parameter.upper, x + std::abs(x));
    h.x[static_cast<int>(i)] = x;
  }
  return h;
}

std::vector<Hypothesis> WithEffect(const Hypothesis& base, const EffectInfo& effect,
                                   const SignalScales& scales) {
  Hypothesis h = base;
  EffectInstance instance{&effect, {}};
  std::vector<size_t> free;
  for (size_t i = 0; i < effect.parameters.size(); ++i) {
    const EffectParameter& parameter = effect.parameters[i];
    instance.values.push_back(parameter.starts.front() *
                              (parameter.fixed ? 1 : ScaleOf(parameter.scale, scales)));
    if (parameter.fixed) continue;
    free.push_back(i);
    h.free.push_back(EffectFreeParameter(effect, i, scales));
  }
  h.model.effects.push_back(std::move(instance));
  // Every combination of starts.
  std::vector<Hypothesis> result;
  std::vector<size_t> choice(free.size(), 0);
  const int first = static_cast<int>(base.free.size());
  while (true) {
    Hypothesis next = h;
    next.x.resize(static_cast<int>(h.free.size()));
    next.x.head(first) = base.x;
    for (size_t i = 0; i < free.size(); ++i)
      next.x[first + static_cast<int>(i)] = effect.parameters[free[i]].starts[choice[i]];
    result.push_back(std::move(next));
    size_t digit = 0;
    while (digit < free.size() && ++choice[digit] == effect.parameters[free[digit]].starts.size())
      choice[digit++] = 0;
    if (digit == free.size()) return result;
  }
}

JointModel ModelAt(const Hypothesis& hypothesis, const Eigen::VectorXd& x) {
  JointModel model = hypothesis.model;
  for (size_t i = 0; i < hypothesis.free.size(); ++i) {
    const absl::StatusOr<double*> value = FindValue(model, hypothesis.free[i].path);
    RS_CHECK(value.ok());
    **value = hypothesis.free[i].ToValue(x[static_cast<int>(i)]);
  }
  return model;
}

JointProblem::JointProblem(std::string joint, std::vector<JointTrack> tracks, int window)
    : joint_(std::move(joint)), tracks_(std::move(tracks)), window_(window) {}

std::vector<double> JointProblem::Residual(const JointModel& model, size_t index) const {
  const JointTrack& track = tracks_[index];
  const absl::StatusOr<JointModel> own = WithOverrides(model, joint_, track.log->overrides);
  RS_CHECK(own.ok());
  std::vector<double> residual(track.log->rows);
  JointSimulation(track).Predict(*own, window_, absl::MakeSpan(residual));
  const std::vector<double>& measured = track.measured(model.input);
  double mean = 0;
  for (size_t i = 0; i < residual.size(); ++i) {
    residual[i] -= measured[i];
    mean += residual[i] / static_cast<double>(residual.size());
  }
  if (model.input == JointInput::kTransmission) {
    for (double& value : residual) value -= mean;
  }
  return residual;
}

Eigen::VectorXd JointProblem::Residuals(const JointModel& model, const std::vector<size_t>& tracks,
                                        int stride) const {
  std::vector<double> kept;
  for (const size_t track : tracks) {
    const std::vector<double> residual = Residual(model, track);
    for (size_t i = 0; i < residual.size(); i += stride) kept.push_back(residual[i]);
  }
  return Eigen::Map<const Eigen::VectorXd>(kept.data(), static_cast<int>(kept.size()));
}

double JointProblem::Rms(const JointModel& model, const std::vector<size_t>& tracks) const {
  const Eigen::VectorXd r = Residuals(model, tracks, 1);
  return std::sqrt(r.squaredNorm() / static_cast<double>(r.size()));
}

Eigen::MatrixXd JointProblem::Jacobian(const Hypothesis& h, const Eigen::VectorXd& x,
                                       const Eigen::VectorXd& at_x,
                                       const std::vector<size_t>& tracks, int stride) const {
  Eigen::MatrixXd J(at_x.size(), x.size());
  const auto columns = [&](int first) {
    for (int i = first; i < x.size(); i += 2) {
      Eigen::VectorXd moved = x;
      // Into the bounds.
      const double step = kStep * std::max(1.0, std::abs(x[i]));
      moved[i] += x[i] + step > h.free[i].upper ? -step : step;
      J.col(i) = (Residuals(ModelAt(h, moved), tracks, stride) - at_x) / (moved[i] - x[i]);
    }
  };
  std::future<void> odd = std::async(std::launch::async, columns, 1);
  columns(0);
  odd.get();
  return J;
}

JointProblem::Fit JointProblem::Minimise(const Hypothesis& h, const std::vector<size_t>& tracks,
                                         int max_iterations) const {
  Fit fit;
  fit.best = h;
  if (h.free.empty()) {
    fit.rms = Rms(h.model, tracks);
    return fit;
  }
  int rows = 0;
  for (const size_t track : tracks) rows += tracks_[track].log->rows;
  const int stride = std::max(1, rows / kMaxResiduals);
  const double start = Rms(ModelAt(h, h.x), tracks);
  Eigen::VectorXd x = h.x;
  ceres::Problem problem;
  problem.AddResidualBlock(
      new Cost(*this, h, tracks, stride, std::max(start, 1e-12), &fit.evaluations), nullptr,
      x.data());
  for (size_t i = 0; i < h.free.size(); ++i) {
    const int index = static_cast<int>(i);
    x[index] = std::clamp(x[index], h.free[i].lower, h.free[i].upper);
    problem.SetParameterLowerBound(x.data(), index, h.free[i].lower);
    problem.SetParameterUpperBound(x.data(), index, h.free[i].upper);
  }
  ceres::Solver::Options options;
  options.max_num_iterations = max_iterations;
  options.linear_solver_type = ceres::DENSE_QR;
  options.function_tolerance = 1e-7;
  options.parameter_tolerance = 1e-7;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  fit.best.x = x;
  fit.rms = Rms(ModelAt(h, x), tracks);
  for (size_t i = 0; i < h.free.size(); ++i) {
    const double span = h.free[i].upper - h.free[i].lower, value = x[static_cast<int>(i)];
    fit.at_bound |= value - h.free[i].lower < 1e-6 * span || h.free[i].upper - value < 1e-6 * span;
  }
  return fit;
}

JointProblem::Fit JointProblem::MinimiseAll(const std::vector<Hypothesis>& starts,
                                            const std::vector<size_t>& tracks) const {
  Fit best;
  best.rms = std::numeric_limits<double>::infinity();
  for (const Hypothesis& start : starts) {
    Fit fit = Minimise(start, tracks);
    if (fit.rms < best.rms) best = std::move(fit);
  }
  return best;
}

}  // namespace robostress::calibration
