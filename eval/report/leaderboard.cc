#include "eval/report/leaderboard.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/methods.h"
#include "common/joint_errors/scenarios.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::ordered_json;

constexpr const char* kKeys[] = {"model",  "weight_type", "curated_by",    "display_name",
                                 "params", "model_paper", "reported_paper"};
constexpr const char* kFullSuites[] = {"libero_spatial", "libero_object", "libero_goal",
                                       "libero_10"};

absl::Status Refuse(const std::string& key, const std::string& value, const std::string& wanted) {
  return absl::InvalidArgumentError(
      absl::StrCat("--leaderboard ", key, "=", value, ": must be ", wanted));
}

// "@handle": what the schema's pattern takes for a person.
bool IsHandle(const std::string& text) {
  return text.size() > 1 && text[0] == '@' && std::all_of(text.begin() + 1, text.end(), [](char c) {
           return absl::ascii_isalnum(c) || c == '-' || c == '_';
         });
}

double InPercent(double fraction) { return std::round(1000 * fraction) / 10; }

std::string PercentInterval(const std::optional<Interval>& interval) {
  return interval ? absl::StrFormat("[%.1f, %.1f]", 100 * interval->low, 100 * interval->high)
                  : "[no interval]";
}

// Those that the paper's tables average.
std::set<std::string> Deployment() {
  std::set<std::string> names;
  for (const std::string& name : ScenarioNames()) {
    const absl::StatusOr<Scenario> scenario = MakeScenario(name, 5);
    if (scenario.ok() && scenario->deployment) names.insert(name);
  }
  return names;
}

// Whether the method was played in every suite under each of these scenarios at L5.
bool Everywhere(const ResultFile& file, const std::string& method,
                const std::set<std::string>& scenarios) {
  size_t found = 0;
  for (const ResultCell& cell : file.results)
    found += cell.suite != "all" && cell.method == method && cell.severity == 5 &&
             scenarios.count(cell.scenario);
  return found == file.protocols.size() * scenarios.size();
}

// LIBERO's four suites, all ten tasks of each, no server that may have become another model.
bool WholeProtocol(const ResultFile& file) {
  for (const char* suite : kFullSuites) {
    const auto protocol = std::find_if(file.protocols.begin(), file.protocols.end(),
                                       [&](const ResultProtocol& p) { return p.suite == suite; });
    if (protocol == file.protocols.end()) return false;
    const auto tasks = protocol->options.find("tasks");
    const auto episodes = protocol->options.find("episodes");
    int count = 0;
    if (tasks == protocol->options.end() || episodes == protocol->options.end() ||
        std::count(tasks->second.begin(), tasks->second.end(), ',') != 9 ||
        !absl::SimpleAtoi(episodes->second, &count) || count < 20)
      return false;
  }
  const auto& server = file.policies.front().server;
  return file.protocols.size() == 4 && !(server && server->metadata_changed);
}

std::string Notes(const ResultFile& file, const ResultCell* mean,
                  const std::vector<const ResultCell*>& cells) {
  std::vector<std::string> said;
  std::vector<std::string> suites;
  for (const ResultProtocol& protocol : file.protocols) suites.push_back(protocol.suite);
  said.push_back(absl::StrCat("Joint-level execution errors by RoboStress ",
                              absl::StrJoin(file.robostress, ", "),
                              file.mujoco.empty() ? "" : absl::StrCat(", MuJoCo ", file.mujoco),
                              ", suites ", absl::StrJoin(suites, ", ")));
  std::vector<std::string> rates;
  for (const ResultCell* cell : cells)
    rates.push_back(absl::StrCat(cell->scenario, " ", PercentInterval(cell->interval),
                                 " n = ", cell->counts.n));
  said.push_back(absl::StrCat("95 % intervals: ", absl::StrJoin(rates, ", ")));
  if (mean != nullptr) {
    said.push_back(absl::StrCat("mean over ", absl::StrJoin(mean->scenarios, ", "), " ",
                                PercentInterval(mean->interval)));
    const auto against = [&](const std::string& reference, const ResultDifference& d) {
      said.push_back(absl::StrFormat(
          "against %s on the same initial states %+.1f points %s, p %.3g", reference,
          100 * d.difference, PercentInterval(d.interval), d.p_corrected.value_or(d.p)));
    };
    if (mean->versus_base) against("base", *mean->versus_base);
    for (const auto& [control, d] : mean->versus_control) against(control + " control", d);
  }
  if (!file.policies.front().noise_paired) said.push_back("sampling noise not paired");
  said.insert(said.end(), file.notes.begin(), file.notes.end());
  return absl::StrJoin(said, "; ");
}

}  // namespace

absl::StatusOr<LeaderboardEntry> ParseLeaderboardEntry(
    const std::vector<std::string>& assignments) {
  std::map<std::string, std::string> given;
  const std::string known = absl::StrJoin(kKeys, ", ");
  for (const std::string& assignment : assignments) {
    const std::pair<std::string, std::string> parts =
        absl::StrSplit(assignment, absl::MaxSplits('=', 1));
    const auto& [key, value] = parts;
    if (std::find(std::begin(kKeys), std::end(kKeys), key) == std::end(kKeys) || value.empty())
      return absl::InvalidArgumentError(
          absl::StrCat("--leaderboard ", assignment, ": must be KEY=VALUE; known keys: ", known));
    if (!given.emplace(key, value).second)
      return absl::InvalidArgumentError(
          absl::StrCat("--leaderboard ", key, " is given twice; remove one"));
  }
  for (const char* key : {"model", "weight_type", "curated_by"}) {
    if (given.count(key) == 0)
      return absl::InvalidArgumentError(
          absl::StrCat("--export-leaderboard needs --leaderboard ", key,
                       "=VALUE, which a run does not know; known keys: ", known));
  }
  LeaderboardEntry entry;
  entry.model = given["model"];
  entry.weight_type = given["weight_type"];
  entry.curated_by = given["curated_by"];
  entry.display_name = given["display_name"];
  for (const auto& [key, field] :
       {std::pair("params", &entry.params), std::pair("model_paper", &entry.model_paper),
        std::pair("reported_paper", &entry.reported_paper)})
    if (given.count(key)) *field = given[key];
  if (entry.weight_type != "shared" && entry.weight_type != "finetuned")
    return Refuse("weight_type", entry.weight_type,
                  "shared (one checkpoint for all benchmarks) or finetuned (trained on this one's "
                  "data)");
  if (!IsHandle(entry.curated_by)) return Refuse("curated_by", entry.curated_by, "@HANDLE");
  for (const auto& [key, field] : {std::pair("model_paper", &entry.model_paper),
                                   std::pair("reported_paper", &entry.reported_paper)})
    if (*field && (*field)->rfind("https://", 0) != 0)
      return Refuse(key, **field, "an address that begins with https://");
  return entry;
}

absl::StatusOr<std::string> LeaderboardJson(const ResultFile& file, const LeaderboardEntry& entry,
                                            const std::string& date) {
  if (file.policies.size() != 1) {
    std::vector<std::string> labels;
    for (const ResultPolicy& policy : file.policies) labels.push_back(policy.label);
    return absl::FailedPreconditionError(
        absl::StrCat("a leaderboard entry is of one policy, the runs have ", labels.size(), " (",
                     absl::StrJoin(labels, ", "), "); export runs of one policy"));
  }
  const bool several = file.protocols.size() > 1, whole = WholeProtocol(file);
  const auto here = [&](const ResultCell& cell) { return (cell.suite == "all") == several; };
  std::set<int> levels;
  for (const ResultCell& cell : file.results)
    if (here(cell) && cell.severity != 0) levels.insert(cell.severity);
  if (levels.empty()) levels.insert(0);
  const std::set<std::string> deployment = Deployment();
  std::map<std::string, ordered_json> entries;  // sorted by model, as vla-eval wants them
  for (const int level : levels) {
    for (const ResultMethod& method : file.methods) {
      std::vector<const ResultCell*> cells;
      ordered_json scores = ordered_json::object();
      for (const ResultCell& cell : file.results) {
        if (!here(cell) || cell.method != method.name ||
            (cell.severity != 0 && cell.severity != level))
          continue;
        cells.push_back(&cell);
        scores[cell.scenario] = InPercent(cell.rate);
      }
      if (cells.empty()) continue;
      const ResultCell* mean = nullptr;
      for (const ResultCell& cell : file.means)
        if (here(cell) && cell.method == method.name && cell.severity == level) mean = &cell;
      const std::string label =
          entry.display_name.empty() ? file.policies.front().label : entry.display_name;
      const bool standard = whole && level == 5 && mean != nullptr &&
                            mean->scenarios.size() == deployment.size() &&
                            Everywhere(file, method.name, deployment);
      const std::string key =
          absl::StrCat(entry.model, method.name == "base" ? "" : absl::StrCat("-", method.name),
                       level == 5 || level == 0 ? "" : absl::StrCat("-L", level));
      ordered_json out = {{"model", key}};
      out["display_name"] =
          absl::StrCat(label, method.name == "base" ? "" : ", " + MethodTitle(method.name),
                       level == 5 || level == 0 ? "" : absl::StrCat(", severity L", level));
      out["name_in_paper"] = nullptr;
      out["benchmark"] = "robostress";
      out["overall_score"] = standard ? ordered_json(InPercent(mean->rate)) : ordered_json(nullptr);
      out["suite_scores"] = scores;
      out["task_scores"] = ordered_json::object();
      if (!standard && mean != nullptr) out["task_scores"]["reported_avg"] = InPercent(mean->rate);
      out["reported_paper"] =
          entry.reported_paper ? ordered_json(*entry.reported_paper) : ordered_json(nullptr);
      out["reported_table"] = nullptr;
      out["curated_by"] = entry.curated_by;
      out["notes"] = Notes(file, mean, cells);
      out["date_added"] = date;
      out["params"] = entry.params ? ordered_json(*entry.params) : ordered_json(nullptr);
      out["model_paper"] =
          entry.model_paper ? ordered_json(*entry.model_paper) : ordered_json(nullptr);
      out["weight_type"] = entry.weight_type;
      entries.emplace(key, std::move(out));
    }
  }
  ordered_json results = ordered_json::array();
  for (const auto& [key, out] : entries) results.push_back(out);
  const ordered_json all = {{"last_updated", date}, {"results", results}};
  return all.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace robostress
