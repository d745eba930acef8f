#include "eval/store/unit_files.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/libero/task_folder.h"
#include "common/records/json_record.h"
#include "common/suites.h"
#include "common/unit/unit_directory.h"
#include "common/unit/unit_plan.h"
#include "eval/store/run_directory.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

class UnitReader {
 public:
  UnitReader(std::string folder, UnitTextReader& texts)
      : folder_(std::move(folder)), texts_(texts) {}

  UnitInspection Read() {
    result_.unit.id = fs::path(folder_).filename().string();
    std::error_code error;
    result_.finished = fs::exists(folder_ + "/DONE", error);
    const bool configured = ReadConfiguration();
    ReadEpisodes();
    if (result_.finished && configured) {
      CheckCompleteness();
      CheckIdentities();
    }
    if (result_.finished) CheckSum();
    ReadExtras();
    FindScenario();
    if (!result_.finished) result_.damage.clear();
    return std::move(result_);
  }

 private:
  void Damage(std::string text) { result_.damage.push_back(std::move(text)); }

  bool ReadConfiguration() {
    const std::string file = folder_ + "/config.yaml";
    const absl::StatusOr<std::string> text = ReadFile(file);
    if (text.ok() && text->find_first_not_of(" \t\r\n") == std::string::npos) {
      Damage(file + " is empty");  // and not a unit with every default
      return false;
    }
    absl::StatusOr<UnitConfig> config = text.ok() ? texts_.Read(file, *text) : text.status();
    if (!config.ok()) {
      Damage(std::string(config.status().message()));
      return false;
    }
    UnitResult& unit = result_.unit;
    unit.config = *std::move(config);
    if (const absl::Status status = FillTasks(unit.config); !status.ok()) {
      Damage(absl::StrCat(file, ": ", status.message()));
      return false;
    }
    if (const std::string named = UnitId(unit.config);
        named != unit.id && OlderUnitId(unit.config) != unit.id) {
      Damage(absl::StrCat(file, " is that of unit ", named, ", its folder is called ", unit.id,
                          "; a unit lies under its own name, and once"));
    }
    return true;
  }

  // Lists the tasks where none means all of the suite.
  absl::Status FillTasks(UnitConfig& config) const {
    const SuiteInfo* suite = FindSuite(config.suite);
    if (suite == nullptr && config.libero_tasks.empty())
      return absl::NotFoundError(absl::StrCat("suite '", config.suite, "' is unknown"));
    // A sweep lists them, so that a run is read where its task folder is gone.
    if (!config.tasks.empty()) return absl::OkStatus();
    int tasks = suite == nullptr ? 0 : suite->num_tasks;
    if (!config.libero_tasks.empty()) {
      const absl::StatusOr<LiberoTaskFolder> folder = ReadLiberoTaskFolder(config.libero_tasks);
      if (!folder.ok()) {
        return absl::NotFoundError(absl::StrCat(
            "tasks is empty, and libero_tasks cannot be read: ", folder.status().message(),
            "; put the folder back or list the tasks"));
      }
      tasks = static_cast<int>(folder->tasks.size());
    }
    for (int task = 0; task < tasks; ++task) config.tasks.push_back(task);
    return absl::OkStatus();
  }

  void ReadEpisodes() {
    const std::string file = folder_ + "/episodes.jsonl";
    const absl::StatusOr<std::string> text = ReadFile(file);
    if (!text.ok()) return Damage(std::string(text.status().message()));
    result_.episodes_sha256 = Sha256Hex(*text);
    if (!text->empty() && text->back() != '\n') Damage(absl::StrCat(file, " ends in a torn line"));
    int line_number = 0;
    for (absl::string_view line : absl::StrSplit(*text, '\n')) {
      ++line_number;
      if (line.empty()) continue;
      absl::StatusOr<EpisodeRow> row =
          ParseEpisode(absl::StrCat(file, ":", line_number), std::string(line));
      if (row.ok()) {
        result_.unit.episodes.push_back(*std::move(row));
      } else {
        Damage(std::string(row.status().message()));
      }
    }
  }

  void CheckCompleteness() {
    const std::string file = folder_ + "/episodes.jsonl";
    const UnitResult& unit = result_.unit;
    const size_t expected = unit.config.tasks.size() * unit.config.episodes;
    if (unit.episodes.size() != expected) {
      Damage(absl::StrCat(file, " has ", unit.episodes.size(), " episodes, its configuration says ",
                          expected, "; remove the unit's folder and run the sweep again"));
    }
    std::set<std::pair<int, int>> seen;
    const std::set<int> tasks(unit.config.tasks.begin(), unit.config.tasks.end());
    for (const EpisodeRow& row : unit.episodes) {
      if (!seen.insert({row.task, row.episode}).second) {
        Damage(absl::StrCat(file, ": task ", row.task, " episode ", row.episode,
                            " is recorded twice"));
      }
      if (tasks.count(row.task) == 0 || row.episode < 0 || row.episode >= unit.config.episodes) {
        Damage(absl::StrCat(file, ": task ", row.task, " episode ", row.episode,
                            " is none of its configuration"));
      }
    }
  }

  // That every line says of itself what the configuration says: files are copied by hand.
  void CheckIdentities() {
    const UnitConfig& config = result_.unit.config;
    std::map<std::pair<int, int>, int> states;
    for (const PlannedEpisode& planned : PlanEpisodes(config))
      states[{planned.task, planned.episode}] = planned.initial_state;
    for (const EpisodeRow& row : result_.unit.episodes) {
      const auto state = states.find({row.task, row.episode});
      if (state == states.end()) continue;  // said already
      const EpisodeIdentity expected =
          IdentityOf(config, {row.task, row.episode, state->second, false});
      const json says = json::parse(row.record, nullptr, false), must(RecordJson(expected));
      for (const auto& [key, value] : must.items()) {
        const auto found = says.find(key);
        if (found == says.end() || *found == value) continue;
        if (key == "policy" && found->is_string() &&
            PolicyLabel(found->get<std::string>()) == PolicyLabel(config.policy))
          continue;
        Damage(absl::StrCat(folder_, "/episodes.jsonl: the line of task ", row.task, ", episode ",
                            row.episode, " says ", key, " ", found->dump(), ", config.yaml ",
                            value.dump(), "; remove the unit's folder and run the sweep again"));
        return;  // the first says enough
      }
    }
  }

  void CheckSum() {
    const std::string file = folder_ + "/DONE";
    const std::string text = ReadFile(file).value_or("");
    const json done = json::parse(text, nullptr, false);
    if (!done.is_object() || !done.contains("episodes_sha256")) {
      result_.without_checksum = true;
      return;
    }
    if (!MustBeText(file, done, "episodes_sha256")) return;
    const std::string expected = TextAt(done, "episodes_sha256");
    if (expected == result_.episodes_sha256 || result_.episodes_sha256.empty()) return;
    Damage(absl::StrCat(folder_, "/episodes.jsonl is not what DONE says: its SHA-256 begins ",
                        result_.episodes_sha256.substr(0, 12), ", DONE has ",
                        expected.substr(0, 12)));
  }

  // What decides something may be absent in old files, but not be something else.
  bool MustBeText(const std::string& file, const json& object, const char* key) {
    const auto found = object.find(key);
    if (found == object.end() || found->is_string()) return true;
    Damage(absl::StrCat(file, ": ", key, " is ", found->dump(),
                        ", must be a text; remove the unit's folder and run the sweep again"));
    return false;
  }

  void ReadProvenance(const std::string& file, const std::string& text) {
    json provenance = json::parse(text, nullptr, false);
    if (!provenance.is_object()) return Damage(file + " is not a JSON object");
    bool sound = true;
    for (const char* key : {"model_hash", "version", "noise_paired", "options"})
      sound = MustBeText(file, provenance, key) && sound;
    if (!sound) return;
    result_.unit.config = WithPlayedFiles(std::move(result_.unit.config), provenance);
    result_.unit.provenance = std::move(provenance);
  }

  void ReadExtras() {
    UnitResult& unit = result_.unit;
    const std::string file = folder_ + "/provenance.json";
    if (const auto text = ReadFile(file); text.ok()) ReadProvenance(file, *text);
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(folder_ + "/videos", none)) {
      if (entry.path().extension() == ".webp") unit.videos.push_back(entry.path().string());
    }
    std::sort(unit.videos.begin(), unit.videos.end());
    AddTimings();
    for (const json& record : Records("/servers.jsonl")) {
      ServerRow row;
      if (ReadRecord(folder_, record, row).ok()) unit.servers.push_back(std::move(row));
    }
    std::set<std::string> machines;
    for (const json& record : Records("/machines.jsonl")) {
      for (const auto& [role, machine] : record.items()) {
        if (machine.is_string() && machine != "unknown") machines.insert(machine);
      }
    }
    unit.machines.assign(machines.begin(), machines.end());
  }

  // The run's copy of a scenario file stands for the user's, which may have changed or gone.
  void FindScenario() {
    UnitResult& unit = result_.unit;
    if (!IsScenarioFile(unit.config.scenario)) return;
    const std::string run = fs::path(folder_).parent_path().parent_path().string();
    const std::string kept = RunDirectory(run).KeptScenario(unit.config.scenario);
    const absl::StatusOr<std::string> sha256 = Sha256OfFile(kept);
    if (!sha256.ok()) return;
    unit.config.scenario = kept;
    if (!unit.provenance.is_object()) return;
    const std::string played = unit.provenance.value(kScenarioSha256, *sha256);
    if (played == *sha256) return;
    Damage(
        absl::StrCat(folder_, "/provenance.json: ", kScenarioSha256, " is ", played.substr(0, 12),
                     ", ", kept, " has ", sha256->substr(0, 12),
                     "; restore that file, or remove the unit's folder and run the sweep again"));
  }

  // JSON objects, one a line; lines that are none are passed over: these files decide nothing.
  std::vector<json> Records(const char* name) const {
    std::vector<json> records;
    const std::string text = ReadFile(folder_ + name).value_or("");
    for (absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
      json record = json::parse(line, nullptr, false);
      if (record.is_object()) records.push_back(std::move(record));
    }
    return records;
  }

  void AddTimings() {
    const std::string text = ReadFile(folder_ + "/timing.jsonl").value_or("");
    TimingSums& sums = result_.unit.timing;
    for (absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
      const std::optional<TimingRow> row = ParseTiming(std::string(line));
      if (!row) continue;  // they decide nothing
      ++sums.episodes;
      sums.wall_s += row->wall_s.value_or(0);
      sums.predict_s += row->predict_s.value_or(0);
      sums.step_s += row->step_s.value_or(0);
      sums.observe_s += row->observe_s.value_or(0);
      sums.feedback_s += row->feedback_s.value_or(0);
    }
  }

  const std::string folder_;
  UnitTextReader& texts_;
  UnitInspection result_;
};

}  // namespace

UnitInspection InspectUnit(const std::string& folder, UnitTextReader& texts) {
  return UnitReader(folder, texts).Read();
}

std::vector<std::string> DifferentModels(const std::vector<ModelUse>& uses) {
  std::map<std::string, std::map<std::string, std::vector<std::string>>> models;
  for (const ModelUse& use : uses) models[use.policy][use.model_hash].push_back(use.unit);
  std::vector<std::string> complaints;
  for (const auto& [policy, units_by_hash] : models) {
    if (units_by_hash.size() < 2) continue;
    for (const auto& [hash, units] : units_by_hash) {
      complaints.push_back(
          absl::StrCat("policy ", policy, " has weights ", hash.substr(0, 12), " in ", units.size(),
                       " units and others elsewhere: ", absl::StrJoin(units, ", ")));
    }
  }
  return complaints;
}

}  // namespace robostress
