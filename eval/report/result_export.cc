#include "eval/report/result_export.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "eval/plan/plan.h"
#include "eval/store/played_alike.h"
#include "eval/store/served_policies.h"
#include "eval/store/unit_files.h"

namespace robostress {
namespace {

std::string RoleOf(const std::string& method) {
  if (method == "base") return "base";
  return method == "gain" || method == "null" ? "control" : "method";
}

int LevelOf(const std::string& scenario, int severity) {
  return SameAtEveryLevel(scenario) ? 0 : severity;
}

ResultDifference DifferenceOf(const Comparison& c) {
  ResultDifference d;
  d.pairs = c.pairs, d.plus = c.plus, d.minus = c.minus;
  d.clusters = c.difference.clusters;
  d.clustering = c.clustering;
  d.difference = c.difference.estimate;
  if (std::isfinite(c.difference.interval.low)) d.interval = c.difference.interval;
  d.p = c.p_value, d.p_exact = c.p_exact;
  if (std::isfinite(c.p_holm)) d.p_corrected = c.p_holm;
  d.design_effect = c.design_effect;
  return d;
}

void AddContrasts(const Contrasts& contrasts, ResultCell& cell) {
  if (contrasts.versus_base) cell.versus_base = DifferenceOf(*contrasts.versus_base);
  for (const auto& [control, comparison] : contrasts.versus_control)
    cell.versus_control[control] = DifferenceOf(comparison);
}

// What the units of a run say of themselves, each once.
class Declarations {
 public:
  explicit Declarations(const RunData& run) : run_(run) {
    for (const ServedPolicy& served : ServedPolicies(run)) served_.emplace(served.label, served);
    for (const UnitResult& unit : run.units) Add(unit);
  }

  absl::Status Fill(ResultFile& file) const {
    std::vector<std::string> unlike = UnlikeUnits(run_);
    unlike.insert(unlike.end(), unlike_.begin(), unlike_.end());
    if (!unlike.empty()) {
      return absl::FailedPreconditionError(absl::StrCat(
          "these units were not played alike, so that their table says nothing to others; export "
          "the runs one by one:\n  ",
          absl::StrJoin(unlike, "\n  ")));
    }
    for (const auto& [label, policy] : policies_) file.policies.push_back(policy);
    for (const auto& [key, hash] : scenarios_)
      file.scenarios.push_back({key.first, key.second, hash});
    for (const auto& [name, hash] : methods_)
      file.methods.push_back({name, RoleOf(name), Sha256Hex(hash)});
    for (const auto& [suite, options] : protocols_) file.protocols.push_back({suite, options});
    file.robostress.assign(versions_.begin(), versions_.end());
    return absl::OkStatus();
  }

 private:
  void Add(const UnitResult& unit) {
    const UnitConfig& config = unit.config;
    if (methods_.count(config.method->method) == 0)
      methods_.emplace(config.method->method, DumpConfig(*config.method));
    const UnitResult& first = *suites_.emplace(config.suite, &unit).first->second;
    const FlatOptions protocol = ProtocolOf(config);
    FlatOptions& said = protocols_.emplace(config.suite, protocol).first->second;
    // Of units that an earlier version began nobody noted what LIBERO's own tasks were.
    if (const auto tasks = protocol.find("libero_tasks"); tasks != protocol.end())
      said.insert(*tasks);
    // The file says once for a suite which episodes its results are of.
    if (first.config.tasks != config.tasks || first.config.episodes != config.episodes ||
        first.config.first_initial_state != config.first_initial_state) {
      unlike_.insert(absl::StrCat(
          "suite ", config.suite, ": ",
          FirstDifference(ProtocolOf(first.config), first.id, ProtocolOf(config), unit.id)));
    }
    const std::pair scenario(ScenarioLabel(config.scenario),
                             LevelOf(config.scenario, config.severity));
    if (scenarios_.count(scenario) == 0) scenarios_.emplace(scenario, ScenarioHash(config));
    policies_.emplace(PolicyLabel(config.policy), PolicyOf(unit));
    const std::string version = TextAt(unit.provenance, "version");
    versions_.insert(version.empty() ? "not recorded" : version);
  }

  ResultPolicy PolicyOf(const UnitResult& unit) const {
    ResultPolicy policy;
    policy.label = PolicyLabel(unit.config.policy);
    policy.model_hash = TextAt(unit.provenance, "model_hash");
    policy.noise_paired = PairsNoise(unit);
    const auto served = served_.find(policy.label);
    if (served == served_.end()) return policy;
    RemotePolicyOptions remote = unit.config.remote;
    remote.dialect.path = remote.dialect.path.substr(0, remote.dialect.path.find('?'));
    policy.options = FlatOptionsOf(DumpConfig(remote));
    ResultServer& server = policy.server.emplace();
    server.dialect = served->second.dialect;
    std::set<std::string> urls;
    for (const auto& [url, units] : served->second.urls)
      urls.insert(SharedUrl(url, remote.dialect.path));
    server.urls.assign(urls.begin(), urls.end());
    server.metadata_sha256.assign(served->second.metadata_sha256.begin(),
                                  served->second.metadata_sha256.end());
    server.metadata_changed = !served->second.changed.empty();
    server.reconnections = served->second.reconnections;
    return policy;
  }

  const RunData& run_;
  std::map<std::string, ServedPolicy> served_;
  std::map<std::string, ResultPolicy> policies_;
  std::map<std::pair<std::string, int>, std::string> scenarios_;
  std::map<std::string, std::string> methods_;
  std::map<std::string, FlatOptions> protocols_;
  std::map<std::string, const UnitResult*> suites_;  // the first of each
  std::set<std::string> versions_, unlike_;
};

// The cells of one table; a scenario that is equal at every level stands in several of them, and
// comes once.
void AddTable(const SuccessTable& table, const std::string& suite, std::set<std::string>& seen,
              ResultFile& file) {
  for (const ScenarioRow& row : table.rows) {
    const std::string& label = row.scenario;
    const int level = row.has_levels ? table.severity : 0;
    for (const std::string& method : table.methods) {
      const auto found = row.cells.find(method);
      if (found == row.cells.end() || found->second.n == 0) continue;
      if (!seen.insert(
                   absl::StrJoin({table.policy, suite, label, absl::StrCat(level), method}, "|"))
               .second)
        continue;
      ResultCell& cell = file.results.emplace_back();
      cell.policy = table.policy, cell.suite = suite, cell.scenario = label;
      cell.severity = level, cell.method = method;
      cell.counts = found->second.clustered;
      cell.rate = found->second.rate();
      cell.interval = RateInterval(cell.counts);
      cell.seeds = found->second.seeds.seeds;
      AddContrasts(found->second.contrasts, cell);
    }
  }
  for (const std::string& method : table.methods) {
    const auto found = table.averages.find(method);
    if (found == table.averages.end() || found->second.n == 0) continue;
    const AverageCell& average = found->second;
    ResultCell& cell = file.means.emplace_back();
    cell.policy = table.policy, cell.suite = suite, cell.method = method;
    cell.severity = table.severity;
    for (const ScenarioRow& row : table.rows) {
      if (row.scenario != "clean" && row.cells.count(method))
        cell.scenarios.push_back(row.scenario);
    }
    cell.counts.n = average.n, cell.counts.clusters = average.success.clusters;
    cell.clustering = average.clustering;
    cell.rate = average.success.estimate;
    // Where every outcome is the same the bootstrap knows no width.
    const Interval& interval = average.success.interval;
    if (std::isfinite(interval.low) && interval.low < interval.high) cell.interval = interval;
    cell.seeds = average.seeds.seeds;
    AddContrasts(average.contrasts, cell);
  }
}

}  // namespace

std::string SharedUrl(const std::string& url, const std::string& usual) {
  const size_t scheme = url.find("://");
  const std::string rest = scheme == std::string::npos ? url : url.substr(scheme + 3);
  const size_t path = std::min(rest.find('/'), rest.find('?'));
  const std::string authority = rest.substr(0, path);
  std::string target = path == std::string::npos ? "/" : rest.substr(path);
  target = target.substr(0, target.find('?'));
  const size_t colon = authority.rfind(':');
  const bool port = colon != std::string::npos && authority.find(']', colon) == std::string::npos;
  return absl::StrCat(scheme == std::string::npos ? "ws" : url.substr(0, scheme), "://HOST",
                      port ? authority.substr(colon) : "",
                      target.empty() || target == "/" ? "/"
                      : target == usual               ? target
                                                      : "/...");
}

absl::StatusOr<RunData> JoinRuns(const std::vector<std::string>& dirs) {
  if (dirs.empty()) return absl::InvalidArgumentError("nothing to export; give RUN_DIR");
  RunData all;
  std::map<std::string, std::string> places;
  std::vector<std::string> complaints;
  std::vector<ModelUse> models;
  for (const std::string& dir : dirs) {
    RS_ASSIGN_OR_RETURN(RunData run, LoadRun(dir));
    if (dirs.size() == 1) return run;
    for (UnitResult& unit : run.units) {
      const auto [place, fresh] = places.emplace(unit.id, dir);
      if (!fresh)
        complaints.push_back(absl::StrCat("unit ", unit.id, " stands in ", place->second, " and ",
                                          dir, "; leave one of the runs out"));
      if (unit.provenance.is_object())
        models.push_back(
            {PolicyLabel(unit.config.policy), TextAt(unit.provenance, "model_hash"), unit.id});
      all.units.push_back(std::move(unit));
    }
    all.unfinished.insert(all.unfinished.end(), run.unfinished.begin(), run.unfinished.end());
    for (const auto& [machine, units] : run.machines) all.machines[machine] += units;
    if (all.environment.is_null()) all.environment = run.environment;
  }
  for (std::string& complaint : DifferentModels(models)) complaints.push_back(std::move(complaint));
  if (!complaints.empty())
    return absl::FailedPreconditionError(
        absl::StrCat("the runs cannot be exported as one:\n  ", absl::StrJoin(complaints, "\n  ")));
  SortUnits(all.units);
  return all;
}

absl::StatusOr<ResultFile> ExportResults(const RunData& run, const Summary& summary) {
  ResultFile file;
  file.bootstrap_replicates = summary.replicates;
  RS_RETURN_IF_ERROR(Declarations(run).Fill(file));
  file.mujoco = TextAt(run.environment, "mujoco");
  std::set<std::string> seen;
  for (const SuccessTable& table : summary.tables) {
    std::set<std::string> suites;
    for (const UnitResult& unit : run.units) {
      if (PolicyLabel(unit.config.policy) == table.policy) suites.insert(unit.config.suite);
    }
    const std::string suite = !table.suite.empty() ? table.suite
                              : suites.size() == 1 ? *suites.begin()
                                                   : "all";
    AddTable(table, suite, seen, file);
  }
  for (const std::string& note : {MixedMachinesNote(run), UnpairedNoiseNote(run)})
    if (!note.empty()) file.notes.push_back(note);
  for (const ServedPolicy& served : ServedPolicies(run)) {
    if (!served.changed.empty())
      file.notes.push_back(absl::StrCat("The server of ", served.label,
                                        " changed its metadata while ", served.changed.size(),
                                        " units ran: their rows may be of two models."));
  }
  if (!run.unfinished.empty())
    file.notes.push_back(
        absl::StrCat(run.unfinished.size(), " planned units were not finished and are left out."));
  return file;
}

}  // namespace robostress
