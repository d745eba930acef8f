#include <cmath>

#include "calibration/search/calibration_report.h"
#include "nlohmann/json.hpp"

namespace robostress::calibration {
namespace {

using Json = nlohmann::ordered_json;

Json ErrorJson(const ErrorReport& error) {
  if (!error.present) return nullptr;
  return {{"declared", error.declared}, {"after", error.after}, {"noise_floor", error.noise_floor}};
}

Json ParametersJson(const std::vector<ParameterReport>& parameters) {
  Json list = Json::array();
  for (const ParameterReport& p : parameters)
    list.push_back({{"name", p.name},
                    {"value", p.value},
                    {"std", p.std},
                    {"unit", p.unit},
                    {"at_bound", p.at_bound}});
  return list;
}

Json EffectJson(const JointReport& joint, const AddedEffectReport& effect) {
  Json values = Json::object(), std = Json::object();
  for (const ParameterReport& p : effect.parameters) {
    values[p.name] = p.value;
    std[p.name] = p.std;
  }
  return {{"type", effect.type},
          {"joint", joint.joint},
          {"parameters", values},
          {"std", std},
          {"held_out_error_before", effect.held_out_error_before},
          {"held_out_error_after", effect.held_out_error_after},
          {"cv_gain", effect.cv_gain},
          {"p_value", effect.p_value},
          {"ambiguous_with", effect.ambiguous_with}};
}

Json WhitenessJson(const WhitenessReport& w) {
  return {{"white", w.white},
          {"strongest", w.strongest},
          {"autocorrelation", w.autocorrelation},
          {"limit", w.limit}};
}

Json RoundJson(const RoundReport& round) {
  Json candidates = Json::array();
  for (const CandidateReport& c : round.candidates)
    candidates.push_back({{"type", c.type},
                          {"surviving", c.surviving},
                          {"linear_gain", c.linear_gain},
                          {"p_value", c.p_value},
                          {"refitted", c.refitted},
                          {"cv_gain", c.cv_gain},
                          {"accepted", c.accepted},
                          {"reason", c.reason}});
  return {{"base", round.base},
          {"cv_error", round.cv_error},
          {"null_95", round.null_95},
          {"null_99", round.null_99},
          {"candidates", candidates}};
}

Json JointJson(const JointReport& joint) {
  Json effects = Json::array(), rounds = Json::array(), structure = Json::array();
  for (const AddedEffectReport& effect : joint.effects)
    effects.push_back(EffectJson(joint, effect));
  for (const RoundReport& round : joint.rounds) rounds.push_back(RoundJson(round));
  for (const StructureCurve& c : joint.structure)
    structure.push_back({{"against", c.against},
                         {"unit", c.unit},
                         {"x", c.x},
                         {"declared", c.declared},
                         {"after", c.after},
                         {"explained_declared", c.explained_declared},
                         {"explained_after", c.explained_after},
                         {"limit", c.limit}});
  Json not_testable = Json::array();
  for (const auto& [type, share] : joint.not_testable)
    not_testable.push_back({{"type", type}, {"surviving", share}});
  return {{"joint", joint.joint},
          {"input", joint.input},
          {"unit", joint.unit},
          {"verdict", VerdictName(joint.verdict)},
          {"because", joint.because},
          {"errors",
           {{"fit", ErrorJson(joint.fit)},
            {"cross_validated", ErrorJson(joint.cross_validated)},
            {"left_out", ErrorJson(joint.left_out)},
            {"held_out", ErrorJson(joint.held_out)},
            {"transfer", ErrorJson(joint.transfer)},
            {"full_run", ErrorJson(joint.full_run)}}},
          {"excess_explained", joint.excess_explained},
          {"times_noise",
           {{"declared", joint.times_noise.declared},
            {"bulk", joint.times_noise.bulk},
            {"after", joint.times_noise.after},
            {"worst_log", joint.times_noise.worst_log},
            {"worst_log_bulk", joint.times_noise.worst_log_bulk}}},
          {"held_out_gates", joint.held_out_gates},
          {"next_experiment",
           {{"text", joint.next_experiment.text},
            {"apart", joint.next_experiment.apart},
            {"now", joint.next_experiment.now},
            {"unit", joint.next_experiment.unit},
            {"log", joint.next_experiment.log},
            {"change", joint.next_experiment.change},
            {"sensor", joint.next_experiment.sensor}}},
          {"parameters_declared", ParametersJson(joint.declared_parameters)},
          {"parameters_after", ParametersJson(joint.after_parameters)},
          {"mimics_exposed", joint.mimics_exposed},
          {"effects_added", effects},
          {"groups", joint.groups},
          {"not_testable", not_testable},
          {"residual_declared", WhitenessJson(joint.residual_declared)},
          {"residual_after", WhitenessJson(joint.residual_after)},
          {"structure", structure},
          {"rounds", rounds}};
}

// Root mean square over joints of the error that a report is judged by.
Json TotalError(const CalibrationReport& report) {
  double declared = 0, after = 0, floor = 0, count = 0;
  bool held_out = true;
  for (const JointReport& joint : report.joints) held_out &= joint.held_out.present;
  for (const JointReport& joint : report.joints) {
    const ErrorReport& error = held_out ? joint.held_out : joint.fit;
    declared += error.declared * error.declared;
    after += error.after * error.after;
    floor += error.noise_floor * error.noise_floor;
    count += 1;
  }
  const auto mean = [&](double sum) { return count > 0 ? std::sqrt(sum / count) : 0; };
  const bool inverse = !report.joints.empty() && report.joints.front().input == "inverse";
  const bool absolute = !report.joints.empty() && report.joints.front().mean_absolute;
  const std::string unit = report.joints.empty() ? "" : report.joints.front().unit;
  return {
      {"metric", std::string(held_out ? "held_out_" : "fit_") +
                     (inverse ? "torque_" : "position_") + (absolute ? "mae_" : "rmse_") + unit},
      {"declared", mean(declared)},
      {"after", mean(after)},
      {"noise_floor", mean(floor)}};
}

}  // namespace

std::string ReportJson(const CalibrationReport& report) {
  Json added = Json::array(), groups = Json::array(), rejected = Json::array();
  Json joints = Json::array(), logs = Json::array();
  std::string experiment;
  bool white = true;
  std::string strongest;
  for (const JointReport& joint : report.joints) {
    joints.push_back(JointJson(joint));
    white &= joint.residual_after.white;
    if (!joint.residual_after.white && strongest.empty())
      strongest = joint.joint + ": " + joint.residual_after.strongest;
    for (const AddedEffectReport& effect : joint.effects) {
      added.push_back(EffectJson(joint, effect));
    }
    if (!joint.next_experiment.text.empty())
      absl::StrAppend(&experiment, experiment.empty() ? "" : "; ", joint.joint, ": ",
                      joint.next_experiment.text);
    for (const auto& group : joint.groups) groups.push_back(group);
    if (joint.rounds.empty()) continue;
    for (const CandidateReport& c : joint.rounds.front().candidates) {
      if (c.accepted) continue;
      rejected.push_back({{"type", c.type},
                          {"joint", joint.joint},
                          {"gain", c.refitted ? c.cv_gain : c.linear_gain},
                          {"p_value", c.p_value},
                          {"reason", c.reason}});
    }
  }
  for (const auto& log : report.logs)
    logs.push_back({{"file", log.file},
                    {"role", log.role},
                    {"condition", log.condition},
                    {"rows", log.rows},
                    {"duration_s", log.duration_s},
                    {"notes", log.notes}});
  Json facts = Json::array();
  for (const ModelFact& fact : report.model_facts)
    facts.push_back({{"part", fact.part},
                     {"what", fact.what},
                     {"value", fact.value},
                     {"source", FactSourceName(fact.source)},
                     {"remedy", fact.remedy}});
  const Json document = {
      {"rig", report.rig},
      {"verdict", VerdictName(report.verdict)},
      {"because", report.because},
      {"error", TotalError(report)},
      {"effects_added", added},
      {"groups", groups},
      {"separating_experiment", experiment},
      {"rejected", rejected},
      {"remaining", {{"white", white}, {"strongest", white ? "nothing" : strongest}}},
      {"n_surrogates", report.n_surrogates},
      {"model_out", report.model_out},
      {"scenario_out", report.scenario_out},
      {"evidence", report.evidence},
      {"rig_file", report.rig_file},
      {"model", report.model},
      {"model_table", facts},
      {"elapsed_s", report.elapsed_s},
      {"logs", logs},
      {"joints", joints}};
  return document.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace robostress::calibration
