#include "calibration/search/joint_fit.h"

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "absl/strings/match.h"
#include "calibration/search/plausibility.h"
#include "calibration/search/subplex.h"

namespace robostress::calibration {
namespace {

constexpr size_t kTrials = 2;        // starts that are followed
constexpr int kTrialIterations = 3;  // of each, before the better goes on
constexpr int kSettleIterations = 12;
constexpr double kSearchTolerance = 3e-4;
constexpr int kUnstickEvaluations = 500;
constexpr int kWidenings = 2;
constexpr double kWiden = 3;             // times as far
constexpr double kWideningGain = 0.02;   // of the error
constexpr double kLooseningGain = 0.05;  // of the same
constexpr double kCommandGain = 0.03;    // of the same
constexpr double kNeedless = 0.005;      // of the error
constexpr double kStiction = 1.25;       // Fs / Fc of further starts

// What a model predicts wrongly, kept for the last x: Ceres asks for a step's cost, then for its
// residuals, then for their slopes.
class Residuals {
 public:
  Residuals(const JointProblem& problem, const Hypothesis& h, const WindowSet& chosen)
      : problem_(problem), h_(h), chosen_(chosen) {}
  const Eigen::VectorXd& At(const Eigen::VectorXd& x) {
    if (r_.size() == 0 || x_ != x) {
      r_ = problem_.Projected(ModelAt(h_, x), chosen_);
      x_ = x;
    }
    return r_;
  }
  Eigen::MatrixXd Jacobian(const Eigen::VectorXd& x) {
    return problem_.Jacobian(h_, x, At(x), chosen_);
  }
  double Rms(const Eigen::VectorXd& x) {
    const Eigen::VectorXd& r = At(x);
    return r.size() == 0 ? 0 : std::sqrt(r.squaredNorm() / static_cast<double>(r.size()));
  }

 private:
  const JointProblem& problem_;
  const Hypothesis& h_;
  const WindowSet& chosen_;
  Eigen::VectorXd x_, r_;
};

// Ceres' view of a problem: one block of residuals, one of parameters.
class Cost : public ceres::CostFunction {
 public:
  Cost(Residuals* residuals, int rows, int parameters, double unit)
      : residuals_(*residuals), parameters_(parameters), unit_(unit) {
    mutable_parameter_block_sizes()->push_back(parameters);
    set_num_residuals(rows);
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(parameters[0], parameters_);
    const Eigen::VectorXd r = residuals_.At(x) / unit_;
    if (!r.allFinite()) return false;
    // Pseudo-Huber at three units, so that a window that bifurcates does not decide.
    const Eigen::ArrayXd a = r.array() / 3, root = (1 + a.square()).sqrt();
    const Eigen::ArrayXd robust = 3 * r.array().sign() * (2 * (root - 1)).max(0).sqrt();
    Eigen::Map<Eigen::VectorXd>(residuals, r.size()) = robust.matrix();
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    const Eigen::MatrixXd J = residuals_.Jacobian(x) / unit_;
    if (!J.allFinite()) return false;
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
  Residuals& residuals_;
  const int parameters_;
  const double unit_;
};

// [rad/s] Exceeded by a twentieth of the rows; robust to single wrong readings.
double HighSpeed(const JointProblem& problem) {
  std::vector<double> speeds;
  for (const JointTrack& track : problem.tracks())
    for (const double dq : track.record().dq) speeds.push_back(std::abs(dq));
  if (speeds.empty()) return 0;
  const auto at = speeds.begin() + static_cast<std::ptrdiff_t>(speeds.size() * 19 / 20);
  std::nth_element(speeds.begin(), at, speeds.end());
  return *at;
}

// Where x of a Stribeck speed begins again. A curve that has left the speeds at which the joint was
// moved is plain friction, and nothing leads back: then these speeds are begun from.
std::vector<double> StribeckStarts(const FreeParameter& vs, double x, double high_speed) {
  const double value = vs.ToValue(x);
  if (high_speed == 0 || (value > 0.01 * high_speed && value < high_speed))
    return {0.4 * x, x, 2.5 * x};
  return {vs.FromValue(0.02 * high_speed), vs.FromValue(0.08 * high_speed),
          vs.FromValue(0.3 * high_speed)};
}

// Of a free parameter; -1: it is not free.
int IndexOf(const Hypothesis& h, const std::string& path) {
  for (size_t i = 0; i < h.free.size(); ++i)
    if (h.free[i].path == path) return static_cast<int>(i);
  return -1;
}

}  // namespace

JointFit Minimise(const JointProblem& problem, const Hypothesis& h, const WindowSet& chosen,
                  int max_iterations, double tolerance) {
  JointFit fit;
  fit.best = h;
  Residuals residuals(problem, h, chosen);
  Eigen::VectorXd x = h.x;
  for (size_t i = 0; i < h.free.size(); ++i)
    x[static_cast<int>(i)] = std::clamp(x[static_cast<int>(i)], h.free[i].lower, h.free[i].upper);
  fit.rms = residuals.Rms(x);
  fit.at_bound.assign(h.free.size(), 0);
  fit.best.x = x;
  if (h.free.empty() || problem.Rows(chosen) == 0 || max_iterations == 0) return fit;
  const double unit = std::max(fit.rms, 1e-12);
  ceres::Problem solver;
  solver.AddResidualBlock(
      new Cost(&residuals, problem.Rows(chosen), static_cast<int>(x.size()), unit), nullptr,
      x.data());
  for (size_t i = 0; i < h.free.size(); ++i) {
    solver.SetParameterLowerBound(x.data(), static_cast<int>(i), h.free[i].lower);
    solver.SetParameterUpperBound(x.data(), static_cast<int>(i), h.free[i].upper);
  }
  ceres::Solver::Options options;
  options.max_num_iterations = max_iterations;
  options.linear_solver_type = ceres::DENSE_QR;
  options.function_tolerance = tolerance;
  options.parameter_tolerance = 1e-7;
  // A step is shortened by its errors alone; with Ceres' default, CUBIC, every try differentiates.
  options.line_search_interpolation_type = ceres::QUADRATIC;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &solver, &summary);
  fit.best.x = x;
  fit.rms = residuals.Rms(x);
  MarkBounds(fit);
  return fit;
}

void MarkBounds(JointFit& fit) {
  fit.at_bound.assign(fit.best.free.size(), 0);
  for (size_t i = 0; i < fit.best.free.size(); ++i) {
    const FreeParameter& free = fit.best.free[i];
    const double span = free.upper - free.lower, value = fit.best.x[static_cast<int>(i)];
    fit.at_bound[i] = value - free.lower < 1e-6 * span || free.upper - value < 1e-6 * span;
  }
}

JointFit Try(const JointProblem& problem, const std::vector<Hypothesis>& starts,
             const WindowSet& chosen) {
  std::vector<JointFit> trials;
  for (const Hypothesis& start : starts) trials.push_back(Minimise(problem, start, chosen, 0));
  const auto lower = [](const JointFit& a, const JointFit& b) { return a.rms < b.rms; };
  std::stable_sort(trials.begin(), trials.end(), lower);
  if (trials.empty()) return {};
  if (trials.size() > kTrials) trials.resize(kTrials);
  for (JointFit& trial : trials)
    trial = Minimise(problem, trial.best, chosen, kTrialIterations, kSearchTolerance);
  return *std::min_element(trials.begin(), trials.end(), lower);
}

JointFit Settle(const JointProblem& problem, const JointFit& trial, const WindowSet& chosen) {
  return Minimise(problem, trial.best, chosen, kSettleIterations, kSearchTolerance);
}

JointFit Unstick(const JointProblem& problem, const JointFit& fit, const WindowSet& chosen) {
  const auto error = [&](const Eigen::VectorXd& x) {
    return problem.Projected(ModelAt(fit.best, x), chosen).cwiseAbs().mean();
  };
  Hypothesis start = fit.best;
  start.x = Subplex(error, fit.best.free, fit.best.x, kUnstickEvaluations).x;
  JointFit free = Minimise(problem, start, chosen, kSettleIterations, kSearchTolerance);
  return free.rms < fit.rms ? free : fit;
}

JointFit Widen(const JointProblem& problem, JointFit fit, const WindowSet& chosen) {
  for (int round = 0; round < kWidenings; ++round) {
    Hypothesis wider = fit.best;
    bool any = false;
    for (size_t i = 0; i < wider.free.size(); ++i) {
      FreeParameter& free = wider.free[i];
      const bool of_effect =
          free.path.find('.') != std::string::npos && !absl::StartsWith(free.path, "servo.");
      if (!fit.at_bound[i] || !of_effect || IsAbsence(fit.best, static_cast<int>(i))) continue;
      const bool upper =
          free.upper - wider.x[static_cast<int>(i)] < wider.x[static_cast<int>(i)] - free.lower;
      double& bound = upper ? free.upper : free.lower;
      any |= bound != 0;
      bound *= upper == (bound > 0) ? kWiden : 1 / kWiden;
    }
    if (!any) return fit;
    JointFit next = Minimise(problem, wider, chosen, kSettleIterations, kSearchTolerance);
    if (next.rms > (1 - kWideningGain) * fit.rms) return fit;
    fit = std::move(next);
  }
  return fit;
}

JointFit Loosen(const JointProblem& problem, const JointFit& fit,
                const std::vector<std::string>& types, const WindowSet& chosen) {
  const Hypothesis loose = WithLateParameters(fit.best, types);
  const size_t known = fit.best.free.size();
  if (loose.free.size() == known) return fit;
  std::vector<Hypothesis> starts;
  for (const double times : {1.0, 0.5, 2.0, 4.0}) {
    starts.push_back(loose);
    starts.back().x[static_cast<Eigen::Index>(known)] *= times;
  }
  const JointFit best = Settle(problem, Try(problem, starts, chosen), chosen);
  return best.rms < (1 - kLooseningGain) * fit.rms ? best : fit;
}

JointFit WithBetterCommands(const JointProblem& problem, const JointFit& fit,
                            const WindowSet& chosen) {
  Hypothesis other = fit.best;
  const JointInput input = other.model.input;
  if (input != JointInput::kPositionTarget && input != JointInput::kTorque) return fit;
  other.model.continuous_command = !other.model.continuous_command;
  // What holds over its row acts half a row later.
  const int shift = IndexOf(other, "command_shift");
  if (shift >= 0) other.x[shift] += other.model.continuous_command ? 0.5 : -0.5;
  JointFit next = Minimise(problem, other, chosen, kSettleIterations, kSearchTolerance);
  // What is half a row younger may make up for a delay that is longer than the shift may be.
  if (shift >= 0 && next.at_bound[shift]) return fit;
  return next.rms < (1 - kCommandGain) * fit.rms ? next : fit;
}

JointFit MinimiseWithout(const JointProblem& problem, const JointFit& fit, const Hypothesis& less,
                         const WindowSet& chosen) {
  if (less.free.empty()) return Minimise(problem, less, chosen);
  const Eigen::VectorXd with = problem.Projected(ModelAt(fit.best, fit.best.x), chosen),
                        without = problem.Projected(ModelAt(less, less.x), chosen);
  const Eigen::MatrixXd all = problem.Jacobian(fit.best, fit.best.x, with, chosen);
  Eigen::MatrixXd J(all.rows(), static_cast<Eigen::Index>(less.free.size()));
  for (size_t i = 0; i < less.free.size(); ++i)
    J.col(static_cast<Eigen::Index>(i)) = all.col(IndexOf(fit.best, less.free[i].path));
  const Eigen::VectorXd step = J.completeOrthogonalDecomposition().solve(with - without);
  Hypothesis start = less;
  double least = without.squaredNorm();
  for (const double share : {1.0, 0.5, 0.25}) {
    Hypothesis led = less;
    for (size_t i = 0; i < led.free.size(); ++i) {
      const auto k = static_cast<Eigen::Index>(i);
      led.x[k] = std::clamp(led.x[k] + share * step[k], led.free[i].lower, led.free[i].upper);
    }
    const double error = problem.Projected(ModelAt(led, led.x), chosen).squaredNorm();
    if (error < least) start = std::move(led), least = error;
  }
  return Minimise(problem, start, chosen);
}

JointFit DropIdle(const JointProblem& problem, JointFit fit, const std::string& type,
                  const WindowSet& chosen) {
  const EffectInfo& effect = **FindEffect(type);
  if (effect.amplitudes.size() < 2) return fit;
  const Eigen::VectorXd r = problem.Projected(ModelAt(fit.best, fit.best.x), chosen);
  const Eigen::MatrixXd J = problem.Jacobian(fit.best, fit.best.x, r, chosen);
  Hypothesis less = fit.best;
  for (const int amplitude : effect.amplitudes) {
    const std::string path = absl::StrCat(type, ".", effect.parameters[amplitude].name);
    const int before = IndexOf(fit.best, path), now = IndexOf(less, path);
    if (before >= 0 && !(J.col(before).norm() > 0)) less = FixedAtZero(less, now);
  }
  const size_t left = less.free.size();
  return left < fit.best.free.size()
             ? Minimise(problem, less, chosen, kSettleIterations, kSearchTolerance)
             : fit;
}

JointFit DropNeedless(const JointProblem& problem, JointFit fit, const std::string& type,
                      const WindowSet& chosen) {
  const EffectInfo& effect = **FindEffect(type);
  if (effect.amplitudes.size() < 2) return fit;
  for (const int amplitude : effect.amplitudes) {
    const int at = IndexOf(fit.best, absl::StrCat(type, ".", effect.parameters[amplitude].name));
    if (at < 0) continue;
    JointFit less = MinimiseWithout(problem, fit, FixedAtZero(fit.best, at), chosen);
    if (less.rms < (1 + kNeedless) * fit.rms) fit = std::move(less);
  }
  return fit;
}

bool HasFreeFriction(const Hypothesis& h) {
  return IndexOf(h, "stribeck_friction.Fs") >= 0 || IndexOf(h, "stribeck_friction.vs") >= 0;
}

JointFit MinimiseFriction(const JointProblem& problem, const Hypothesis& h,
                          const WindowSet& chosen) {
  JointFit best = Minimise(problem, h, chosen);
  if (!HasFreeFriction(h)) return best;
  const int Fs = IndexOf(h, "stribeck_friction.Fs"), vs = IndexOf(h, "stribeck_friction.vs");
  JointModel model = ModelAt(h, h.x);
  const double Fc = **FindValue(model, "stribeck_friction.Fc");
  std::vector<double> starts{0};
  if (vs >= 0) starts = StribeckStarts(h.free[vs], h.x[vs], HighSpeed(problem));
  for (const double start : starts) {
    Hypothesis other = h;
    if (vs >= 0) other.x[vs] = start;
    if (Fs >= 0) other.x[Fs] = std::max(h.x[Fs], kStiction * h.free[Fs].FromValue(Fc));
    JointFit fit = Minimise(problem, other, chosen);
    if (fit.rms < best.rms) best = std::move(fit);
  }
  return best;
}

double CorrelationRows(const Eigen::VectorXd& r) {
  double rows = 1;
  for (int lag = 1; lag < r.size() / 4; ++lag) {
    const double rho =
        r.head(r.size() - lag).dot(r.tail(r.size() - lag)) / std::max(r.squaredNorm(), 1e-300);
    if (!(rho > 0.05)) break;
    rows += 2 * rho;
  }
  return rows;
}

std::vector<double> StandardDeviations(const JointProblem& problem, const JointFit& fit,
                                       const WindowSet& chosen) {
  const Hypothesis& h = fit.best;
  std::vector<double> result(h.free.size(), 0);
  if (h.free.empty()) return result;
  const Eigen::VectorXd r = problem.Projected(ModelAt(h, h.x), chosen);
  Eigen::MatrixXd J = problem.Jacobian(h, h.x, r, chosen);
  // What stands on a bound is held there.
  for (size_t i = 0; i < h.free.size(); ++i)
    if (fit.at_bound[i]) J.col(static_cast<int>(i)).setZero();
  const double variance = r.squaredNorm() / static_cast<double>(r.size());
  const Eigen::MatrixXd covariance =
      (J.transpose() * J).completeOrthogonalDecomposition().pseudoInverse() * variance *
      CorrelationRows(r);
  for (size_t i = 0; i < h.free.size(); ++i) {
    const int k = static_cast<int>(i);
    // d value / d x
    const double slope =
        h.free[i].inverse ? h.free[i].ToValue(h.x[k]) / std::max(h.x[k], 1e-12) : h.free[i].scale;
    result[i] = std::abs(slope) * std::sqrt(std::max(0.0, covariance(k, k)));
  }
  return result;
}

}  // namespace robostress::calibration
