#include "calibration/search/joint_search.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kMinHeldOut = 0.25;  // of the held-out energy above the floor
constexpr double kCostless = 0.02;    // of an error: less is no cost
constexpr double kClear = 1.5;        // times the floor: what is less is not looked at by itself

class Search {
 public:
  Search(const JointCase& joint, const SignalScales& scales, Hypothesis start, Hypothesis declared,
         const TraceOptions& options)
      : joint_(joint),
        scales_(scales),
        start_(std::move(start)),
        declared_(std::move(declared)),
        options_(options) {
    for (int i = 0; i < static_cast<int>(joint.rig.joints.size()); ++i)
      if (i != joint.index) others_.push_back(i);
  }

  Finding Run(const std::vector<std::string>& leads) const {
    Finding finding;
    Trace& trace = finding.trace;
    trace = TraceWith(options_);
    PreferLeads(leads, trace);
    if (trace.before_detour && ErrorOf(*trace.before_detour, joint_.Unseen()) <
                                   (1 + kCostless) * ErrorOf(trace.after, joint_.Unseen())) {
      options_.progress("held-out runs do no better after a detour: without it");
      TraceOptions options = options_;
      options.detours = false;
      trace = TraceWith(options);
    }
    DropUntilItHelps(trace);
    DropCostless(trace);
    joint_.metric.Refit(trace.declared.fit);
    joint_.metric.Refit(trace.after.fit);
    if (joint_.metric.own()) TrimByMetric(finding);
    return finding;
  }

 private:
  Trace TraceWith(const TraceOptions& options) const {
    return TraceJoint(joint_.problem, start_, declared_, scales_, others_, joint_.rig.folds,
                      options);
  }

  void PreferLeads(const std::vector<std::string>& leads, Trace& trace) const {
    const auto led = [&](const std::string& type) {
      return std::find(leads.begin(), leads.end(), type) != leads.end();
    };
    for (size_t i = 0; i < trace.after.added.size(); ++i) {
      const std::string found = trace.after.added[i];
      const std::vector<std::string>& rivals = trace.rivals[i];
      if (led(found) || std::none_of(rivals.begin(), rivals.end(), led)) continue;
      TraceOptions options = options_;
      options.exclude.push_back(found);
      Trace other = TraceWith(options);
      for (size_t k = 0; k < other.after.added.size(); ++k) {
        if (!led(other.after.added[k])) continue;
        other.rivals[k].push_back(found);
        trace = std::move(other);
        return;
      }
    }
  }

  // What was added may follow the fit logs' own noise. Of held-out logs the declared model must
  // leave more than noise, and the added effects explain part of that; or of the free runs that are
  // not far off, where those by themselves clearly hold more than noise.
  bool HelpsOnHeldOut(const Trace& trace) const {
    if (!HasHeldOut() || trace.after.added.empty()) return true;
    const WindowSet held_out = joint_.Unseen();
    const Hypothesis &declared = trace.declared.fit.best, &after = trace.after.fit.best;
    const JointModel before = ModelAt(declared, declared.x), later = ModelAt(after, after.x);
    const double floor = joint_.problem.ProjectedFloor(held_out);
    const auto explained = [&](double rms_before, double rms_later) {
      const double left = rms_before * rms_before - floor * floor;
      return left > 0 && rms_later * rms_later - floor * floor < (1 - kMinHeldOut) * left;
    };
    if (explained(joint_.ProjectedRms(before, held_out), joint_.ProjectedRms(later, held_out)))
      return true;
    const double bulk = joint_.ProjectedBulk(before, held_out);
    return bulk > kClear * floor && explained(bulk, joint_.ProjectedBulk(later, held_out));
  }

  // One effect of several may follow the fit logs where the others do not: of all that may go the
  // one without which held-out runs are predicted best goes first.
  void DropUntilItHelps(Trace& trace) const {
    while (!HelpsOnHeldOut(trace)) {
      const size_t count = trace.after.added.size();
      if (count == 1) {
        trace.after = trace.declared;
        trace.rivals.clear();
        return;
      }
      std::vector<TracedModel> shorter;
      for (size_t i = 0; i < count; ++i) shorter.push_back(Without(trace.after, i));
      const auto least = std::min_element(
          shorter.begin(), shorter.end(), [&](const TracedModel& a, const TracedModel& b) {
            return ErrorOf(a, joint_.Unseen()) < ErrorOf(b, joint_.Unseen());
          });
      const auto index = least - shorter.begin();
      options_.progress(
          absl::StrCat(trace.after.added[static_cast<size_t>(index)],
                       " is dropped: with all that was added held-out runs do no better"));
      CrossValidateAgain(*least);
      trace.after = std::move(*least);
      trace.rivals.erase(trace.rivals.begin() + index);
    }
  }

  bool HasHeldOut() const {
    return joint_.problem.Rows(joint_.problem.OfRole(LogRole::kHeldOut)) > 0;
  }

  // Drops effects without which held-out runs are predicted to their noise, or they and whole runs
  // as well as with them: the last first, because it mattered least.
  void DropCostless(Trace& trace) const {
    if (!HasHeldOut()) return;
    const WindowSet held_out = joint_.Unseen();
    for (size_t i = trace.after.added.size(); i-- > 0 && trace.after.added.size() > 1;) {
      TracedModel shorter = Without(trace.after, i);
      if (ErrorOf(shorter, held_out) > joint_.problem.ProjectedFloor(held_out) &&
          IsBetter(trace.after, shorter))
        continue;
      options_.progress(
          absl::StrCat(trace.after.added[i], " is dropped: held-out runs do as well"));
      CrossValidateAgain(shorter);
      trace.after = std::move(shorter);
      trace.rivals.erase(trace.rivals.begin() + static_cast<std::ptrdiff_t>(i));
    }
  }

  // In held-out runs or in whole ones, by more than 2 %.
  bool IsBetter(const TracedModel& model, const TracedModel& other) const {
    const WindowSet held_out = joint_.Unseen();
    return ErrorOf(other, held_out) > (1 + kCostless) * ErrorOf(model, held_out) ||
           WholeRunError(other) > (1 + kCostless) * WholeRunError(model);
  }

  double ErrorOf(const TracedModel& model, const WindowSet& windows) const {
    return joint_.ProjectedRms(ModelAt(model.fit.best, model.fit.best.x), windows);
  }
  // Of the fitted logs; 0 of inputs that are no motion.
  double WholeRunError(const TracedModel& model) const {
    const JointInput input = joint_.declared().input;
    if (input == JointInput::kInverse || input == JointInput::kTransmission) return 0;
    const JointProblem whole(joint_.declared().name, joint_.problem.tracks(), 0);
    return whole.Rms(ModelAt(model.fit.best, model.fit.best.x), whole.OfRole(LogRole::kFit));
  }

  // The search compares models by projected free runs. By a metric of its own a rig may predict
  // left-out folds as well without the effect that matters least: then it is dropped.
  void TrimByMetric(Finding& finding) const {
    options_.progress("leaving folds out by the metric");
    const MetricFit& metric = joint_.metric;
    Trace& trace = finding.trace;
    finding.left_out_declared = metric.LeftOut(trace.declared.fit.best, joint_.rig.folds);
    finding.left_out_after = trace.after.added.empty()
                                 ? finding.left_out_declared
                                 : metric.LeftOut(trace.after.fit.best, joint_.rig.folds);
    while (trace.after.added.size() > 1) {
      TracedModel shorter = Without(trace.after, trace.after.added.size() - 1);
      CrossValidateAgain(shorter);
      joint_.metric.Refit(shorter.fit);
      const double left_out = metric.LeftOut(shorter.fit.best, joint_.rig.folds);
      if (left_out > finding.left_out_after) return;
      trace.after = std::move(shorter);
      trace.rivals.pop_back();
      finding.left_out_after = left_out;
    }
  }

  TracedModel Without(TracedModel model, size_t index) const {
    const auto at = static_cast<std::ptrdiff_t>(index);
    const Hypothesis less = WithoutEffect(model.fit.best, model.added[index]);
    model.added.erase(model.added.begin() + at);
    model.p_values.erase(model.p_values.begin() + at);
    model.cv_gains.erase(model.cv_gains.begin() + at);
    model.fit = MinimiseWithout(joint_.problem, model.fit, less, joint_.Fit());
    return model;
  }
  void CrossValidateAgain(TracedModel& model) const {
    model.cv =
        CrossValidate(joint_.problem, model.fit, MakeFolds(joint_.problem, joint_.rig.folds));
  }

  const JointCase& joint_;
  const SignalScales& scales_;
  const Hypothesis start_, declared_;
  const TraceOptions& options_;
  std::vector<int> others_;
};

}  // namespace

absl::StatusOr<Finding> SearchJoint(JointCase& joint, const std::vector<std::string>& leads,
                                    const TraceOptions& options) {
  const std::vector<JointTrack>& tracks = joint.problem.tracks();
  RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(joint.rig, joint.plant, joint.index));
  const SignalScales scales = MeasureScales(joint.declared(), tracks);
  RS_ASSIGN_OR_RETURN(Hypothesis start,
                      DeclaredHypothesis(joint.declared(), model, scales, MeanInertia(tracks)));
  joint.problem.LinearizeStarts(model);
  const JointFit fit = MinimiseFriction(joint.problem, start, joint.Fit());
  const Hypothesis declared = WithBetterCommands(joint.problem, fit, joint.Fit()).best;
  start.model.continuous_command = declared.model.continuous_command;
  joint.problem.LinearizeStarts(ModelAt(declared, declared.x));
  Finding finding = Search(joint, scales, start, declared, options).Run(leads);
  finding.max_effects = options.max_effects;
  return finding;
}

}  // namespace robostress::calibration
