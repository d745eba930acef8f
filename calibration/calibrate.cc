#include "calibration/calibrate.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "calibration/aided_motion.h"
#include "calibration/local_polynomial.h"
#include "calibration/metric_fit.h"
#include "calibration/residual_tests.h"
#include "calibration/verdict.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr double kNoiseLeft = 1.5;  // times the floor
constexpr double kBlock = 0.5;      // [s] windows of inputs that are no motion
constexpr double kExample = 4.0;    // [s] of a log that the report shows

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

// One joint of a rig with all that its trace needs.
class JointCalibration {
 public:
  JointCalibration(const Rig& rig, const Plant& plant, const std::vector<MeasuredLog>& logs,
                   int joint, const TraceOptions& options)
      : rig_(rig),
        plant_(plant),
        joint_(rig.joints[joint]),
        index_(joint),
        options_(options),
        tracks_(MakeTracks(plant, logs, joint)),
        problem_(joint_.name, tracks_, WindowRows()),
        metric_(rig.metric, problem_, WindowRows()) {
    std::tie(unit_, factor_) = ReportUnit(rig.metric, joint_.input, plant.hinge(joint));
  }

  // `leads`: effects that were found on other joints. Where the data of this joint allow for one of
  // them as well as for what it found, it is taken: the same cause on several joints is likelier.
  absl::Status Run(const std::vector<std::string>& leads, JointReport& report, RigJoint& after) {
    RS_ASSIGN_OR_RETURN(const JointModel model, DeclaredModel(rig_, plant_, index_));
    const SignalScales scales = MeasureScales(joint_, tracks_);
    RS_ASSIGN_OR_RETURN(const Hypothesis start,
                        DeclaredHypothesis(joint_, model, scales, MeanInertia(tracks_)));
    problem_.LinearizeStarts(model);
    const Hypothesis declared =
        MinimiseFriction(problem_, start, problem_.OfRole(LogRole::kFit)).best;
    problem_.LinearizeStarts(ModelAt(declared, declared.x));
    std::vector<int> others;
    for (int i = 0; i < static_cast<int>(rig_.joints.size()); ++i)
      if (i != index_) others.push_back(i);
    Trace trace = TraceJoint(problem_, start, declared, scales, others, rig_.folds, options_);
    PreferLeads(leads, start, declared, scales, others, trace);
    if (DeclaredPredictsTheHeldOut(trace)) {
      trace.after = trace.declared;
      trace.rivals.clear();
    }
    FitMetric(trace.declared.fit);
    FitMetric(trace.after.fit);
    Describe(trace, report);
    Write(trace.after.fit.best, after);
    return absl::OkStatus();
  }

 private:
  int WindowRows() const {
    const bool motion =
        joint_.input == JointInput::kPositionTarget || joint_.input == JointInput::kTorque;
    return static_cast<int>(
        std::round((motion ? rig_.metric.window_s : kBlock) / tracks_.front().log->dt));
  }
  void Describe(const Trace& trace, JointReport& report) const {
    const Hypothesis& before = trace.declared.fit.best;
    const Hypothesis& later = trace.after.fit.best;
    const JointModel declared = ModelAt(before, before.x), after = ModelAt(later, later.x);
    report.joint = joint_.name;
    report.input = InputName(joint_.input);
    report.unit = unit_;
    report.rounds = trace.rounds;
    for (RoundReport& round : report.rounds) round.cv_error *= factor_;
    report.not_testable = trace.not_testable;
    report.mean_absolute = rig_.metric.type == Metric::Type::kMeanAbsolute;
    report.fit = Errors(declared, after, LogRole::kFit);
    report.left_out = LeftOut(before, later);
    report.held_out = Errors(declared, after, LogRole::kHeldOut);
    report.transfer = Errors(declared, after, LogRole::kTransfer);
    report.cross_validated = {factor_ * trace.declared.cv.Rms(), factor_ * trace.after.cv.Rms(),
                              factor_ * problem_.ProjectedFloor(Fit()), true};
    report.full_run = FullRun(declared, after);
    report.declared_parameters = Parameters(trace.declared.fit, "");
    report.after_parameters = Parameters(trace.after.fit, "");
    report.mimics_exposed = MimicsExposed(trace, report);
    DescribeEffects(trace, report);
    DescribeResidual(declared, after, report);
    const Judgement judgement = Judge(EvidenceOf(trace, declared, after, report));
    report.verdict = judgement.verdict;
    report.because = judgement.because;
    report.excess_explained = judgement.excess_explained;
  }

  WindowSet Fit() const { return problem_.OfRole(LogRole::kFit); }
  void PreferLeads(const std::vector<std::string>& leads, const Hypothesis& start,
                   const Hypothesis& declared, const SignalScales& scales,
                   const std::vector<int>& others, Trace& trace) const {
    const auto led = [&](const std::string& type) {
      return std::find(leads.begin(), leads.end(), type) != leads.end();
    };
    for (size_t i = 0; i < trace.after.added.size(); ++i) {
      const std::string found = trace.after.added[i];
      const std::vector<std::string>& rivals = trace.rivals[i];
      if (led(found) || std::none_of(rivals.begin(), rivals.end(), led)) continue;
      TraceOptions options = options_;
      options.exclude.push_back(found);
      Trace other = TraceJoint(problem_, start, declared, scales, others, rig_.folds, options);
      for (size_t k = 0; k < other.after.added.size(); ++k) {
        if (!led(other.after.added[k])) continue;
        other.rivals[k].push_back(found);
        trace = std::move(other);
        return;
      }
    }
  }

  // Held-out logs hold nothing but noise beside the declared model: what the search added follows
  // the fit logs' own noise.
  bool DeclaredPredictsTheHeldOut(const Trace& trace) const {
    const WindowSet held_out = problem_.OfRole(LogRole::kHeldOut);
    if (problem_.Rows(held_out) == 0) return false;
    const Hypothesis& declared = trace.declared.fit.best;
    return ProjectedRms(ModelAt(declared, declared.x), held_out) <
           problem_.ProjectedFloor(held_out);
  }

  double ProjectedRms(const JointModel& model, const WindowSet& windows) const {
    const Eigen::VectorXd r = problem_.Projected(model, windows);
    return r.size() > 0 ? std::sqrt(r.squaredNorm() / static_cast<double>(r.size())) : 0;
  }

  // Where more than noise is left, the parameters that are best for the metric, which is what
  // errors are reported of, differ from those that are best for projected free runs.
  void FitMetric(JointFit& fit) const {
    const double error = metric_.Error(ModelAt(fit.best, fit.best.x), LogRole::kFit);
    if (fit.rms < kNoiseLeft * problem_.ProjectedFloor(Fit()) ||
        error < kNoiseLeft * metric_.Floor(LogRole::kFit))
      return;
    fit.best = metric_.Best(fit.best);
  }

  // Held out where there is something held out, else fitted.
  WindowSet Unseen() const {
    WindowSet held_out = problem_.OfRole(LogRole::kHeldOut);
    return problem_.Rows(held_out) > 0 ? held_out : Fit();
  }

  LogRole UnseenRole() const {
    return metric_.Has(LogRole::kHeldOut) ? LogRole::kHeldOut : LogRole::kFit;
  }

  ErrorReport Errors(const JointModel& declared, const JointModel& after, LogRole role) const {
    if (!metric_.Has(role)) return {};
    return {factor_ * metric_.Error(declared, role), factor_ * metric_.Error(after, role),
            factor_ * metric_.Floor(role), true};
  }
  // Of a metric of its own, which cross-validation in the search does not follow.
  ErrorReport LeftOut(const Hypothesis& declared, const Hypothesis& after) const {
    if (!metric_.own()) return {};
    options_.progress("leaving folds out by the metric");
    return {factor_ * metric_.LeftOut(declared, rig_.folds),
            factor_ * metric_.LeftOut(after, rig_.folds), factor_ * metric_.Floor(LogRole::kFit),
            true};
  }
  ErrorReport FullRun(const JointModel& declared, const JointModel& after) const {
    if (joint_.input == JointInput::kInverse || joint_.input == JointInput::kTransmission)
      return {};
    const JointProblem whole(joint_.name, tracks_, 0);
    WindowSet windows = whole.OfRole(LogRole::kHeldOut);
    if (whole.Rows(windows) == 0) windows = whole.OfRole(LogRole::kFit);
    return {factor_ * whole.Rms(declared, windows), factor_ * whole.Rms(after, windows), 0, true};
  }

  // Free parameters whose path begins with `prefix`, without it.
  std::vector<ParameterReport> Parameters(const JointFit& fit, const std::string& prefix) const {
    const std::vector<double> std = StandardDeviations(problem_, fit, Fit());
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
    if (plant_.hinge(index_)) return unit;
    return absl::StrReplaceAll(unit, {{"kg m^2", "kg"}, {"Nm", "N"}, {"rad", "m"}});
  }

  // Declared parameters that fell by half or more, beyond their own uncertainty, when an effect
  // came in.
  std::vector<std::string> MimicsExposed(const Trace& trace, const JointReport& report) const {
    std::vector<std::string> exposed;
    if (trace.after.added.empty()) return exposed;
    for (const ParameterReport& before : report.declared_parameters) {
      if (before.name != "torque_offset" && before.name != "position_offset") continue;
      for (const ParameterReport& later : report.after_parameters) {
        if (later.name != before.name || std::abs(before.value) < 3 * before.std ||
            std::abs(later.value) > 0.5 * std::abs(before.value))
          continue;
        exposed.push_back(absl::StrFormat("%s falls from %.4g to %.4g %s: it stood in for %s",
                                          before.name, before.value, later.value, before.unit,
                                          trace.after.added.front()));
      }
    }
    return exposed;
  }

  void DescribeEffects(const Trace& trace, JointReport& report) const {
    const Hypothesis& later = trace.after.fit.best;
    for (size_t i = 0; i < trace.after.added.size(); ++i) {
      const std::string& type = trace.after.added[i];
      AddedEffectReport effect;
      effect.type = type;
      effect.parameters = Parameters(trace.after.fit, type + ".");
      JointFit without = Minimise(problem_, WithoutEffect(later, type), Fit());
      FitMetric(without);
      effect.held_out_error_before =
          factor_ * metric_.Error(ModelAt(without.best, without.best.x), UnseenRole());
      effect.held_out_error_after = factor_ * metric_.Error(ModelAt(later, later.x), UnseenRole());
      effect.p_value = trace.after.p_values[i];
      effect.cv_gain = trace.after.cv_gains[i];
      effect.ambiguous_with = trace.rivals[i];
      if (!effect.ambiguous_with.empty()) {
        std::vector<std::string> group = {type};
        group.insert(group.end(), effect.ambiguous_with.begin(), effect.ambiguous_with.end());
        report.groups.push_back(std::move(group));
        effect.separating_experiment = (*FindEffect(type))->separated_by;
      }
      report.effects.push_back(std::move(effect));
    }
  }

  void DescribeResidual(const JointModel& declared, const JointModel& after,
                        JointReport& report) const {
    const WindowSet windows = Unseen();
    report.residual_declared = Whiteness(declared, windows);
    report.residual_after = Whiteness(after, windows);
    report.structure = MeasureStructure(problem_, declared, after, windows, factor_);
    for (StructureCurve& curve : report.structure) curve.unit = OfJoint(curve.unit);
    NameStrongest(report.structure, false, report.residual_declared);
    NameStrongest(report.structure, true, report.residual_after);
    report.examples.push_back(Example(declared, after));
  }
  WhitenessReport Whiteness(const JointModel& model, const WindowSet& windows) const {
    return TestWhiteness(problem_, problem_.Projected(model, windows), windows);
  }
  static void NameStrongest(const std::vector<StructureCurve>& curves, bool after,
                            WhitenessReport& report) {
    double most = 0;
    for (const StructureCurve& curve : curves) {
      const double share = after ? curve.explained_after : curve.explained_declared;
      if (share <= std::max(most, curve.limit) || curve.limit == 0) continue;
      most = share;
      report.strongest =
          absl::StrFormat("%s holds %.0f %% of the variance", curve.against, 100 * share);
    }
    if (most == 0)
      report.strongest = report.white ? "nothing"
                                      : "correlated in time, with none of position, "
                                        "velocity, load and time";
  }

  // The stretch where the declared model is worst.
  ExampleReport Example(const JointModel& declared, const JointModel& after) const {
    const WindowSet windows = Unseen();
    size_t track = 0;
    for (size_t i = 0; i < windows.size(); ++i)
      if (windows[i]) track = problem_.windows()[i].track;
    const MeasuredLog& log = *tracks_[track].log;
    const std::vector<double> before = problem_.TrackResidual(declared, track);
    const std::vector<double> later = problem_.TrackResidual(after, track);
    const int rows = std::min(log.rows, static_cast<int>(kExample / log.dt));
    int worst = 0;
    double energy = 0, most = -1;
    for (int i = 0; i < log.rows; ++i) {
      energy += before[i] * before[i] - (i >= rows ? before[i - rows] * before[i - rows] : 0);
      if (i >= rows - 1 && energy > most) most = energy, worst = i - rows + 1;
    }
    ExampleReport example;
    example.log = log.file;
    const std::vector<double>& measured = tracks_[track].measured(joint_.input);
    const int step = std::max(1, rows / 800);
    for (int i = worst; i < worst + rows; i += step) {
      example.t.push_back(i * log.dt);
      example.measured.push_back(factor_ * measured[i]);
      example.declared.push_back(factor_ * (measured[i] + before[i]));
      example.after.push_back(factor_ * (measured[i] + later[i]));
    }
    return example;
  }

  Evidence EvidenceOf(const Trace& trace, const JointModel& declared, const JointModel& after,
                      const JointReport& report) const {
    Evidence evidence;
    const WindowSet unseen = Unseen(), transfer = problem_.OfRole(LogRole::kTransfer);
    evidence.declared = ProjectedRms(declared, unseen);
    evidence.after = ProjectedRms(after, unseen);
    evidence.floor = problem_.ProjectedFloor(unseen);
    evidence.inverse = joint_.input == JointInput::kInverse;
    evidence.declared_white = report.residual_declared.white;
    evidence.transfer_declared = ProjectedRms(declared, transfer);
    evidence.transfer_after = ProjectedRms(after, transfer);
    evidence.effects = static_cast<int>(trace.after.added.size());
    evidence.ambiguous = !report.groups.empty();
    for (const CandidateReport& line : trace.rounds.front().candidates)
      evidence.significant |= line.p_value <= 0.01;
    for (const char fits : Fit()) evidence.windows += fits;
    return evidence;
  }

  // The rig's joint with what was fitted and added.
  void Write(const Hypothesis& h, RigJoint& after) const {
    JointModel model = ModelAt(h, h.x);
    for (const FreeParameter& free : h.free) {
      const auto value = FindValue(model, free.path);
      if (value.ok() && free.path.find('.') == std::string::npos)
        after.parameters[free.path] = **value;
    }
    after.servo = model.servo;
    after.effects.clear();
    for (const EffectInstance& instance : model.effects) {
      DeclaredEffect effect;
      effect.type = instance.info->type;
      for (size_t i = 0; i < instance.values.size(); ++i)
        effect.parameters[instance.info->parameters[i].name] = instance.values[i];
      if (instance.partner >= 0) effect.partner = rig_.joints[instance.partner].name;
      after.effects.push_back(std::move(effect));
    }
  }

  const Rig& rig_;
  const Plant& plant_;
  const RigJoint& joint_;
  int index_;
  const TraceOptions& options_;
  std::vector<JointTrack> tracks_;
  JointProblem problem_;
  MetricFit metric_;
  std::string unit_;
  double factor_ = 1;
};

const char* RoleName(LogRole role) {
  return role == LogRole::kFit ? "fit" : role == LogRole::kHeldOut ? "held_out" : "transfer";
}

// Of input inverse a torque is compared: its noise is that of tau and of the acceleration.
void NoiseOfTorques(const Rig& rig, const Plant& plant, std::vector<MeasuredLog>& logs) {
  for (int joint = 0; joint < static_cast<int>(rig.joints.size()); ++joint) {
    if (rig.joints[joint].input != JointInput::kInverse) continue;
    for (MeasuredLog& log : logs) {
      JointRecord& record = log.joints[joint];
      const double inertia = plant.Rows(joint, log).front().inertia + plant.passive(joint).armature;
      record.noise = std::hypot(NoiseOfReading(record.tau), inertia * record.acceleration_noise);
    }
  }
}

// Equal delays are a property of what the joints share.
void CompareJoints(CalibrationReport& report) {
  std::vector<double> delays;
  for (const JointReport& joint : report.joints)
    for (const AddedEffectReport& effect : joint.effects)
      for (const ParameterReport& parameter : effect.parameters)
        if (parameter.name == "delay_s") delays.push_back(parameter.value);
  if (delays.size() < 2) return;
  const auto [low, high] = std::minmax_element(delays.begin(), delays.end());
  if (delays.size() == report.joints.size() && *high - *low < 0.2 * *high)
    report.evidence.push_back(
        absl::StrFormat("every joint has the same delay, %.2f to %.2f ms: a property of the "
                        "channel (bus, sampling), not of a joint",
                        *low * 1e3, *high * 1e3));
}

absl::Status CheckChosen(const Rig& rig, const std::vector<std::string>& chosen) {
  std::vector<std::string> names;
  for (const RigJoint& joint : rig.joints) names.push_back(joint.name);
  for (const std::string& name : chosen) {
    if (std::find(names.begin(), names.end(), name) == names.end())
      return absl::InvalidArgumentError(absl::StrCat("joints: the rig ", rig.file,
                                                     " has no joint '", name, "'; it has ",
                                                     absl::StrJoin(names, ", ")));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Calibration> Calibrate(const Rig& rig, const TraceOptions& options) {
  const auto begin = std::chrono::steady_clock::now();
  RS_RETURN_IF_ERROR(CheckChosen(rig, options.joints));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Plant> plant, Plant::Load(rig));
  std::vector<MeasuredLog> logs;
  for (const RigLog& log : rig.logs) {
    RS_ASSIGN_OR_RETURN(MeasuredLog read, ReadMeasuredLog(rig, log));
    logs.push_back(std::move(read));
  }
  NoiseOfTorques(rig, *plant, logs);
  if (!plant->single()) {
    options.progress("motions of the arm");
    RS_RETURN_IF_ERROR(AidArmMotions(rig, *plant, logs));
  }
  Calibration result;
  result.after = rig;
  CalibrationReport& report = result.report;
  report.rig = rig.name;
  report.rig_file = rig.file;
  report.model = rig.model;
  report.n_surrogates = options.surrogates;
  for (const MeasuredLog& log : logs)
    report.logs.push_back(
        {log.file, RoleName(log.role), log.condition, log.rows, log.rows * log.dt, log.notes});
  std::vector<std::string> leads;
  for (int i = 0; i < static_cast<int>(rig.joints.size()); ++i) {
    const auto& chosen = options.joints;
    if (!chosen.empty() &&
        std::find(chosen.begin(), chosen.end(), rig.joints[i].name) == chosen.end())
      continue;
    TraceOptions own = options;
    own.progress = [&](const std::string& text) {
      options.progress(absl::StrCat(rig.joints[i].name, ": ", text));
    };
    JointCalibration joint(rig, *plant, logs, i, own);
    JointReport joint_report;
    RS_RETURN_IF_ERROR(joint.Run(leads, joint_report, result.after.joints[i]));
    for (const AddedEffectReport& effect : joint_report.effects) leads.push_back(effect.type);
    report.joints.push_back(std::move(joint_report));
  }
  report.verdict = Combine(report.joints);
  for (const JointReport& joint : report.joints)
    report.because +=
        absl::StrCat(report.because.empty() ? "" : "; ", joint.joint, ": ", joint.because);
  CompareJoints(report);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
  report.elapsed_s = elapsed.count();
  return result;
}

}  // namespace robostress::calibration
