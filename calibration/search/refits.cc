#include "calibration/search/refits.h"

#include <algorithm>

#include "absl/strings/str_join.h"
#include "calibration/search/parallel.h"
#include "calibration/search/plausibility.h"

namespace robostress::calibration {
namespace {

constexpr int64_t kMaxWindows = 120;  // that a search simulates
constexpr int kCrossValidated = 4;    // refitted candidates of a round, the lowest errors
constexpr double kFarOff = 5;         // times the lowest error after the first iterations
constexpr double kOutclassed = 3;     // times the lowest error of a round
constexpr double kAtFloor = 1.1;      // times the floor: nothing is left to gain
constexpr int kStartsPerCandidate = 2;
constexpr char kFriction[] = "stribeck_friction";
constexpr double kStuck = 1.3;   // times the promised error
constexpr double kMuchLeft = 3;  // times the floor

std::string KeyOf(std::vector<std::string> added) {
  std::sort(added.begin(), added.end());
  return absl::StrJoin(added, "+");
}

// At most kMaxWindows of `windows`, evenly.
WindowSet Thinned(WindowSet windows) {
  const auto count = std::count(windows.begin(), windows.end(), 1);
  int64_t seen = 0;
  for (char& window : windows) {
    if (!window) continue;
    window = count <= kMaxWindows || seen * kMaxWindows / count != (seen + 1) * kMaxWindows / count;
    ++seen;
  }
  return windows;
}

std::vector<TracedModel*> ByError(std::vector<TracedModel>& models) {
  std::vector<TracedModel*> order;
  for (TracedModel& model : models) order.push_back(&model);
  std::stable_sort(order.begin(), order.end(), [](const TracedModel* a, const TracedModel* b) {
    return a->fit.rms < b->fit.rms;
  });
  return order;
}

}  // namespace

Refits::Refits(const JointProblem& problem, const Hypothesis& start, Folds folds)
    : problem_(problem),
      start_(start),
      windows_(Thinned(problem.OfRole(LogRole::kFit))),
      folds_(MakeFolds(problem, folds)) {
  for (WindowSet& fold : folds_)
    for (size_t i = 0; i < fold.size(); ++i) fold[i] &= windows_[i];
}

TracedModel Refits::Declared(const Hypothesis& declared) const {
  TracedModel model;
  model.fit = Minimise(problem_, declared, windows_);
  CrossValidate(model);
  return model;
}

TracedModel Refits::OnTrial(const TracedModel& base, const Screening& screening,
                            const Contender& contender) const {
  std::vector<Hypothesis> starts;
  for (size_t i = 0; i < contender.starts.size() && i < kStartsPerCandidate; ++i) {
    starts.push_back(screening.LinearStart(*contender.starts[i]));
    if (i == 0) starts.push_back(contender.starts[i]->start);
  }
  TracedModel model = base;
  model.added.push_back(screening.candidates()[contender.candidate].effect->type);
  model.fit = Try(problem_, starts, windows_);
  model.cv = {};
  return model;
}

void Refits::SettleBest(std::vector<TracedModel>& models, const std::vector<double>& promised,
                        double error) const {
  for (const TracedModel& model : models) error = std::min(error, model.fit.rms);
  ParallelFor(static_cast<int>(models.size()), [&](int i) {
    TracedModel& model = models[i];
    // A signature that explains as much as the best does may lie along a valley of the declared
    // parameters, where first iterations lead nowhere.
    const bool far = model.fit.rms > kFarOff * error && promised[i] > kStuck * error;
    if (far || !model.cv.energy.empty()) return;
    model.fit = Settle(problem_, model.fit, windows_);
    if (model.added.back() == kFriction)
      model.fit = MinimiseFriction(problem_, model.fit.best, windows_);
    if (model.fit.rms > kStuck * promised[i]) model.fit = Unstick(problem_, model.fit, windows_);
    model.fit = Widen(problem_, model.fit, windows_);
    if (model.fit.rms > kAtFloor * problem_.ProjectedFloor(windows_)) {
      model.fit = Loosen(problem_, model.fit, model.added, windows_);
      model.fit = WithBetterCommands(problem_, model.fit, windows_);
    }
    model.fit = DropIdle(problem_, model.fit, model.added.back(), windows_);
  });
}

Hypothesis Refits::FromStart(Hypothesis h) const {
  for (size_t i = 0; i < h.free.size(); ++i)
    for (size_t k = 0; k < start_.free.size(); ++k)
      if (h.free[i].path == start_.free[k].path) h.x[i] = start_.x[k];
  return h;
}

void Refits::Restart(TracedModel& model) const {
  // A curve that was added has been started several times.
  if (model.added.back() == kFriction) return;
  const double enough = kAtFloor * problem_.ProjectedFloor(windows_);
  if (model.fit.rms <= enough) return;
  JointFit other = Minimise(problem_, FromStart(model.fit.best), windows_);
  if (other.rms < model.fit.rms) model.fit = std::move(other);
  if (model.fit.rms > enough && HasFreeFriction(model.fit.best))
    model.fit = MinimiseFriction(problem_, model.fit.best, windows_);
}

void Refits::Restart(std::vector<TracedModel>& models, bool lost) const {
  std::vector<TracedModel*> order = ByError(models);
  if (order.empty()) return;
  const double near = (lost ? kFarOff : 1) * order.front()->fit.rms;
  ParallelFor(static_cast<int>(order.size()), [&](int i) {
    if (i == 0 || (i < kCrossValidated && order[i]->fit.rms < near)) Restart(*order[i]);
  });
}

bool Refits::LeavesMuch(const JointFit& fit) const {
  return fit.rms >= kMuchLeft * problem_.ProjectedFloor(windows_);
}

bool Refits::IsLost(const JointFit& declared) const {
  if (!LeavesMuch(declared)) return false;
  for (size_t i = 0; i < declared.best.free.size(); ++i) {
    const std::string& path = declared.best.free[i].path;
    if (path == "command_shift" || path == "force_lag" || !declared.at_bound[i]) continue;
    // What the rig says is there has vanished.
    const int k = static_cast<int>(i);
    if (!IsAbsence(declared.best, k) || start_.x[k] != declared.best.x[k]) return true;
  }
  return false;
}

void Refits::CrossValidateBest(std::vector<TracedModel>& models) const {
  std::vector<TracedModel*> order = ByError(models);
  if (order.size() > kCrossValidated) order.resize(kCrossValidated);
  std::erase_if(order, [&](const TracedModel* model) {
    return model->fit.rms > kOutclassed * order.front()->fit.rms;
  });
  for (TracedModel* model : order) CrossValidate(*model);
}

void Refits::CrossValidate(TracedModel& model) const {
  model.cv = calibration::CrossValidate(problem_, model.fit, folds_);
}

TracedModel Refits::Without(const TracedModel& model, size_t index) {
  TracedModel result = model;
  result.added.erase(result.added.begin() + static_cast<int>(index));
  result.p_values.erase(result.p_values.begin() + static_cast<int>(index));
  result.cv_gains.erase(result.cv_gains.begin() + static_cast<int>(index));
  result.fit = MinimiseWithout(problem_, model.fit,
                               WithoutEffect(model.fit.best, model.added[index]), windows_);
  // The search came by here on another way, perhaps to a lesser minimum.
  const TracedModel* const known = Find(result.added);
  if (known != nullptr && known->fit.rms <= result.fit.rms) return *known;
  CrossValidate(result);
  if (known != nullptr) {
    result.added = known->added;
    result.p_values = known->p_values;
    result.cv_gains = known->cv_gains;
  }
  Keep(result);
  return result;
}

void Refits::Keep(TracedModel model) {
  std::string key = KeyOf(model.added);
  known_[std::move(key)] = std::move(model);
}

const TracedModel* Refits::Find(const std::vector<std::string>& added) const {
  const auto known = known_.find(KeyOf(added));
  return known == known_.end() ? nullptr : &known->second;
}

std::vector<TracedModel> Refits::Nearest(const std::vector<std::string>& added,
                                         size_t at_most) const {
  std::vector<TracedModel> nearest;
  for (const auto& [key, model] : known_)
    if (!model.added.empty() && key != KeyOf(added)) nearest.push_back(model);
  std::stable_sort(nearest.begin(), nearest.end(), [](const TracedModel& a, const TracedModel& b) {
    return a.cv.Rms() < b.cv.Rms();
  });
  if (nearest.size() > at_most) nearest.resize(at_most);
  return nearest;
}

const TracedModel* Refits::LowestWithOneEffect() const {
  const TracedModel* lowest = nullptr;
  for (const auto& [key, model] : known_)
    if (model.added.size() == 1 && (lowest == nullptr || model.fit.rms < lowest->fit.rms))
      lowest = &model;
  return lowest;
}

}  // namespace robostress::calibration
