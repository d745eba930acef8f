#include "eval/store/store_check.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/records/episode_recording.h"
#include "common/status_macros.h"
#include "eval/store/played_alike.h"
#include "eval/store/run_directory.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

void Report(const std::string& store, const std::string& unit, StoreFault fault, std::string text,
            StoreContents& contents) {
  contents.findings.push_back({fault, store, unit, std::move(text)});
}

void AddUnit(const std::string& store, UnitInspection inspection, StoreContents& contents) {
  const std::string id = inspection.unit.id;
  if (!inspection.finished) {
    Report(store, id, StoreFault::kUnfinished,
           absl::StrCat(inspection.unit.episodes.size(), " of ",
                        inspection.unit.config.tasks.size() * inspection.unit.config.episodes,
                        " episodes; the sweep's command completes it"),
           contents);
  } else {
    if (inspection.without_checksum)
      inspection.damage.push_back(store + "/units/" + id + "/DONE holds no checksum");
    for (const std::string& damage : inspection.damage)
      Report(store, id, StoreFault::kDamaged, damage, contents);
    ++contents.finished;
  }
  inspection.unit.episodes = std::vector<EpisodeRow>();  // a store may hold millions
  contents.units.push_back({store, std::move(inspection)});
}

// Parts of units that are not joined yet.
void AddParts(const RunDirectory& run, std::set<std::string>& present, StoreContents& contents) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(run.path() + "/parts", error)) {
    const std::string id = entry.path().filename().string();
    if (!present.insert(id).second) continue;
    int episodes = 0;
    std::error_code none;
    for (const auto& part : fs::directory_iterator(entry.path(), none))
      episodes += CountLines(part.path().string() + "/episodes.jsonl");
    Report(run.path(), id, StoreFault::kUnfinished,
           absl::StrCat(episodes, " episodes in parts; the sweep's command completes it"),
           contents);
  }
}

void CompareWithGrids(const RunDirectory& run, const std::set<std::string>& present,
                      StoreContents& contents) {
  const absl::StatusOr<std::set<std::string>> planned = run.PlannedIds(present);
  if (!planned.ok()) {
    Report(run.path(), "", StoreFault::kDamaged, std::string(planned.status().message()), contents);
    return;
  }
  for (const std::string& id : *planned) {
    if (present.count(id) > 0) continue;
    Report(run.path(), id, StoreFault::kMissing, "planned and never begun", contents);
  }
  for (const std::string& id : present) {
    if (planned->count(id) > 0 || planned->empty()) continue;
    Report(run.path(), id, StoreFault::kUnplanned, "no grid of this store plans it", contents);
  }
}

void CompareStores(StoreContents& contents) {
  std::map<std::string, const StoredUnit*> first;
  std::vector<StoreFinding> found;
  for (const StoredUnit& unit : contents.units) {
    if (!unit.inspection.finished) continue;
    const auto [other, added] = first.emplace(unit.inspection.unit.id, &unit);
    if (added) continue;
    const bool equal = other->second->Fingerprint() == unit.Fingerprint();
    found.push_back({equal ? StoreFault::kDuplicate : StoreFault::kConflict, unit.store,
                     unit.inspection.unit.id,
                     equal ? absl::StrCat("equal in ", other->second->store, "; counted once")
                           : absl::StrCat("has other results, configuration or weights in ",
                                          other->second->store, "; remove the one that is wrong")});
  }
  contents.findings.insert(contents.findings.end(), found.begin(), found.end());
}

// A table names a scenario file's units by the file's name.
void CompareScenarioFiles(const std::vector<std::string>& stores, StoreContents& contents) {
  struct Kept {
    std::string store, text;
  };
  std::map<std::string, Kept> first;
  for (const std::string& store : stores) {
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(store + "/scenarios", none)) {
      const std::string name = entry.path().filename().string();
      const absl::StatusOr<std::string> text = ReadFile(entry.path().string());
      if (!text.ok()) {
        Report(store, "", StoreFault::kDamaged, std::string(text.status().message()), contents);
        continue;
      }
      const auto [kept, fresh] = first.try_emplace(name, Kept{store, *text});
      if (fresh || kept->second.text == *text) continue;
      Report(store, "", StoreFault::kConflict,
             absl::StrCat("scenarios/", name, " is another scenario in ", kept->second.store,
                          "; run the units of one of them again under another file name"),
             contents);
    }
  }
}

}  // namespace

const char* StoreFaultName(StoreFault fault) {
  switch (fault) {
    case StoreFault::kDamaged:
      return "damaged";
    case StoreFault::kConflict:
      return "conflict";
    case StoreFault::kOtherModel:
      return "other model";
    case StoreFault::kUnlike:
      return "unlike";
    case StoreFault::kUnfinished:
      return "unfinished";
    case StoreFault::kMissing:
      return "missing";
    case StoreFault::kUnplanned:
      return "unplanned";
    case StoreFault::kDuplicate:
      return "duplicate";
  }
  return "";
}

bool IsBad(StoreFault fault) { return fault <= StoreFault::kUnlike; }

bool IsIncomplete(StoreFault fault) {
  return fault == StoreFault::kUnfinished || fault == StoreFault::kMissing;
}

std::string StoredUnit::Fingerprint() const {
  UnitConfig config = inspection.unit.config;
  config.libero_root.clear();
  config.robosuite_root.clear();
  config.libero_tasks.clear();
  config.scenario = ScenarioLabel(config.scenario);
  config.policy = PolicyLabel(config.policy);
  return absl::StrCat(Sha256Hex(DumpConfig(config)), " ", inspection.episodes_sha256, " ",
                      TextAt(inspection.unit.provenance, "model_hash"));
}

namespace {

// Of a unit with a folder of recorded episodes (`sweep --record-episodes`): that of every episode
// is there, can be read and has the steps that its line says.
void CheckRecordings(const std::string& folder, UnitInspection& inspection) {
  std::error_code ignored;
  if (!std::filesystem::is_directory(folder + "/episodes", ignored)) return;
  int faulty = 0;
  std::string first;
  for (const EpisodeRow& row : inspection.unit.episodes) {
    if (row.steps == 0) continue;
    const std::string file =
        absl::StrCat(folder, "/episodes/task", row.task, "_episode", row.episode, ".safetensors");
    const absl::StatusOr<EpisodeRecording> recording = ReadEpisodeRecording(file);
    std::string fault;
    if (!recording.ok()) {
      fault = std::string(recording.status().message());
    } else if (static_cast<int>(recording->steps.size()) != row.steps ||
               recording->task != row.task || recording->episode != row.episode) {
      fault = absl::StrCat(file, ": task ", recording->task, ", episode ", recording->episode, ", ",
                           recording->steps.size(), " steps; episodes.jsonl says task ", row.task,
                           ", episode ", row.episode, ", ", row.steps, " steps");
    }
    if (!fault.empty() && ++faulty == 1) first = fault;
  }
  if (faulty == 0) return;
  inspection.damage.push_back(absl::StrCat(
      first, faulty == 1 ? "" : absl::StrCat(" (and ", faulty - 1, " more recorded episodes)"),
      "; the recording cannot be exported: restore it, or remove the unit's folder and run again"));
}

}  // namespace

absl::StatusOr<StoreContents> CheckStores(const std::vector<std::string>& stores) {
  StoreContents contents;
  UnitTextReader texts;
  std::vector<ModelUse> models;
  PlayedAlike alike;
  RS_RETURN_IF_ERROR(CheckRunDirectories(stores));
  for (const std::string& store : stores) {
    const RunDirectory run(store);
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> folders, UnitFolders(store));
    std::set<std::string> present;
    for (const std::string& folder : folders) {
      UnitInspection inspection = InspectUnit(folder, texts);
      const UnitResult& unit = inspection.unit;
      present.insert(unit.id);
      if (inspection.finished && unit.provenance.is_object()) {
        models.push_back({PolicyLabel(unit.config.policy), TextAt(unit.provenance, "model_hash"),
                          absl::StrCat(store, "/", unit.id)});
      }
      if (inspection.finished && unit.config.robot == "panda") CheckRecordings(folder, inspection);
      if (inspection.finished && inspection.damage.empty())
        alike.Add(unit.config, absl::StrCat(store, "/", unit.id));
      AddUnit(store, std::move(inspection), contents);
    }
    AddParts(run, present, contents);
    CompareWithGrids(run, present, contents);
  }
  CompareStores(contents);
  CompareScenarioFiles(stores, contents);
  for (const std::string& complaint : DifferentModels(models))
    Report("", "", StoreFault::kOtherModel, complaint, contents);
  for (const std::string& complaint : alike.complaints())
    Report("", "", StoreFault::kUnlike, complaint, contents);
  std::stable_sort(contents.findings.begin(), contents.findings.end(),
                   [](const StoreFinding& a, const StoreFinding& b) { return a.fault < b.fault; });
  return contents;
}

}  // namespace robostress
