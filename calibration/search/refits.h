#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calibration/search/contenders.h"
#include "calibration/search/traced_model.h"

namespace robostress::calibration {

// Fits and cross-validates the models that a search tries, and keeps those that it has seen. Not
// thread-safe; it uses several threads itself.
class Refits {
 public:
  // At most 120 windows of the fit logs are simulated, evenly chosen. `start`: the declared model
  // before it was fitted. `problem` outlives this.
  Refits(const JointProblem& problem, const Hypothesis& start, Folds folds);

  const JointProblem& problem() const { return problem_; }
  const WindowSet& windows() const { return windows_; }

  // Fitted and cross-validated.
  TracedModel Declared(const Hypothesis& declared) const;
  // `base` with a candidate, after the first iterations of its fit.
  TracedModel OnTrial(const TracedModel& base, const Screening& screening,
                      const Contender& contender) const;
  // Goes on with the fits that may come near the lowest of them, or near `error`; a start that was
  // far off is no more worth than that. `promised` [models]: the RMS that screening expects.
  void SettleBest(std::vector<TracedModel>& models, const std::vector<double>& promised,
                  double error) const;
  // Fits the lowest again with its declared parameters from where they first began, and from other
  // Stribeck curves: while an effect was missing they may have stood in for it. `lost`: so much so
  // that all that are near the lowest are fitted again.
  void Restart(std::vector<TracedModel>& models, bool lost) const;
  // The same of one, whatever its error.
  void Restart(TracedModel& model) const;
  // The rig's own values, not fitted.
  JointFit OwnValues() const { return Minimise(problem_, start_, windows_, 0); }
  // More than a few times the noise.
  bool LeavesMuch(const JointFit& fit) const;
  // Whether the fit of a declared model has run onto bounds with much left: something else is
  // missing, and its parameters are no place to begin from.
  bool IsLost(const JointFit& declared) const;
  // The few with the lowest errors that are near the lowest.
  void CrossValidateBest(std::vector<TracedModel>& models) const;
  void CrossValidate(TracedModel& model) const;
  // `model` without its effect `index`, fitted again.
  TracedModel Without(const TracedModel& model, size_t index);

  void Keep(TracedModel model);
  // Of the models with one effect that were kept, the one with the lowest error; null: none.
  const TracedModel* LowestWithOneEffect() const;
  // Of the models with effects that were kept, those but `added` with the lowest errors.
  std::vector<TracedModel> Nearest(const std::vector<std::string>& added, size_t at_most) const;
  // Null if no model with these effects, in any order, was kept.
  const TracedModel* Find(const std::vector<std::string>& added) const;

 private:
  Hypothesis FromStart(Hypothesis h) const;

  const JointProblem& problem_;
  const Hypothesis start_;
  const WindowSet windows_;
  std::vector<WindowSet> folds_;
  std::map<std::string, TracedModel> known_;  // by its effects, sorted
};

}  // namespace robostress::calibration
