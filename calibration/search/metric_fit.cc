#include "calibration/search/metric_fit.h"

#include <algorithm>
#include <cmath>

#include "calibration/search/parallel.h"
#include "calibration/search/subplex.h"

namespace robostress::calibration {
namespace {

constexpr double kNoiseLeft = 1.5;  // times the floor
constexpr int kMaxEvaluations = 1500;

}  // namespace

MetricFit::MetricFit(const Metric& metric, const JointProblem& search, int window)
    : type_(metric.type), problem_(search.joint(), search.tracks(), window), search_(search) {}

bool MetricFit::Has(LogRole role) const { return problem_.Rows(problem_.OfRole(role)) > 0; }

double MetricFit::Floor(LogRole role) const { return Floor(search_.OfRole(role)); }

double MetricFit::Floor(const WindowSet& windows) const {
  const double rms = search_.Floor(windows);
  return type_ == Metric::Type::kMeanAbsolute ? std::sqrt(2 / M_PI) * rms : rms;
}

double MetricFit::Error(const JointModel& model, LogRole role) const {
  return Error(model, problem_.OfRole(role));
}

double MetricFit::Error(const JointModel& model, const WindowSet& windows) const {
  if (problem_.Rows(windows) == 0) return 0;
  if (type_ == Metric::Type::kRms) return problem_.Rms(model, windows);
  return problem_.Residuals(model, windows).cwiseAbs().mean();
}

Hypothesis MetricFit::Best(const Hypothesis& from) const {
  const WindowSet fit = problem_.OfRole(LogRole::kFit);
  Hypothesis best = Minimise(problem_, from, fit).best;
  if (!own() || best.free.empty()) return best;
  // From where least squares ended and from where it began: of whole runs it may have got stuck.
  const SubplexMinimum one = Descend(best, fit);
  const SubplexMinimum other = Descend(from, fit);
  best.x = other.value < one.value ? other.x : one.x;
  return best;
}

void MetricFit::Refit(JointFit& fit) const {
  const double floor = search_.ProjectedFloor(search_.OfRole(LogRole::kFit));
  const double error = Error(ModelAt(fit.best, fit.best.x), LogRole::kFit);
  if (fit.rms < kNoiseLeft * floor || error < kNoiseLeft * Floor(LogRole::kFit)) return;
  fit.best = Best(fit.best);
  MarkBounds(fit);
}

SubplexMinimum MetricFit::Descend(const Hypothesis& from, const WindowSet& windows) const {
  const auto error = [&](const Eigen::VectorXd& x) { return Error(ModelAt(from, x), windows); };
  return Subplex(error, from.free, from.x, kMaxEvaluations);
}

Hypothesis MetricFit::Again(Hypothesis best, const WindowSet& windows) const {
  if (best.free.empty()) return best;
  if (!own()) return Minimise(problem_, best, windows).best;
  best.x = Descend(best, windows).x;
  return best;
}

double MetricFit::LeftOut(const Hypothesis& best, Folds folds) const {
  const std::vector<WindowSet> sets = MakeFolds(problem_, folds);
  const WindowSet fit = problem_.OfRole(LogRole::kFit);
  std::vector<double> sums(sets.size(), 0);
  ParallelFor(static_cast<int>(sets.size()), [&](int f) {
    WindowSet others = fit;
    for (size_t i = 0; i < others.size(); ++i)
      if (sets[f][i]) others[i] = 0;
    const Hypothesis again = Again(best, others);
    const Eigen::VectorXd r = problem_.Residuals(ModelAt(again, again.x), sets[f]);
    sums[f] = type_ == Metric::Type::kRms ? r.squaredNorm() : r.cwiseAbs().sum();
  });
  double sum = 0;
  for (const double s : sums) sum += s;
  const double mean = sum / std::max(1, problem_.Rows(fit));
  return type_ == Metric::Type::kRms ? std::sqrt(mean) : mean;
}

}  // namespace robostress::calibration
