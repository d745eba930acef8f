#include "calibration/search/rivals.h"

#include <algorithm>
#include <cmath>

#include "calibration/search/parallel.h"

namespace robostress::calibration {
namespace {

constexpr double kSimilarErrors = 2;   // standard errors of the difference over folds
constexpr double kRivalMargin = 0.05;  // a rival's error may be larger by this share
constexpr double kAlikeMargin = 0.25;  // of one whose signature looks alike
constexpr double kAlike = 0.95;        // |cos| between signatures
constexpr double kRivalGain = 0.5;     // of the effect's own linear gain
constexpr double kFarWorse = 2;        // times the error: no rival, whatever cross-validation says

const std::string& TypeOf(const Screening& screening, int candidate) {
  return screening.candidates()[candidate].effect->type;
}

double GainOf(const Screening& screening, const std::string& effect) {
  double gain = 0;
  for (const Signature& signature : screening.signatures())
    if (TypeOf(screening, signature.candidate) == effect)
      gain = std::max(gain, screening.Gain(signature));
  return gain;
}

bool Mimics(const std::string& one, const std::string& other) {
  const std::vector<std::string>&a = (*FindEffect(one))->mimics, &b = (*FindEffect(other))->mimics;
  return std::find(a.begin(), a.end(), other) != a.end() ||
         std::find(b.begin(), b.end(), one) != b.end();
}

// What explains about as much of the residual as `effect`, and what the library takes for it:
// declared parameters that stand in for a mimic hide its signature. Best first.
std::vector<Contender> Others(const Screening& screening, const std::string& effect, int at_most) {
  const NullDistribution nothing{{},
                                 std::vector<std::vector<double>>(screening.candidates().size())};
  const double gain = GainOf(screening, effect);
  std::vector<Contender> others;
  for (Contender& contender : Rank(screening, nothing))
    if (TypeOf(screening, contender.candidate) != effect && !contender.starts.empty() &&
        (contender.gain > kRivalGain * gain ||
         Mimics(effect, TypeOf(screening, contender.candidate))))
      others.push_back(std::move(contender));
  const auto rest = std::stable_partition(
      others.begin(), others.end(), [&](const Contender& c) { return c.gain > kRivalGain * gain; });
  const auto alike = std::min<std::ptrdiff_t>(at_most, rest - others.begin());
  others.erase(others.begin() + alike, rest);
  return others;
}

// `cosine`: between what the two add to the prediction.
bool IsRival(const TracedModel& best, const TracedModel& other, double cosine) {
  if (other.cv.energy.empty()) return false;
  const PairedDifference difference = Compare(best.cv, other.cv);
  const double ratio = other.cv.Rms() / std::max(best.cv.Rms(), 1e-300);
  const bool simpler = best.fit.best.free.size() < other.fit.best.free.size();
  // One that needs more parameters to do no better is not needed.
  if (simpler && ratio >= 1) return false;
  if (difference.mean < kSimilarErrors * difference.standard_error) return true;
  return ratio < 1 + (cosine > kAlike ? kAlikeMargin : kRivalMargin);
}

}  // namespace

std::vector<TracedModel> RivalSearch::FitInPlace(const TracedModel& model, const TracedModel& base,
                                                 const std::string& effect,
                                                 const Screening& screening,
                                                 const std::vector<Contender>& others) const {
  const int count = static_cast<int>(others.size());
  std::vector<TracedModel> models(count);
  std::vector<const TracedModel*> known(count);
  std::vector<double> promised(count);
  for (int i = 0; i < count; ++i) {
    std::vector<std::string> added = base.added;
    added.push_back(TypeOf(screening, others[i].candidate));
    known[i] = refits_.Find(added);
    promised[i] = others[i].Promised(base.fit.rms);
  }
  ParallelFor(count, [&](int i) {
    models[i] = known[i] != nullptr ? *known[i] : refits_.OnTrial(base, screening, others[i]);
  });
  refits_.SettleBest(models, promised, model.fit.rms);
  ParallelFor(count, [&](int i) {
    if (known[i] == nullptr && Mimics(effect, models[i].added.back())) refits_.Restart(models[i]);
  });
  for (TracedModel& other : models)
    if (other.cv.energy.empty() && other.fit.rms < kFarWorse * model.fit.rms)
      refits_.CrossValidate(other);
  return models;
}

std::vector<std::string> RivalSearch::RivalsOf(const TracedModel& model, const std::string& effect,
                                               std::vector<TracedModel>& rival_models) {
  const JointProblem& problem = refits_.problem();
  const WindowSet& windows = refits_.windows();
  const size_t index =
      std::find(model.added.begin(), model.added.end(), effect) - model.added.begin();
  TracedModel base = refits_.Without(model, index);
  if (base.added.empty()) base.fit.best = WithoutEffect(base.fit.best, effect);
  const Screening screening(problem, base.fit, scales_, candidates_(base), windows);
  // The effect's share in the fitted prediction, as a direction.
  Eigen::MatrixXd share = problem.Projected(ModelAt(model.fit.best, model.fit.best.x), windows) -
                          problem.Projected(ModelAt(base.fit.best, base.fit.best.x), windows);
  screening.RemoveImitated(share);
  const std::vector<Contender> others = Others(screening, effect, finalists_);
  const std::vector<TracedModel> models = FitInPlace(model, base, effect, screening, others);
  std::vector<std::string> rivals;
  for (size_t i = 0; i < others.size(); ++i) {
    const Eigen::MatrixXd& basis = others[i].starts.front()->basis;
    const double cosine = (basis.transpose() * share).norm() / std::max(share.norm(), 1e-300);
    if (!IsRival(model, models[i], cosine)) continue;
    rivals.push_back(TypeOf(screening, others[i].candidate));
    rival_models.push_back(models[i]);
  }
  return rivals;
}

}  // namespace robostress::calibration
