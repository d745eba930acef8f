#include "calibration/search/joint_search.h"

#include <algorithm>

#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kMinHeldOut = 0.25;  // of the held-out energy above the floor
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
    if (!HelpsOnHeldOut(trace)) {
      trace.after = trace.declared;
      trace.rivals.clear();
    }
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
    const WindowSet held_out = joint_.problem.OfRole(LogRole::kHeldOut);
    if (joint_.problem.Rows(held_out) == 0 || trace.after.added.empty()) return true;
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
      TracedModel shorter = WithoutLast(trace.after);
      const double left_out = metric.LeftOut(shorter.fit.best, joint_.rig.folds);
      if (left_out > finding.left_out_after) return;
      trace.after = std::move(shorter);
      trace.rivals.pop_back();
      finding.left_out_after = left_out;
    }
  }

  TracedModel WithoutLast(TracedModel model) const {
    const Hypothesis less = WithoutEffect(model.fit.best, model.added.back());
    model.added.pop_back();
    model.p_values.pop_back();
    model.cv_gains.pop_back();
    model.fit = Minimise(joint_.problem, less, joint_.Fit());
    model.cv =
        CrossValidate(joint_.problem, model.fit, MakeFolds(joint_.problem, joint_.rig.folds));
    joint_.metric.Refit(model.fit);
    return model;
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
  RS_ASSIGN_OR_RETURN(const Hypothesis start,
                      DeclaredHypothesis(joint.declared(), model, scales, MeanInertia(tracks)));
  joint.problem.LinearizeStarts(model);
  const Hypothesis declared = MinimiseFriction(joint.problem, start, joint.Fit()).best;
  joint.problem.LinearizeStarts(ModelAt(declared, declared.x));
  return Search(joint, scales, start, declared, options).Run(leads);
}

}  // namespace robostress::calibration
