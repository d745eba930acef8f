#include "eval/store/outcomes.h"

#include <algorithm>
#include <map>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/store/unit_files.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

constexpr int kHashDigits = 12;

std::string OptionsHash(const UnitConfig& config) {
  std::string options = DumpConfig(config.sim) + DumpConfig(*config.method);
  if (config.robot != UnitConfig().robot) options += DumpConfig(config.client);
  return Sha256Hex(options).substr(0, kHashDigits);
}

// [task] one character per episode.
absl::StatusOr<std::vector<std::string>> OutcomesByTask(const UnitResult& unit) {
  const UnitConfig& config = unit.config;
  std::vector<std::string> outcomes(config.tasks.size(), std::string(config.episodes, '?'));
  for (const EpisodeRow& row : unit.episodes) {
    const auto task = std::find(config.tasks.begin(), config.tasks.end(), row.task);
    if (task == config.tasks.end() || row.episode < 0 || row.episode >= config.episodes) {
      return absl::DataLossError(absl::StrCat(unit.id, ": task ", row.task, ", episode ",
                                              row.episode, " is not in its configuration"));
    }
    outcomes[task - config.tasks.begin()][row.episode] = row.success ? '1' : '0';
  }
  if (absl::StrContains(absl::StrJoin(outcomes, ""), '?'))
    return absl::DataLossError(absl::StrCat(unit.id, " lacks episodes of its configuration"));
  return outcomes;
}

// A unit's line -> the unit. Throws json::exception on a field that is missing or of another type.
absl::StatusOr<UnitResult> ParseUnit(const json& fields) {
  UnitResult unit;
  UnitConfig& config = unit.config;
  unit.id = fields.at("unit").get<std::string>();
  config.suite = fields.at("suite").get<std::string>();
  config.scenario = fields.at("scenario").get<std::string>();
  config.severity = fields.at("severity").get<int>();
  config.policy = fields.at("policy").get<std::string>();
  config.seed = fields.at("seed").get<int64_t>();
  config.first_initial_state = fields.at("first_initial_state").get<int>();
  config.tasks = fields.at("tasks").get<std::vector<int>>();
  if (!fields.value("noise_paired", true)) config.remote.dialect.name = "not recorded";
  RS_ASSIGN_OR_RETURN(config.method, MakeMethod(fields.at("method").get<std::string>()));
  if (const SuiteInfo* suite = FindSuite(config.suite)) config.robot = suite->robot;
  if (const std::string named = UnitId(config);
      named != unit.id && OlderUnitId(config) != unit.id) {
    return absl::DataLossError(
        absl::StrCat("field unit is '", unit.id, "', but its other fields are those of ", named));
  }
  const auto outcomes = fields.at("outcomes").get<std::vector<std::string>>();
  if (outcomes.size() != config.tasks.size() || outcomes.empty()) {
    return absl::DataLossError(absl::StrCat("field outcomes has ", outcomes.size(),
                                            " entries, must have one for each of ",
                                            config.tasks.size(), " tasks"));
  }
  unit.id = UnitId(config);
  config.policy = PolicyLabel(config.policy);
  config.episodes = static_cast<int>(outcomes[0].size());
  const int updates = fields.at("updates").get<int>();
  for (size_t t = 0; t < outcomes.size(); ++t) {
    if (outcomes[t].size() != outcomes[0].size() ||
        outcomes[t].find_first_not_of("01") != std::string::npos) {
      return absl::DataLossError(absl::StrCat("field outcomes holds '", outcomes[t], "', must be ",
                                              config.episodes, " of 0 and 1"));
    }
  }
  for (const PlannedEpisode& planned : PlanEpisodes(config)) {
    EpisodeRow row;
    row.task = planned.task;
    row.episode = planned.episode;
    row.initial_state = planned.initial_state;
    row.success = outcomes[unit.episodes.size() / config.episodes][planned.episode] == '1';
    row.updates = updates;
    unit.episodes.push_back(row);
  }
  unit.provenance = {{"model_hash", fields.at("model").get<std::string>()},
                     {"version", fields.at("version").get<std::string>()},
                     {"options", fields.at("options").get<std::string>()}};
  unit.machines = fields.at("machines").get<std::vector<std::string>>();
  return unit;
}

absl::StatusOr<UnitResult> ParseLine(const std::string& line) {
  const json fields = json::parse(line, nullptr, false);
  if (!fields.is_object()) return absl::DataLossError("not a JSON object");
  try {
    return ParseUnit(fields);
  } catch (const json::exception& error) {
    return absl::DataLossError(error.what());
  }
}

// Units by id, the line that each came from, and what is wrong.
class Reader {
 public:
  void Read(const std::string& file) {
    const absl::StatusOr<std::string> text = ReadFile(file);
    if (!text.ok()) {
      damage_.emplace_back(text.status().message());
      return;
    }
    int number = 0;
    for (absl::string_view line : absl::StrSplit(*text, '\n')) {
      ++number;
      if (!line.empty()) Add(absl::StrCat(file, ":", number), std::string(line));
    }
  }

  absl::StatusOr<RunData> Finish() {
    std::vector<ModelUse> models;
    for (const UnitResult& unit : run_.units)
      models.push_back({unit.config.policy, TextAt(unit.provenance, "model_hash"), unit.id});
    for (std::string& complaint : DifferentModels(models)) damage_.push_back(std::move(complaint));
    if (!damage_.empty()) return absl::DataLossError(absl::StrJoin(damage_, "\n"));
    SortUnits(run_.units);
    return std::move(run_);
  }

 private:
  struct Origin {
    std::string place, line;
  };

  void Add(const std::string& place, const std::string& line) {
    absl::StatusOr<UnitResult> unit = ParseLine(line);
    if (!unit.ok()) {
      damage_.push_back(absl::StrCat(place, ": ", unit.status().message(),
                                     "; write the file again with `robostress store outcomes`"));
      return;
    }
    const auto [known, fresh] = origins_.try_emplace(unit->id, Origin{place, line});
    if (fresh) {
      for (const std::string& machine : unit->machines) ++run_.machines[machine];
      run_.units.push_back(*std::move(unit));
    } else if (known->second.line != line) {
      damage_.push_back(absl::StrCat(unit->id, " stands in ", known->second.place, " and ", place,
                                     " and they differ; keep one of them"));
    }
  }

  RunData run_;
  std::map<std::string, Origin> origins_;
  std::vector<std::string> damage_;
};

// "NAME: a, b" where the units of a run have several values.
std::vector<std::string> SeveralVersions(const RunData& run) {
  std::map<std::string, int> versions;
  for (const UnitResult& unit : run.units) ++versions[TextAt(unit.provenance, "version")];
  if (versions.size() < 2) return {};
  std::vector<std::string> counted;
  for (const auto& [version, units] : versions)
    counted.push_back(absl::StrCat(version, " (", units, " units)"));
  return {absl::StrCat("Units of several versions: ", absl::StrJoin(counted, ", "), ".")};
}

}  // namespace

absl::StatusOr<std::string> OutcomesText(const RunData& run) {
  std::string text;
  for (const UnitResult& unit : run.units) {
    const UnitConfig& config = unit.config;
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> outcomes, OutcomesByTask(unit));
    ordered_json line = {{"unit", UnitId(config)},
                         {"suite", config.suite},
                         {"scenario", config.scenario},
                         {"severity", config.severity},
                         {"policy", config.policy},
                         {"method", config.method->method},
                         {"seed", config.seed},
                         {"first_initial_state", config.first_initial_state},
                         {"tasks", config.tasks},
                         {"outcomes", outcomes},
                         {"updates", unit.episodes.empty() ? 0 : unit.episodes.back().updates},
                         {"options", OptionsHash(config)},
                         {"model", TextAt(unit.provenance, "model_hash").substr(0, kHashDigits)},
                         {"version", TextAt(unit.provenance, "version")},
                         {"machines", unit.machines}};
    if (!PairsNoise(unit)) line["noise_paired"] = false;
    absl::StrAppend(&text, line.dump(), "\n");
  }
  return text;
}

absl::StatusOr<Outcomes> ReadOutcomes(const std::vector<std::string>& files) {
  Reader reader;
  for (const std::string& file : files) reader.Read(file);
  Outcomes outcomes;
  RS_ASSIGN_OR_RETURN(outcomes.run, reader.Finish());
  outcomes.notes = SeveralVersions(outcomes.run);
  if (const std::string mixed = MixedMachinesNote(outcomes.run); !mixed.empty())
    outcomes.notes.push_back(mixed + ".");
  if (std::string unpaired = UnpairedNoiseNote(outcomes.run); !unpaired.empty())
    outcomes.notes.push_back(std::move(unpaired));
  return outcomes;
}

std::vector<std::string> HoldAgainstPlan(const std::vector<PlannedUnit>& planned, RunData& run) {
  std::map<std::string, const UnitConfig*> plan;
  for (const PlannedUnit& unit : planned) plan[unit.id] = &unit.config;
  std::set<std::string> other_options, other_episodes;
  const auto covers_others = [&](const UnitResult& unit) {
    const auto found = plan.find(unit.id);
    if (found == plan.end()) return false;
    const UnitConfig &asked = *found->second, &had = unit.config;
    if (OptionsHash(asked) != TextAt(unit.provenance, "options"))
      other_options.insert(had.method->method);
    if (asked.tasks == had.tasks && asked.episodes == had.episodes &&
        asked.first_initial_state == had.first_initial_state)
      return false;
    other_episodes.insert(unit.id);
    return true;
  };
  run.units.erase(std::remove_if(run.units.begin(), run.units.end(), covers_others),
                  run.units.end());
  std::vector<std::string> notes;
  if (!other_options.empty()) {
    notes.push_back(absl::StrCat(
        "Options of simulator or method were not those that this version plans, in units of: ",
        absl::StrJoin(other_options, ", "), "."));
  }
  if (!other_episodes.empty()) {
    notes.push_back(absl::StrCat(other_episodes.size(),
                                 " units cover other episodes than planned and enter no number: ",
                                 absl::StrJoin(other_episodes, ", "), "."));
  }
  return notes;
}

}  // namespace robostress
