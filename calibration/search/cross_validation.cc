#include "calibration/search/cross_validation.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "calibration/search/parallel.h"

namespace robostress::calibration {
namespace {

constexpr int kBlocks = 5;
constexpr int kRefitIterations = 4;
constexpr double kTail = 0.1;  // of the windows

bool Fits(const JointProblem& problem, const Window& window) {
  return problem.tracks()[window.track].log->role == LogRole::kFit;
}

}  // namespace

std::vector<WindowSet> MakeFolds(const JointProblem& problem, Folds folds) {
  std::map<std::string, int> conditions;
  std::map<size_t, int> logs;
  for (const Window& window : problem.windows()) {
    if (!Fits(problem, window)) continue;
    const std::string& condition = problem.tracks()[window.track].log->condition;
    conditions.emplace(condition, static_cast<int>(conditions.size()));
    logs.emplace(window.track, static_cast<int>(logs.size()));
  }
  if (folds == Folds::kAuto)
    folds = conditions.size() >= 2 ? Folds::kCondition
            : logs.size() >= 3     ? Folds::kLog
                                   : Folds::kBlock;
  if (folds == Folds::kCondition && conditions.size() < 2) folds = Folds::kLog;
  if (folds == Folds::kLog && logs.size() < 2) folds = Folds::kBlock;
  const size_t count = folds == Folds::kCondition ? conditions.size()
                       : folds == Folds::kLog     ? logs.size()
                                                  : kBlocks;
  std::vector<WindowSet> result(count, WindowSet(problem.windows().size(), 0));
  for (size_t i = 0; i < problem.windows().size(); ++i) {
    const Window& window = problem.windows()[i];
    if (!Fits(problem, window)) continue;
    const MeasuredLog& log = *problem.tracks()[window.track].log;
    const int fold =
        folds == Folds::kCondition ? conditions[log.condition]
        : folds == Folds::kLog
            ? logs[window.track]
            : static_cast<int>(static_cast<int64_t>(window.first) * kBlocks / log.rows);
    result[fold][i] = 1;
  }
  return result;
}

WindowSet WithoutLargest(const std::vector<double>& energy, const std::vector<int>& rows) {
  std::vector<size_t> order;
  for (size_t i = 0; i < energy.size(); ++i)
    if (rows[i] > 0) order.push_back(i);
  const auto tail = static_cast<size_t>(std::ceil(kTail * static_cast<double>(order.size())));
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return energy[a] * rows[b] < energy[b] * rows[a]; });
  WindowSet bulk(energy.size(), 0);
  for (size_t i = 0; i + tail < order.size(); ++i) bulk[order[i]] = 1;
  return bulk;
}

double CrossValidation::Rms() const {
  double sum = 0, count = 0;
  for (size_t i = 0; i < energy.size(); ++i) sum += energy[i], count += rows[i];
  return count > 0 ? std::sqrt(sum / count) : 0;
}

double CrossValidation::Rms(const WindowSet& chosen) const {
  double sum = 0, count = 0;
  for (size_t i = 0; i < energy.size(); ++i)
    if (chosen[i]) sum += energy[i], count += rows[i];
  return count > 0 ? std::sqrt(sum / count) : 0;
}

WindowSet CrossValidation::Bulk() const { return WithoutLargest(energy, rows); }

CrossValidation CrossValidate(const JointProblem& problem, const JointFit& fit,
                              const std::vector<WindowSet>& folds) {
  CrossValidation result;
  const size_t windows = problem.windows().size();
  result.energy.assign(windows, 0);
  result.rows.assign(windows, 0);
  result.fold_rms.resize(folds.size());
  result.x.resize(folds.size());
  WindowSet fitted(windows, 0);
  for (const WindowSet& fold : folds)
    for (size_t i = 0; i < windows; ++i) fitted[i] |= fold[i];
  ParallelFor(static_cast<int>(folds.size()), [&](int f) {
    WindowSet others = fitted;
    for (size_t i = 0; i < windows; ++i)
      if (folds[f][i]) others[i] = 0;
    const Hypothesis best = Minimise(problem, fit.best, others, kRefitIterations, 1e-3).best;
    result.x[f] = best.x;
    const Eigen::VectorXd r = problem.Projected(ModelAt(best, best.x), folds[f]);
    result.fold_rms[f] = r.size() > 0 ? std::sqrt(r.squaredNorm() / double(r.size())) : 0;
    int row = 0;
    for (size_t i = 0; i < windows; ++i) {
      if (!folds[f][i]) continue;
      const int rows = problem.Rows(problem.windows()[i]);
      result.energy[i] = r.segment(row, rows).squaredNorm();
      result.rows[i] = rows;
      row += rows;
    }
  });
  return result;
}

PairedDifference Compare(const CrossValidation& a, const CrossValidation& b) {
  double count = 0, rows = 0, sum = 0, squares = 0;
  for (size_t i = 0; i < a.energy.size(); ++i) {
    if (a.rows[i] == 0) continue;
    const double d = b.energy[i] - a.energy[i];
    count += 1, rows += a.rows[i], sum += d, squares += d * d;
  }
  if (count < 2) return {};
  const double mean = sum / count;
  return {sum / rows, std::sqrt(std::max(0.0, squares / count - mean * mean) * count) / rows};
}

}  // namespace robostress::calibration
