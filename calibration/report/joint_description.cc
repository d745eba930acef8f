#include "calibration/report/joint_description.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "calibration/report/report_numbers.h"
#include "calibration/search/next_experiment.h"
#include "calibration/search/plausibility.h"
#include "calibration/search/residual_tests.h"
#include "calibration/search/verdict.h"

namespace robostress::calibration {
namespace {

constexpr double kStartsTold = 2.0;  // times the noise
constexpr double kExample = 4.0;     // [s] of a log that the report shows

const char* InputName(JointInput input) {
  switch (input) {
    case JointInput::kPositionTarget:
      return "position_target";
    case JointInput::kTorque:
      return "torque";
    case JointInput::kInverse:
      return "inverse";
    case JointInput::kTransmission:
      return "transmission";
  }
  return "";
}

// Unit of the report and how many of it one SI unit is.
std::pair<std::string, double> ReportUnit(const Metric& metric, JointInput input, bool hinge) {
  static const std::vector<std::pair<std::string, double>> known = {
      {"rad", 1}, {"mrad", 1e3}, {"deg", 180 / M_PI}, {"mdeg", 180e3 / M_PI},
      {"m", 1},   {"mm", 1e3},   {"um", 1e6},         {"Nm", 1},
      {"N", 1}};
  for (const auto& [unit, factor] : known)
    if (unit == metric.unit) return {unit, factor};
  if (input == JointInput::kInverse) return {hinge ? "Nm" : "N", 1};
  return {hinge ? "rad" : "m", 1};
}

class Description {
 public:
  Description(const JointCase& joint, const Finding& finding)
      : joint_(joint),
        finding_(finding),
        trace_(finding.trace),
        before_(Model(trace_.declared.fit.best)),
        after_(Model(trace_.after.fit.best)) {
    std::tie(unit_, factor_) =
        ReportUnit(joint.rig.metric, joint.declared().input, joint.plant.hinge(joint.index));
  }

  JointReport Tell() const {
    JointReport report;
    report.joint = joint_.declared().name;
    report.input = InputName(joint_.declared().input);
    report.unit = unit_;
    report.rounds = trace_.rounds;
    for (RoundReport& round : report.rounds) round.cv_error *= factor_;
    report.not_testable = trace_.not_testable;
    DescribeErrors(report);
    report.declared_parameters = Parameters(trace_.declared.fit, "");
    report.after_parameters = Parameters(trace_.after.fit, "");
    report.mimics_exposed = MimicsExposed(report);
    DescribeEffects(report);
    DescribeResidual(report);
    const Evidence evidence = EvidenceOf(report);
    const Judgement judgement = Judge(evidence);
    DescribeNoise(evidence, report);
    report.verdict = judgement.verdict;
    report.because = absl::StrCat(judgement.because, StartsOfRuns(report), LogProperties());
    report.excess_explained = judgement.excess_explained;
    if (judgement.verdict == Verdict::kDeclaredSufficient) return report;
    report.next_experiment.text = BeforeTheNext(evidence);
    if (report.next_experiment.text.empty()) DescribeNext(report);
    return report;
  }

 private:
  static JointModel Model(const Hypothesis& h) { return ModelAt(h, h.x); }

  void DescribeErrors(JointReport& report) const {
    report.mean_absolute = joint_.rig.metric.type == Metric::Type::kMeanAbsolute;
    report.fit = Errors(LogRole::kFit);
    report.held_out = SealedErrors();
    report.held_out_gates = report.held_out.present && !joint_.seals();
    report.transfer = Errors(LogRole::kTransfer);
    if (joint_.metric.own())
      report.left_out = {factor_ * finding_.left_out_declared, factor_ * finding_.left_out_after,
                         factor_ * joint_.metric.Floor(LogRole::kFit), true};
    report.cross_validated = {factor_ * trace_.declared.cv.Rms(), factor_ * trace_.after.cv.Rms(),
                              factor_ * joint_.problem.ProjectedFloor(joint_.Fit()), true};
    report.full_run = FullRun();
  }

  ErrorReport Errors(LogRole role) const {
    if (!joint_.metric.Has(role)) return {};
    return {factor_ * joint_.metric.Error(before_, role),
            factor_ * joint_.metric.Error(after_, role), factor_ * joint_.metric.Floor(role), true};
  }
  ErrorReport SealedErrors() const {
    if (!joint_.metric.Has(LogRole::kHeldOut)) return {};
    const WindowSet sealed = joint_.Sealed();
    return {factor_ * joint_.metric.Error(before_, sealed),
            factor_ * joint_.metric.Error(after_, sealed), factor_ * joint_.metric.Floor(sealed),
            true};
  }
  // What errors are told of: nothing that decided, where there is such.
  WindowSet Told() const {
    return joint_.metric.Has(LogRole::kHeldOut) ? joint_.Sealed() : joint_.Fit();
  }
  ErrorReport FullRun() const {
    if (joint_.declared().input == JointInput::kInverse ||
        joint_.declared().input == JointInput::kTransmission)
      return {};
    const JointProblem whole(joint_.declared().name, joint_.problem.tracks(), 0);
    WindowSet windows = whole.OfRole(LogRole::kHeldOut);
    if (whole.Rows(windows) == 0) windows = whole.OfRole(LogRole::kFit);
    return {factor_ * whole.Rms(before_, windows), factor_ * whole.Rms(after_, windows), 0, true};
  }

  // Free parameters whose path begins with `prefix`, without it.
  std::vector<ParameterReport> Parameters(const JointFit& fit, const std::string& prefix) const {
    const std::vector<double> std = StandardDeviations(joint_.problem, fit, joint_.Fit());
    std::vector<ParameterReport> parameters;
    for (size_t i = 0; i < fit.best.free.size(); ++i) {
      const FreeParameter& free = fit.best.free[i];
      if (!absl::StartsWith(free.path, prefix)) continue;
      parameters.push_back({free.path.substr(prefix.size()), UnitOf(free.path),
                            free.ToValue(fit.best.x[static_cast<int>(i)]), std[i],
                            fit.at_bound[i] != 0});
    }
    return parameters;
  }
  std::string UnitOf(const std::string& path) const {
    std::string unit;
    for (const EffectInfo& effect : EffectLibrary())
      for (const EffectParameter& parameter : effect.parameters)
        if (path == effect.type + "." + parameter.name) unit = parameter.unit;
    static const std::vector<std::pair<std::string, std::string>> model = {
        {"armature", "kg m^2"},    {"mass_scale", "1"},    {"damping", "Nm s/rad"},
        {"frictionloss", "Nm"},    {"servo.kp", "Nm/rad"}, {"servo.kd", "Nm s/rad"},
        {"torque_offset", "Nm"},   {"torque_gain", "1"},   {"position_offset", "rad"},
        {"command_shift", "rows"}, {"force_lag", "s"}};
    for (const auto& [name, its_unit] : model)
      if (path == name) unit = its_unit;
    return OfJoint(unit);
  }
  // The unit of a hinge, or what stands for it on a slide.
  std::string OfJoint(const std::string& unit) const {
    if (joint_.plant.hinge(joint_.index)) return unit;
    return absl::StrReplaceAll(unit, {{"kg m^2", "kg"}, {"Nm", "N"}, {"rad", "m"}});
  }

  // Declared parameters that fell by half or more, beyond their own uncertainty, when an effect
  // came in.
  std::vector<std::string> MimicsExposed(const JointReport& report) const {
    std::vector<std::string> exposed;
    if (trace_.after.added.empty()) return exposed;
    for (const ParameterReport& before : report.declared_parameters) {
      if (before.name != "torque_offset" && before.name != "position_offset") continue;
      for (const ParameterReport& later : report.after_parameters) {
        if (later.name != before.name || std::abs(before.value) < 3 * before.std ||
            std::abs(later.value) > 0.5 * std::abs(before.value))
          continue;
        exposed.push_back(absl::StrFormat("%s falls from %s to %s %s: it stood in for %s",
                                          before.name, ValueText(before.value, before.std),
                                          ValueText(later.value, later.std), before.unit,
                                          trace_.after.added.front()));
      }
    }
    return exposed;
  }

  void DescribeEffects(JointReport& report) const {
    const Hypothesis& later = trace_.after.fit.best;
    for (size_t i = 0; i < trace_.after.added.size(); ++i) {
      const std::string& type = trace_.after.added[i];
      AddedEffectReport effect;
      effect.type = type;
      effect.parameters = Parameters(trace_.after.fit, type + ".");
      JointFit without = MinimiseWithout(joint_.problem, trace_.after.fit,
                                         WithoutEffect(later, type), joint_.Fit());
      joint_.metric.Refit(without);
      effect.held_out_error_before = factor_ * joint_.metric.Error(Model(without.best), Told());
      effect.held_out_error_after = factor_ * joint_.metric.Error(after_, Told());
      effect.p_value = trace_.after.p_values[i];
      effect.cv_gain = trace_.after.cv_gains[i];
      effect.ambiguous_with = trace_.rivals[i];
      if (!effect.ambiguous_with.empty()) {
        std::vector<std::string> group = {type};
        group.insert(group.end(), effect.ambiguous_with.begin(), effect.ambiguous_with.end());
        report.groups.push_back(std::move(group));
        effect.separating_experiment = (*FindEffect(type))->separated_by;
      }
      report.effects.push_back(std::move(effect));
    }
  }

  void DescribeResidual(JointReport& report) const {
    const WindowSet windows = joint_.Unseen();
    report.residual_declared = Whiteness(before_, windows);
    report.residual_after = Whiteness(after_, windows);
    report.structure = MeasureStructure(joint_.problem, before_, after_, windows, factor_);
    for (StructureCurve& curve : report.structure) curve.unit = OfJoint(curve.unit);
    NameStrongest(report.structure, false, report.residual_declared);
    NameStrongest(report.structure, true, report.residual_after);
    report.examples.push_back(Example());
  }
  WhitenessReport Whiteness(const JointModel& model, const WindowSet& windows) const {
    return TestWhiteness(joint_.problem, joint_.problem.Projected(model, windows), windows);
  }
  static void NameStrongest(const std::vector<StructureCurve>& curves, bool after,
                            WhitenessReport& report) {
    double most = 0;
    for (const StructureCurve& curve : curves) {
      const double share = after ? curve.explained_after : curve.explained_declared;
      if (share <= std::max(most, curve.limit) || curve.limit == 0) continue;
      most = share;
      report.strongest = absl::StrFormat("%s holds %.0f %% of the variance%s", curve.against,
                                         100 * share, WhereItIs(curve, after));
    }
    if (most == 0)
      report.strongest = report.white ? "nothing"
                                      : "correlated in time, with none of position, "
                                        "velocity, load and time";
  }

  // The stretch where the declared model is worst.
  ExampleReport Example() const {
    const WindowSet windows = joint_.Unseen();
    size_t track = 0;
    for (size_t i = 0; i < windows.size(); ++i)
      if (windows[i]) track = joint_.problem.windows()[i].track;
    const MeasuredLog& log = *joint_.problem.tracks()[track].log;
    const std::vector<double> before = joint_.problem.TrackResidual(before_, track);
    const std::vector<double> later = joint_.problem.TrackResidual(after_, track);
    const int rows = std::min(log.rows, static_cast<int>(kExample / log.dt));
    int worst = 0;
    double energy = 0, most = -1;
    for (int i = 0; i < log.rows; ++i) {
      energy += before[i] * before[i] - (i >= rows ? before[i - rows] * before[i - rows] : 0);
      if (i >= rows - 1 && energy > most) most = energy, worst = i - rows + 1;
    }
    ExampleReport example;
    example.log = log.file;
    const std::vector<double>& measured =
        joint_.problem.tracks()[track].measured(joint_.declared().input);
    const int step = std::max(1, rows / 800);
    for (int i = worst; i < worst + rows; i += step) {
      example.t.push_back(i * log.dt);
      example.measured.push_back(factor_ * measured[i]);
      example.declared.push_back(factor_ * (measured[i] + before[i]));
      example.after.push_back(factor_ * (measured[i] + later[i]));
    }
    return example;
  }

  // Free runs start from a smoothed reading. Where that says little the error that is reported is
  // mostly of the starts.
  static std::string StartsOfRuns(const JointReport& report) {
    const ErrorReport& error = report.held_out.present ? report.held_out : report.fit;
    const double times = error.after / std::max(error.noise_floor, 1e-300);
    if (times < kStartsTold || report.times_noise.after > 0.5 * times) return "";
    return absl::StrFormat(
        "; the reported error is %.1f times its noise, because the readings do not "
        "say well at which speed a free run starts: without that it is %.2f times",
        times, report.times_noise.after);
  }

  // What the recorder did to the logs, so that nobody takes it for the joint's.
  std::string LogProperties() const {
    int lost = 0, rows = 0, steps = 0;
    bool drawn = false;
    double jitter = 0, timing = 0;
    for (const JointTrack& track : joint_.problem.tracks()) {
      lost += track.log->lost_rows, rows += track.log->rows;
      jitter = std::max(jitter, track.log->clock_jitter);
      timing = std::max(timing, track.record().timing_noise);
      steps = std::max(steps, track.record().step_rows);
      drawn |= track.record().drawn;
    }
    std::vector<std::string> found;
    if (lost > 0) found.push_back(absl::StrFormat("%d of %d rows are missing", lost, rows));
    if (jitter > 0)
      found.push_back(absl::StrFormat("their clock jitters by %.0f %% of a row", 100 * jitter));
    if (timing > 0)
      found.push_back(absl::StrFormat("rows were read %.2g ms off their times", 1e3 * timing));
    if (steps > 0)
      found.push_back(absl::StrFormat(
          "the command steps every %d rows and was logged as lines between", steps));
    if (drawn) found.push_back("they were resampled by lines");
    return found.empty() ? "" : absl::StrCat("; of the logs: ", absl::StrJoin(found, ", "));
  }

  static void DescribeNoise(const Evidence& evidence, JointReport& report) {
    const auto times = [](double error, double floor) { return floor > 0 ? error / floor : 0; };
    report.times_noise.declared = times(evidence.declared, evidence.floor);
    report.times_noise.bulk = times(evidence.declared_bulk, evidence.floor);
    report.times_noise.after = times(evidence.after, evidence.floor);
    for (const Evidence::Regime& regime : evidence.regimes) {
      double& worst = report.times_noise.worst_log;
      worst = std::max(worst, times(regime.declared, regime.floor));
      double& bulk = report.times_noise.worst_log_bulk;
      bulk = std::max(bulk, times(regime.bulk, regime.floor));
    }
  }

  Evidence EvidenceOf(const JointReport& report) const {
    Evidence evidence;
    const WindowSet unseen = joint_.Unseen(), transfer = joint_.problem.OfRole(LogRole::kTransfer);
    evidence.declared = joint_.ProjectedRms(before_, unseen);
    evidence.declared_bulk = joint_.ProjectedBulk(before_, unseen);
    evidence.after = joint_.ProjectedRms(after_, unseen);
    evidence.after_bulk = joint_.ProjectedBulk(after_, unseen);
    evidence.after_is_white = report.residual_after.white;
    evidence.floor = joint_.problem.ProjectedFloor(unseen);
    evidence.pushed = !joint_.plant.single();
    evidence.inverse = joint_.declared().input == JointInput::kInverse;
    evidence.transfer_declared = joint_.ProjectedRms(before_, transfer);
    evidence.transfer_after = joint_.ProjectedRms(after_, transfer);
    evidence.effects = static_cast<int>(trace_.after.added.size());
    evidence.doubts = Doubts();
    for (const LogRole role : {LogRole::kFit, LogRole::kHeldOut, LogRole::kTransfer})
      AddRegimes(role, evidence);
    evidence.ambiguous = !report.groups.empty();
    evidence.searched = !trace_.rounds.empty();
    if (evidence.searched)
      for (const CandidateReport& line : trace_.rounds.front().candidates)
        evidence.significant |= line.p_value <= 0.01;
    for (const char fits : joint_.Fit()) evidence.windows += fits;
    return evidence;
  }

  std::vector<std::string> Doubts() const {
    std::vector<std::string> doubts;
    const JointFit& fit = trace_.after.fit;
    const std::vector<double> std = StandardDeviations(joint_.problem, fit, joint_.Fit());
    for (const std::string& added : trace_.after.added)
      if (std::string doubt = ParameterDoubt(fit, std, added); !doubt.empty())
        doubts.push_back(std::move(doubt));
    if (std::string doubt = PhysicalDoubt(joint_.problem, fit, std);
        !trace_.after.added.empty() && !doubt.empty())
      doubts.push_back(std::move(doubt));
    return doubts;
  }

  // What to change before another motion is worth it; empty: nothing.
  std::string BeforeTheNext(const Evidence& evidence) const {
    if (evidence.windows < kMinWindows) {
      const double longest = LongestFreeRun();
      return longest > 0 ? absl::StrFormat(
                               "set metric.window_s to at most %g, or record longer logs", longest)
                         : "record longer logs";
    }
    if (evidence.searched) return "";
    return finding_.max_effects == 0 ? "run without --max-effects 0: nothing was searched"
                                     : "fit more of what the worst log holds: what was fitted is "
                                       "noise, so nothing was searched";
  }

  // [s] of which the fitted logs hold kMinWindows; 0: none, or their length is not the rig's to
  // say.
  double LongestFreeRun() const {
    if (joint_.declared().input == JointInput::kInverse ||
        joint_.declared().input == JointInput::kTransmission)
      return 0;
    std::vector<double> logs;  // [s]
    for (const JointTrack& track : joint_.problem.tracks())
      if (track.log->role == LogRole::kFit) logs.push_back(track.log->rows * track.log->dt);
    double longest = 0;
    for (const double log : logs) {
      for (int parts = 1; parts <= kMinWindows; ++parts) {
        const double run = log / parts;
        double runs = 0;
        for (const double other : logs) runs += std::floor(other / run + 1e-9);
        if (runs >= kMinWindows) longest = std::max(longest, run);
      }
    }
    return std::floor(longest * 100) / 100;
  }

  // What would tell what was added from its rivals, or else from what came nearest.
  void DescribeNext(JointReport& report) const {
    std::vector<JointModel> models = {after_};
    std::vector<std::string> others;
    for (const TracedModel& other : trace_.alternatives) {
      std::string name = NameOf(other.added);
      if (name == NameOf(trace_.after.added)) continue;
      models.push_back(Model(other.fit.best));
      others.push_back(std::move(name));
    }
    const NextExperiment next = ProposeExperiment(joint_.problem, models);
    if (next.what.empty() && next.sensor.what.empty()) {
      report.next_experiment.text = "more of what moves the joint: nothing came near what is left";
      return;
    }
    const auto factor = [&](bool torque) { return torque ? 1 : factor_; };
    const auto unit = [&](bool torque) { return torque ? OfJoint("Nm") : unit_; };
    const double apart = factor(next.torque) * next.apart, now = factor(next.torque) * next.now;
    report.next_experiment = {.text = "",
                              .unit = unit(next.torque),
                              .apart = apart,
                              .now = now,
                              .log = next.log,
                              .change = {{"speed", next.speed},
                                         {"size", next.size},
                                         {"servo_gain", next.gain},
                                         {"load", next.load},
                                         {"mass_kg", next.mass}},
                              .sensor = next.sensor.what};
    std::string& text = report.next_experiment.text;
    text = absl::StrFormat("to tell %s from %s", NameOf(trace_.after.added),
                           absl::StrJoin(others, ", "));
    if (!next.what.empty())
      absl::StrAppendFormat(
          &text, ", record %s: there they are %.3g %s apart or more, in the log as it is %.3g",
          next.what, apart, unit(next.torque), now);
    if (!next.sensor.what.empty()) {
      absl::StrAppendFormat(
          &text, "%s read %s as well: in the log as it is they are %.3g %s apart there",
          next.what.empty() ? "," : "; or", next.sensor.what,
          factor(next.sensor.torque) * next.sensor.apart, unit(next.sensor.torque));
      return;
    }
    if (next.apart < next.noise)
      absl::StrAppendFormat(&text, "; that is less than the noise, %.3g, and takes another sensor",
                            factor(next.torque) * next.noise);
  }
  static std::string NameOf(std::vector<std::string> added) {
    std::sort(added.begin(), added.end());
    return added.empty() ? "the declared model" : absl::StrJoin(added, "+");
  }

  // One per log.
  void AddRegimes(LogRole role, Evidence& evidence) const {
    const WindowSet of_role = joint_.problem.OfRole(role);
    for (size_t track = 0; track < joint_.problem.tracks().size(); ++track) {
      WindowSet own = of_role;
      for (size_t i = 0; i < own.size(); ++i) own[i] &= joint_.problem.windows()[i].track == track;
      if (joint_.problem.Rows(own) == 0) continue;
      evidence.regimes.push_back(
          {joint_.problem.tracks()[track].log->file, joint_.ProjectedRms(before_, own),
           joint_.ProjectedBulk(before_, own), joint_.problem.ProjectedFloor(own)});
    }
  }

  const JointCase& joint_;
  const Finding& finding_;
  const Trace& trace_;
  const JointModel before_, after_;
  std::string unit_;
  double factor_ = 1;
};

}  // namespace

JointReport DescribeJoint(const JointCase& joint, const Finding& finding) {
  return Description(joint, finding).Tell();
}

}  // namespace robostress::calibration
