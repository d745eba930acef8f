#include "eval/store/work_list.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/unit_directory.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// Expected cost in control steps, for the order of dispatch only.
double ExpectedCost(const WorkItem& item) {
  const UnitConfig& config = item.unit->config;
  return item.count * HorizonOf(config) * (config.scenario == "clean" ? 0.5 : 1) *
         (config.method->adapts() ? 1.5 : 1);
}

// As a unit was begun; 0 when it was not begun in parts.
int KeptPartSize(const RunDirectory& run, const std::string& id) {
  int size = 0;
  const absl::StatusOr<std::string> text = ReadFile(run.Parts(id) + "/size");
  return text.ok() && absl::SimpleAtoi(*text, &size) && size > 0 ? size : 0;
}

std::vector<WorkItem> Divide(const PlannedUnit& unit, int part_episodes) {
  const int total = unit.EpisodeCount();
  if (part_episodes <= 0) return {{&unit, 0, total, 0}};
  std::vector<WorkItem> parts;
  for (int first = 0; first < total; first += part_episodes)
    parts.push_back({&unit, first, std::min(part_episodes, total - first), part_episodes});
  return parts;
}

// The text that all parts have in common, such as the configuration.
absl::StatusOr<std::string> Common(const RunDirectory& run, const std::vector<WorkItem>& parts,
                                   const char* name) {
  RS_ASSIGN_OR_RETURN(const std::string first, ReadFile(parts[0].Folder(run) + name));
  for (const WorkItem& part : parts) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(part.Folder(run) + name));
    if (text == first) continue;
    return absl::FailedPreconditionError(
        absl::StrCat("the parts of unit ", part.unit->id, " differ in", name, ": ",
                     parts[0].Folder(run), " and ", part.Folder(run), "; remove ",
                     run.Parts(part.unit->id), " and run the sweep again"));
  }
  return first;
}

absl::StatusOr<std::string> Concatenated(const RunDirectory& run,
                                         const std::vector<WorkItem>& parts, const char* name) {
  std::string text;
  for (const WorkItem& part : parts) {
    RS_ASSIGN_OR_RETURN(const std::string piece, ReadFile(part.Folder(run) + name));
    text += piece;
  }
  return text;
}

// What machines say of LIBERO's files is a note: parts may differ in it, and one that says that
// something is otherwise stands for all.
absl::StatusOr<std::string> JoinedProvenance(const RunDirectory& run,
                                             const std::vector<WorkItem>& parts) {
  nlohmann::json joined;
  std::string note;
  for (const WorkItem& part : parts) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(part.Folder(run) + "/provenance.json"));
    nlohmann::json provenance = nlohmann::json::parse(text, nullptr, false);
    const std::string said = TextAt(provenance, kLiberoFiles);
    if (!said.empty() && (note.empty() || note == kLiberoFilesPublished)) note = said;
    if (provenance.is_object()) provenance.erase(kLiberoFiles);
    if (joined.is_null()) joined = provenance;
    if (!provenance.is_object() || provenance != joined)
      return Common(run, parts, "/provenance.json");  // and its error
  }
  if (!note.empty()) joined[kLiberoFiles] = note;
  return joined.dump() + "\n";
}

// Distinct lines of a file that parts may have.
std::string Lines(const RunDirectory& run, const std::vector<WorkItem>& parts, const char* name) {
  std::set<std::string> lines;
  for (const WorkItem& part : parts) {
    const std::string text = ReadFile(part.Folder(run) + name).value_or("");
    for (absl::string_view line : absl::StrSplit(text, '\n', absl::SkipEmpty()))
      lines.emplace(line);
  }
  std::string text;
  for (const std::string& line : lines) absl::StrAppend(&text, line, "\n");
  return text;
}

// A file that parts may have, one after the other.
std::string Collected(const RunDirectory& run, const std::vector<WorkItem>& parts,
                      const char* name) {
  std::string text;
  for (const WorkItem& part : parts) text += ReadFile(part.Folder(run) + name).value_or("");
  return text;
}

absl::Status LinkFiles(const fs::path& from, const fs::path& to) {
  std::error_code error;
  if (!fs::is_directory(from, error)) return absl::OkStatus();
  RS_RETURN_IF_ERROR(MakeDirectories(to.string()));
  for (const auto& entry : fs::directory_iterator(from, error)) {
    const fs::path target = to / entry.path().filename();
    fs::create_hard_link(entry.path(), target, error);
    if (error) fs::copy_file(entry.path(), target, fs::copy_options::overwrite_existing, error);
    if (error) {
      return absl::UnavailableError(
          absl::StrCat("cannot copy ", entry.path().string(), ": ", error.message()));
    }
  }
  return absl::OkStatus();
}

absl::Status WriteJoined(const RunDirectory& run, const std::vector<WorkItem>& parts,
                         const std::string& folder) {
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  RS_ASSIGN_OR_RETURN(const std::string config, Common(run, parts, "/config.yaml"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/config.yaml", config));
  std::error_code error;
  if (fs::exists(parts[0].Folder(run) + "/provenance.json", error)) {
    RS_ASSIGN_OR_RETURN(const std::string provenance, JoinedProvenance(run, parts));
    RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/provenance.json", provenance));
  }
  RS_ASSIGN_OR_RETURN(const std::string timing, Concatenated(run, parts, "/timing.jsonl"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/timing.jsonl", timing));
  const std::string machines = Lines(run, parts, "/machines.jsonl");
  if (!machines.empty())
    RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/machines.jsonl", machines));
  const std::string servers = Collected(run, parts, "/servers.jsonl");
  if (!servers.empty()) RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/servers.jsonl", servers));
  for (const WorkItem& part : parts) {
    for (const char* files : {"/videos", "/joints", "/episodes"})
      RS_RETURN_IF_ERROR(LinkFiles(part.Folder(run) + files, folder + files));
  }
  RS_ASSIGN_OR_RETURN(const std::string episodes, Concatenated(run, parts, "/episodes.jsonl"));
  const auto rows = std::count(episodes.begin(), episodes.end(), '\n');
  if (rows != parts[0].unit->EpisodeCount()) {
    return absl::DataLossError(
        absl::StrCat("the parts of unit ", parts[0].unit->id, " have ", rows,
                     " episodes, the unit has ", parts[0].unit->EpisodeCount(), "; remove ",
                     run.Parts(parts[0].unit->id), " and run the sweep again"));
  }
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/episodes.jsonl", episodes));
  const nlohmann::json done = {{"episodes", rows}, {"episodes_sha256", Sha256Hex(episodes)}};
  return WriteFileAtomically(folder + "/DONE", done.dump() + "\n");
}

absl::Status PublishJoined(const RunDirectory& run, const std::vector<WorkItem>& parts) {
  const std::string& id = parts[0].unit->id;
  const std::string folder = absl::StrCat(run.Parts(id), "/joined.", getpid());
  std::error_code error;
  fs::remove_all(folder, error);
  RS_RETURN_IF_ERROR(WriteJoined(run, parts, folder));
  RS_RETURN_IF_ERROR(MakeDirectories(run.path() + "/units"));
  fs::rename(folder, run.Unit(id), error);
  if (!error) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("cannot publish ", run.Unit(id), ": ", error.message()));
}

}  // namespace

std::string WorkItem::Range() const { return absl::StrCat(first, "-", first + count - 1); }

std::string WorkItem::Name() const {
  return IsPart() ? absl::StrCat(unit->id, ".", Range()) : unit->id;
}

std::string WorkItem::Folder(const RunDirectory& run) const {
  if (!IsPart()) return run.Unit(unit->id);
  return absl::StrCat(run.Parts(unit->id), absl::StrFormat("/%06d-%06d", first, first + count - 1));
}

bool WorkItem::Done(const RunDirectory& run) const {
  std::error_code error;
  return run.Done(unit->id) || fs::exists(Folder(run) + "/DONE", error);
}

bool MaySplit(const PlannedUnit& unit) { return MayBeDivided(unit.config); }

std::vector<WorkItem> PendingItems(const RunDirectory& run, const std::vector<PlannedUnit>& units,
                                   int part_episodes) {
  const std::unordered_set<std::string> started = run.StartedIds();
  std::vector<WorkItem> pending;
  for (const PlannedUnit& unit : units) {
    int size = MaySplit(unit) && part_episodes < unit.EpisodeCount() ? part_episodes : 0;
    const bool begun = started.count(unit.id) > 0;
    if (begun) {
      if (run.Done(unit.id)) continue;
      std::error_code error;
      const bool undivided = fs::exists(run.Unit(unit.id) + "/config.yaml", error);
      if (const int kept = KeptPartSize(run, unit.id); kept > 0 || undivided) size = kept;
    }
    for (const WorkItem& item : Divide(unit, size)) {
      if (!begun || !item.Done(run)) pending.push_back(item);
    }
  }
  std::stable_sort(pending.begin(), pending.end(), [](const WorkItem& a, const WorkItem& b) {
    return ExpectedCost(a) > ExpectedCost(b);
  });
  return pending;
}

absl::Status PublishItem(const RunDirectory& run, const WorkItem& item) {
  RS_RETURN_IF_ERROR(run.WritePlan(*item.unit));
  if (!item.IsPart() || KeptPartSize(run, item.unit->id) > 0) return absl::OkStatus();
  RS_RETURN_IF_ERROR(MakeDirectories(run.Parts(item.unit->id)));
  return WriteFileAtomically(run.Parts(item.unit->id) + "/size", absl::StrCat(item.part_episodes));
}

absl::Status JoinParts(const RunDirectory& run, const PlannedUnit& unit) {
  const int size = KeptPartSize(run, unit.id);
  if (size == 0) return absl::OkStatus();
  std::error_code error;
  if (!run.Done(unit.id)) {
    const std::vector<WorkItem> parts = Divide(unit, size);
    for (const WorkItem& part : parts) {
      if (!part.Done(run)) return absl::OkStatus();
    }
    const absl::Status joined = PublishJoined(run, parts);
    // Another process may have been faster, and removed the parts: what it published is the same.
    if (!joined.ok() && !run.Done(unit.id)) return joined;
  }
  fs::remove_all(run.Parts(unit.id), error);
  return absl::OkStatus();
}

}  // namespace robostress
