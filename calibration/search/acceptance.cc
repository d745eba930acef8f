#include "calibration/search/acceptance.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/search/plausibility.h"

namespace robostress::calibration {
namespace {

constexpr double kMinBicGain = 10;
constexpr double kMinFolds = 0.75;       // share of folds that must gain
constexpr double kMinExcessGain = 0.25;  // of the energy above the floor
constexpr double kMinSigmas = 3;         // of the size
constexpr double kMaxSpread = 0.5;       // of the size over folds, relative
constexpr int64_t kManyRuns = 20;        // of fewer, a tenth is a log or two
constexpr double kNearlyAll = 0.9;       // of the runs in which an effect may act alone
constexpr int64_t kFewestActed = 6;      // of those: by chance all gain once in 64 times

// Where a joint nearly sticks a few free runs are far off, and any change of the model sets some of
// them right and others wrong. An effect that acts in a few runs, as a limit does, helps in nearly
// all that are far off with it or without it, and costs nothing elsewhere.
bool HelpsInFewByChance(const CrossValidation& base, const CrossValidation& model) {
  const WindowSet bulk = base.Bulk();
  const int64_t runs =
      std::count_if(base.rows.begin(), base.rows.end(), [](int r) { return r > 0; });
  if (runs < kManyRuns || model.Rms(bulk) <= (1 - Acceptance::kMinCvGain) * base.Rms(bulk))
    return false;
  std::vector<double> worse = base.energy;
  for (size_t i = 0; i < worse.size(); ++i) worse[i] = std::max(worse[i], model.energy[i]);
  const WindowSet near = WithoutLargest(worse, base.rows);
  int64_t far = 0, gained = 0;
  for (size_t i = 0; i < worse.size(); ++i) {
    if (base.rows[i] == 0 || near[i]) continue;
    ++far;
    gained += model.energy[i] < base.energy[i];
  }
  return far < kFewestActed ||
         static_cast<double>(gained) < kNearlyAll * static_cast<double>(far) ||
         model.Rms(near) > (1 + Acceptance::kMinCvGain) * base.Rms(near);
}

}  // namespace

double Acceptance::Excess(const TracedModel& model) const {
  return std::max(0.0, model.cv.Rms() * model.cv.Rms() - floor_ * floor_);
}

bool Acceptance::ExplainsMore(const TracedModel& base, const TracedModel& model) const {
  return Excess(model) <= (1 - kMinExcessGain) * Excess(base);
}

std::string Acceptance::Objection(const TracedModel& base, const TracedModel& model,
                                  double p) const {
  if (model.cv.energy.empty()) return "others fit better";
  const double gain = 1 - model.cv.Rms() / base.cv.Rms();
  if (p > kMaxPValue && gain < kNoChance)
    return absl::StrFormat("chance explains as much (p = %.3f)", p);
  if (gain < kMinCvGain)
    return absl::StrFormat("the cross-validated error falls by %.1f %% only", 100 * gain);
  if (!ExplainsMore(base, model))
    return absl::StrFormat("it explains %.0f %% of what is above the noise",
                           100 * (1 - Excess(model) / std::max(Excess(base), 1e-300)));
  if (HelpsInFewByChance(base.cv, model.cv))
    return "it helps in the worst tenth of the free runs only, and not in nearly all of those";
  const size_t folds = model.cv.fold_rms.size();
  int gained = 0;
  for (size_t f = 0; f < folds; ++f) gained += model.cv.fold_rms[f] < base.cv.fold_rms[f];
  if (gained < kMinFolds * static_cast<double>(folds))
    return absl::StrFormat("only %d of %d folds gain", gained, folds);
  if (BicGain(base, model) < kMinBicGain)
    return absl::StrFormat("BIC falls by %.0f only", BicGain(base, model));
  for (size_t i = base.added.size(); i < model.added.size(); ++i) {
    std::string objection = SizeObjection(model, model.added[i]);
    if (!objection.empty()) return objection;
  }
  return "";
}

std::string Acceptance::Doubt(const TracedModel& model) const {
  const std::vector<double> std = StandardDeviations(problem_, model.fit, fit_windows_);
  for (const std::string& added : model.added)
    if (std::string doubt = ParameterDoubt(model.fit, std, added); !doubt.empty()) return doubt;
  return PhysicalDoubt(problem_, model.fit, std);
}

double Acceptance::BicGain(const TracedModel& base, const TracedModel& model) const {
  const Eigen::VectorXd r =
      problem_.Projected(ModelAt(model.fit.best, model.fit.best.x), fit_windows_);
  const double n = static_cast<double>(r.size()) / CorrelationRows(r);
  const double more = static_cast<double>(model.fit.best.free.size()) -
                      static_cast<double>(base.fit.best.free.size());
  return 2 * n * std::log(base.fit.rms / std::max(model.fit.rms, 1e-300)) - more * std::log(n);
}

std::string Acceptance::SizeObjection(const TracedModel& model, const std::string& added) const {
  const Hypothesis& best = model.fit.best;
  const EffectInfo& effect = **FindEffect(added);
  const std::vector<double> std = StandardDeviations(problem_, model.fit, fit_windows_);
  const auto size_of = [&](int k) {
    const FreeParameter& free = best.free[k];
    return free.inverse ? free.ToValue(best.x[k]) : free.scale * best.x[k];
  };
  // Of several sizes the one that is known best: declared parameters may stand in for another.
  int told = -1;
  double known = -1;
  for (const int amplitude : effect.amplitudes) {
    const std::string path = effect.type + "." + effect.parameters[amplitude].name;
    for (size_t i = 0; i < best.free.size(); ++i) {
      if (best.free[i].path != path) continue;
      const int k = static_cast<int>(i);
      const double sigmas = std[i] > 0 ? std::abs(size_of(k)) / std[i] : 0;
      if (sigmas > known) known = sigmas, told = k;
    }
  }
  if (told < 0) return "";
  const FreeParameter& free = best.free[told];
  const double size = size_of(told);
  if (std::abs(size) < kMinSigmas * std[told])
    return absl::StrFormat("%s is %.3g +- %.2g", free.path, size, std[told]);
  if (model.fit.at_bound[told]) return absl::StrCat(free.path, " is on a bound");
  double low = best.x[told], high = low;
  for (const Eigen::VectorXd& x : model.cv.x) {
    low = std::min(low, x[told]);
    high = std::max(high, x[told]);
  }
  if (low * high < 0 || high - low > 2 * kMaxSpread * std::abs(best.x[told]))
    return absl::StrFormat("%s differs over the folds, %.3g to %.3g", free.path, free.ToValue(low),
                           free.ToValue(high));
  return "";
}

}  // namespace robostress::calibration
