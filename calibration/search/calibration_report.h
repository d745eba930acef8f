#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/models/model_table.h"

namespace robostress::calibration {

enum class Verdict {
  kAttributed,            // what was missing is named, and hardly anything remains
  kAmbiguous,             // one of a group that this data does not tell apart
  kReducedNotAttributed,  // added effects reduce the error, the mechanism is not established
  kUnattributed,          // structure that no candidate explains
  kDeclaredSufficient,    // nothing but noise is left of the declared model
  kNotTestable,           // this data can say neither
};
const char* VerdictName(Verdict verdict);

// A parameter of the declared model or of an effect.
struct ParameterReport {
  std::string name, unit;
  double value = 0, std = 0;  // std 0: not fitted
  bool at_bound = false;
};

// What was tried in a round and how it fared.
struct CandidateReport {
  std::string type;        // "a+b" for a pair
  double surviving = 0;    // share of its signature that the model so far cannot imitate
  double linear_gain = 0;  // share of the residual's energy that its signature explains
  double p_value = 1;      // of linear_gain, against the null distribution
  double cv_gain = 0;      // relative fall of the cross-validated error; 0 where not refitted
  bool refitted = false, accepted = false;
  std::string reason;  // why not, in words
};

// One step of the forward search: everything that was tried on top of `base`.
struct RoundReport {
  std::vector<std::string> base;    // effects already added
  double cv_error = 0;              // of the base, in the joint's unit
  double null_95 = 0, null_99 = 0;  // quantiles of the largest gain in the library under the null
  std::vector<CandidateReport> candidates;  // best first
};

struct AddedEffectReport {
  std::string type;
  std::vector<ParameterReport> parameters;
  double held_out_error_before = 0, held_out_error_after = 0;
  double cv_gain = 0, p_value = 1;
  std::vector<std::string> ambiguous_with;
  std::string separating_experiment;  // where ambiguous
};

// A residual against something: means over bins, declared model and model with what was added.
struct StructureCurve {
  std::string against, unit;  // position, velocity, load, time, frequency
  std::vector<double> x, declared, after;
  double explained_declared = 0, explained_after = 0;  // share of variance that the bin means hold
  double limit = 0;                                    // 99 % of that share for noise alone
};

// Autocorrelation and what the residual goes with.
struct WhitenessReport {
  bool white = false;
  double autocorrelation = 0;  // the largest of the first lags
  double limit = 0;            // 99 % for white noise
  std::string strongest;       // "velocity: 0.41 of the variance", for people
};

// A stretch of a log with both predictions.
struct ExampleReport {
  std::string log;
  std::vector<double> t, measured, declared, after;
};

// Errors by the rig's metric, over free runs (of input inverse and transmission: of all rows), in
// `unit`.
struct ErrorReport {
  double declared = 0, after = 0, noise_floor = 0;
  bool present = false;  // the rig has logs of this role
};

// The story of one joint.
struct JointReport {
  std::string joint, input, unit;
  Verdict verdict = Verdict::kNotTestable;
  std::string because;  // the verdict in one sentence
  // held_out: of the part of the held-out logs that decides nothing.
  ErrorReport fit, cross_validated, held_out, transfer, full_run;
  bool held_out_gates = false;  // those logs are too short for that: all of them decide
  ErrorReport left_out;         // each fold by what is best for the others; of a metric of its own
  bool mean_absolute = false;   // fit, held_out, transfer and left_out; else RMS
  // Projected residuals over the noise of the readings, of the logs that decide; bulk: without the
  // tenth of the free runs that is farthest off; the worst log of all.
  struct TimesNoise {
    double declared = 0, bulk = 0, after = 0, worst_log = 0, worst_log_bulk = 0;
  } times_noise;
  double excess_explained = 0;  // share of the declared model's excess over noise, held out
  std::vector<ParameterReport> declared_parameters, after_parameters;
  std::vector<std::string> mimics_exposed;  // declared parameters that stood in for an added effect
  std::vector<RoundReport> rounds;
  std::vector<AddedEffectReport> effects;
  std::vector<std::vector<std::string>> groups;
  std::vector<std::pair<std::string, double>> not_testable;  // type, surviving share
  WhitenessReport residual_declared, residual_after;
  std::vector<StructureCurve> structure;
  std::vector<ExampleReport> examples;
  // What to do next (next_experiment.h), in a sentence; empty of a model that is sufficient. The
  // figures are in `unit`, or of torque. `change`: of the run that is made of `log`.
  struct Experiment {
    std::string text, unit;
    double apart = 0, now = 0;
    std::string log;
    std::map<std::string, double> change;
    std::string sensor;
  } next_experiment;
};

// What `robostress calibrate` found out.
struct CalibrationReport {
  std::string rig, rig_file, model;
  Verdict verdict = Verdict::kNotTestable;
  std::string because;
  std::vector<JointReport> joints;
  struct Log {
    std::string file, role, condition;
    int rows = 0;
    double duration_s = 0;
    std::vector<std::string> notes;  // what the reader found and did
  };
  std::vector<Log> logs;
  std::vector<ModelFact> model_facts;  // of the whole model and of the joints traced
  std::vector<std::string> evidence;   // across joints: "the same delay on all axes: a channel"
  int n_surrogates = 0;                // 0: nothing was searched
  double elapsed_s = 0;
  std::string model_out;     // rig_after.yaml, empty where nothing was added
  std::string scenario_out;  // scenario.yaml, empty without --map
};

// The design's schema; everything above stands under "joints".
std::string ReportJson(const CalibrationReport& report);

// One self-contained page: the story in order, with pictures.
std::string ReportHtml(const CalibrationReport& report);

}  // namespace robostress::calibration
