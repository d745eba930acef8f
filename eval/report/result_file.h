#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/statistics.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/unpaired_rates.h"

// A run's results for other laboratories: what a reader needs to judge and compare them, and
// nothing of the machine that made them. Schema: eval/docs/result.schema.json. Rates, intervals and
// differences are fractions, not percent.
namespace robostress {

inline constexpr char kResultSchema[] = "robostress-result";
inline constexpr int kResultSchemaVersion = 1;

// A method minus a reference on the same episodes, or on episodes of equal initial states.
struct ResultDifference {
  int pairs = 0, plus = 0, minus = 0;  // plus: only the method succeeded
  int clusters = 0;
  Clustering clustering = Clustering::kInitialState;
  double difference = 0;
  std::optional<Interval> interval;   // paired cluster bootstrap; absent: one cluster
  double p = 1;                       // sign flips of whole clusters
  bool p_exact = true;                // enumerated, not drawn
  std::optional<double> p_corrected;  // Holm, over the run's table
  double design_effect = 1;
};

// One method in one scenario, or its mean over several.
struct ResultCell {
  std::string policy, suite, method;  // suite "all": those of the run together
  std::string scenario;               // empty: the mean over `scenarios`, equal weights
  std::vector<std::string> scenarios;
  int severity = 0;                  // 1..5; 0: the scenario is equal at every level
  ClusteredRate counts;              // of a mean: n and clusters alone
  double rate = 0;                   // of a mean: the mean of rates
  std::optional<Interval> interval;  // RateInterval; of a mean a cluster bootstrap
  Clustering clustering = Clustering::kInitialState;  // of a mean
  std::vector<int64_t> seeds;  // of the sampling noise; repeats where it is not paired
  std::optional<ResultDifference> versus_base;
  std::map<std::string, ResultDifference> versus_control;  // "gain", "null"

  bool is_mean() const { return scenario.empty(); }
};

// A policy of somebody else's server.
struct ResultServer {
  std::string dialect;
  std::vector<std::string> urls;  // "ws://HOST:8000/": without host, query and unusual path
  std::vector<std::string> metadata_sha256;  // of what the servers said of themselves
  bool metadata_changed = false;             // while a unit ran: rows may be of two models
  int reconnections = 0;
};

struct ResultPolicy {
  std::string label;         // the user's
  std::string model_hash;    // of its weights; of a served policy of label and metadata; or empty
  bool noise_paired = true;  // equal episodes of two methods had equal sampling noise
  std::optional<ResultServer> server;
  std::map<std::string, std::string> options;  // remote.*, how a served one was asked
};

struct ResultScenario {
  std::string name;
  int severity = 0;    // 0: equal at every level
  std::string sha256;  // of its parameters; empty: they are part of the program
};

struct ResultMethod {
  std::string name, role;  // base, control, method
  std::string sha256;      // of its options
};

// How a suite was played: every option of its units that decides an outcome, beside policy,
// scenario, method and seed.
struct ResultProtocol {
  std::string suite;
  std::map<std::string, std::string> options;  // "sim.stepping" -> "fast"
};

struct ResultFile {
  std::vector<std::string> robostress;  // versions of the workers
  std::string mujoco;                   // empty: not recorded
  int bootstrap_replicates = 0;
  std::vector<ResultPolicy> policies;
  std::vector<ResultScenario> scenarios;
  std::vector<ResultMethod> methods;
  std::vector<ResultProtocol> protocols;
  std::vector<ResultCell> results, means;
  std::vector<std::string> notes;
};

// JSON, two spaces, a line feed at the end; the same bytes for the same run.
std::string WriteResultFile(const ResultFile& file);
// INVALID_ARGUMENT lists what is wrong, each with `source`, field, value and limit: another schema
// or version, missing and unknown fields, values that contradict one another (successes above n, an
// interval that is not that of its counts), cells that stand twice or name what is not declared.
absl::StatusOr<ResultFile> ParseResultFile(const std::string& source, const std::string& text);
// The same of a file of at most 64 MiB.
absl::StatusOr<ResultFile> ReadResultFile(const std::string& path);

}  // namespace robostress
