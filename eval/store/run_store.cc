#include "eval/store/run_store.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <set>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/store/run_directory.h"
#include "eval/store/unit_files.h"

namespace robostress {
namespace {

using nlohmann::json;

// Columns of the table, in this order; other fields of the records follow in alphabetical order.
const std::vector<std::string>& LeadingColumns() {
  static const auto& columns = *new std::vector<std::string>{
      "suite",   "scenario",      "severity", "policy", "method", "seed",   "task",
      "episode", "initial_state", "success",  "steps",  "chunks", "updates"};
  return columns;
}

template <class Names>
int IndexOf(const Names& names, const std::string& name) {
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

auto CanonicalKey(const UnitConfig& config) {
  static const auto& suites = *new std::vector<std::string>([] {
    std::vector<std::string> names;
    for (const SuiteInfo& suite : AllSuites()) names.push_back(suite.name);
    return names;
  }());
  static const auto& scenarios = *new std::vector<std::string>(ScenarioNames());  // then arms
  static const auto& methods = *new std::vector<std::string>(MethodNames());
  return std::tuple(IndexOf(suites, config.suite), config.suite,
                    IndexOf(scenarios, config.scenario), ScenarioLabel(config.scenario),
                    config.severity, config.policy, IndexOf(methods, config.method->method),
                    config.seed);
}

std::string CsvCell(const json& value) {
  if (value.is_null()) return "";
  if (value.is_boolean()) return value.get<bool>() ? "1" : "0";
  if (!value.is_string()) return value.dump();
  std::string text = value.get<std::string>();
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) absl::StrAppend(&quoted, c == '"' ? "\"\"" : std::string(1, c));
  return quoted + "\"";
}

// Seconds over all launches; lines that cannot be read are passed over.
double LaunchSeconds(const std::string& file) {
  double seconds = 0;
  const std::string text = ReadFile(file).value_or("");
  for (absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
    const json launch = json::parse(line, nullptr, false);
    if (launch.is_object() && launch.contains("wall_s") && launch["wall_s"].is_number())
      seconds += launch["wall_s"].get<double>();
  }
  return seconds;
}

}  // namespace

absl::StatusOr<RunData> LoadRun(const std::string& dir) {
  RunData run;
  run.dir = dir;
  RS_RETURN_IF_ERROR(CheckRunDirectories({dir}));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> folders, UnitFolders(dir));
  UnitTextReader texts;
  std::vector<std::string> damage;
  std::vector<ModelUse> models;
  std::set<std::string> present;
  for (const std::string& folder : folders) {
    UnitInspection inspection = InspectUnit(folder, texts);
    present.insert(inspection.unit.id);
    if (!inspection.finished) {
      run.unfinished.push_back(inspection.unit.id);
      continue;
    }
    damage.insert(damage.end(), inspection.damage.begin(), inspection.damage.end());
    UnitResult& unit = inspection.unit;
    unit.config.policy =
        PolicyLabel(unit.config.policy);  // one policy, however its path is spelled
    if (unit.provenance.is_object())
      models.push_back({unit.config.policy, TextAt(unit.provenance, "model_hash"), unit.id});
    for (const std::string& machine : unit.machines) ++run.machines[machine];
    run.units.push_back(std::move(unit));
  }
  for (std::string& complaint : DifferentModels(models)) damage.push_back(std::move(complaint));
  const absl::StatusOr<std::set<std::string>> planned = RunDirectory(dir).PlannedIds(present);
  if (planned.ok()) {
    std::set_difference(planned->begin(), planned->end(), present.begin(), present.end(),
                        std::back_inserter(run.unfinished));
    std::sort(run.unfinished.begin(), run.unfinished.end());
  } else {
    damage.emplace_back(planned.status().message());
  }
  if (!damage.empty()) return absl::DataLossError(absl::StrJoin(damage, "\n"));
  if (run.units.empty()) {
    return absl::NotFoundError(
        absl::StrCat(dir, " has no finished unit; run the sweep that made it again, it continues"));
  }
  SortUnits(run.units);
  if (const auto text = ReadFile(dir + "/environment.json"); text.ok())
    run.environment = json::parse(*text, nullptr, false);
  run.sweep_wall_s = LaunchSeconds(dir + "/launches.jsonl");
  return run;
}

void SortUnits(std::vector<UnitResult>& units) {
  std::stable_sort(units.begin(), units.end(), [](const UnitResult& a, const UnitResult& b) {
    return CanonicalKey(a.config) < CanonicalKey(b.config);
  });
}

bool PairsNoise(const UnitConfig& config) {
  return !config.remote.used() || config.remote.dialect.PairsNoise();
}

bool PairsNoise(const UnitResult& unit) {
  return PairsNoise(unit.config) && TextAt(unit.provenance, "noise_paired") != "false";
}

std::string UnpairedNoiseNote(const RunData& run) {
  std::set<std::string> policies;
  for (const UnitResult& unit : run.units)
    if (!PairsNoise(unit)) policies.insert(PolicyLabel(unit.config.policy));
  if (policies.empty()) return "";
  return absl::StrCat("Sampling noise not paired: the server of ", absl::StrJoin(policies, ", "),
                      " takes neither seed nor noise, so that pairs share their initial state "
                      "alone, and a pair may differ by chance where no method acts.");
}

std::string ClippedCommandsNote(const RunData& run) {
  constexpr double kNoticed = 0.25;  // the policies here: 0.002
  struct Sum {
    double clipped = 0;
    int episodes = 0;
  };
  std::map<std::string, Sum> policies;
  for (const UnitResult& unit : run.units) {
    if (unit.config.method->method != "base") continue;
    Sum& sum = policies[PolicyLabel(unit.config.policy)];
    for (const EpisodeRow& row : unit.episodes)
      if (row.clipped_share) sum.clipped += *row.clipped_share, ++sum.episodes;
  }
  std::vector<std::string> much;
  for (const auto& [policy, sum] : policies) {
    if (sum.clipped > kNoticed * sum.episodes)
      much.push_back(absl::StrFormat("%.0f %% of %s's", 100 * sum.clipped / sum.episodes, policy));
  }
  if (much.empty()) return "";
  return absl::StrCat("Clipped commands: ", absl::StrJoin(much, ", "),
                      " numbers lay outside -1 to 1. A policy's actions are scaled to that range "
                      "(1: 0.05 m or 0.5 rad in a control step); these have another unit.");
}

std::string LateAnswersNote(const RunData& run) {
  const auto doing = [](LateChunks mode) {
    switch (mode) {
      case LateChunks::kWaiting:
        return "the arm holds still meanwhile";
      case LateChunks::kSwitch:
        return "the arm plays on and enters a chunk at the row that is due";
      case LateChunks::kCrossfade:
        return "the arm plays on and fades over to the row that is due";
      case LateChunks::kRtc:
        return "the arm plays on and the chunk goes on from there (real-time chunking)";
    }
    return "";
  };
  std::set<std::string> kinds;
  for (const UnitResult& unit : run.units) {
    const LatencyOptions& latency = unit.config.latency;
    if (latency.late())
      kinds.insert(
          absl::StrCat(latency.ms, " ms after their observation, and ", doing(latency.mode)));
  }
  if (kinds.empty()) return "";
  return absl::StrCat("Answers come late in simulated time: ", absl::StrJoin(kinds, "; "), ".");
}

std::string MixedMachinesNote(const RunData& run) {
  if (run.machines.size() < 2) return "";
  std::vector<std::string> kinds;
  for (const auto& [kind, units] : run.machines)
    kinds.push_back(absl::StrCat(kind, " (", units, " units)"));
  return absl::StrCat(
      "This table mixes kinds of processors, whose floating-point kernels may differ in the last "
      "bits and so in outcomes: ",
      absl::StrJoin(kinds, "; "));
}

namespace {

// Rows of the table with `columns`; false when a record has a field that is none of them.
bool AppendRows(const RunData& run, const std::vector<std::string>& columns, std::string& csv) {
  const std::set<std::string> known(columns.begin(), columns.end());
  for (const UnitResult& unit : run.units) {
    for (const EpisodeRow& row : unit.episodes) {
      const json fields = json::parse(row.record, nullptr, false);
      for (const auto& [name, value] : fields.items()) {
        if (known.count(name) == 0) return false;
      }
      const char* separator = "";
      for (const std::string& name : columns) {
        const auto field = fields.find(name);
        absl::StrAppend(&csv, separator, field == fields.end() ? "" : CsvCell(*field));
        separator = ",";
      }
      csv += '\n';
    }
  }
  return true;
}

// Leading columns, then all other fields of the first `limit` records.
std::vector<std::string> Columns(const RunData& run, size_t limit) {
  std::set<std::string> others;
  size_t read = 0;
  for (const UnitResult& unit : run.units) {
    for (const EpisodeRow& row : unit.episodes) {
      if (read++ >= limit) break;
      const json fields = json::parse(row.record, nullptr, false);
      for (const auto& [name, value] : fields.items()) others.insert(name);
    }
  }
  std::vector<std::string> columns = LeadingColumns();
  for (const std::string& name : columns) others.erase(name);
  columns.insert(columns.end(), others.begin(), others.end());
  return columns;
}

}  // namespace

std::string EpisodeTableCsv(const RunData& run) {
  // Records nearly always have the same fields; only when they do not is each parsed twice.
  for (const size_t limit : {size_t{1}, std::numeric_limits<size_t>::max()}) {
    const std::vector<std::string> columns = Columns(run, limit);
    std::string csv = absl::StrJoin(columns, ",") + "\n";
    if (AppendRows(run, columns, csv)) return csv;
  }
  return "";
}

std::string UnitTimingCsv(const RunData& run) {
  std::string csv = "unit,episodes,wall_s,predict_s,step_s,observe_s,feedback_s\n";
  for (const UnitResult& unit : run.units) {
    const TimingSums& t = unit.timing;
    absl::StrAppend(
        &csv, absl::StrFormat("%s,%d,%.3f,%.3f,%.3f,%.3f,%.3f\n", CsvCell(unit.id), t.episodes,
                              t.wall_s, t.predict_s, t.step_s, t.observe_s, t.feedback_s));
  }
  return csv;
}

}  // namespace robostress
