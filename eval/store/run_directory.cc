#include "eval/store/run_directory.h"

#include <fcntl.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/status_macros.h"
#include "eval/plan/unit_text.h"
#include "eval/store/played_alike.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

bool Exists(const std::string& path) {
  std::error_code error;
  return fs::exists(path, error);
}

}  // namespace

absl::StatusOr<FileLock> FileLock::Take(const std::string& file, const std::string& busy) {
  const int fd = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) return absl::InternalError(absl::StrCat("cannot open ", file, ": ", strerror(errno)));
  FileLock lock(fd);
  if (flock(fd, LOCK_EX | LOCK_NB) != 0) return absl::FailedPreconditionError(busy);
  return lock;
}

FileLock::FileLock(FileLock&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

FileLock::~FileLock() {
  if (fd_ >= 0) close(fd_);
}

bool RunDirectory::Done(const std::string& id) const { return Exists(Unit(id) + "/DONE"); }

bool RunDirectory::Begun(const std::string& id) const {
  return Exists(Unit(id) + "/config.yaml") || Exists(Unit(id) + "/DONE") || Exists(Parts(id));
}

std::unordered_set<std::string> RunDirectory::StartedIds() const {
  std::unordered_set<std::string> ids;
  std::error_code error;
  for (const char* folder : {"/units", "/parts"}) {
    for (const auto& entry : fs::directory_iterator(path_ + folder, error))
      ids.insert(entry.path().filename().string());
  }
  return ids;
}

absl::StatusOr<FileLock> RunDirectory::Lock() const {
  RS_RETURN_IF_ERROR(MakeDirectories(path_));
  return FileLock::Take(path_ + "/.lock", absl::StrCat("another sweep is running in ", path_,
                                                       "; wait for it or choose another --out"));
}

std::string RunDirectory::KeptScenario(const std::string& scenario) const {
  return absl::StrCat(path_, "/scenarios/", ScenarioLabel(scenario), ".yaml");
}

UnitConfig RunDirectory::WithPlayedFilesOf(const std::string& id, UnitConfig config) const {
  if (!NamesFiles(config)) return config;  // one file less to read of each of thousands
  // Before its first row a unit may yet be played with others.
  std::error_code none;
  if (fs::file_size(Unit(id) + "/episodes.jsonl", none) == 0 || none) return config;
  const std::string text = ReadFile(Unit(id) + "/provenance.json").value_or("");
  return WithPlayedFiles(std::move(config), nlohmann::json::parse(text, nullptr, false));
}

UnitConfig RunDirectory::AsPlayed(UnitConfig config) const {
  if (IsScenarioFile(config.scenario))
    config.scenario = fs::absolute(KeptScenario(config.scenario)).lexically_normal().string();
  return config;
}

absl::Status RunDirectory::CheckStarted(const SweepGrid& grid,
                                        const std::vector<PlannedUnit>& units) const {
  constexpr char kHere[] = "this command";
  const std::unordered_set<std::string> started = StartedIds();
  std::set<std::string> ids, others(started.begin(), started.end());
  std::vector<std::string> complaints;
  UnitTexts texts;
  UnitTextReader reader;
  PlayedAlike alike;  // the units that this command adds
  PresentFiles present_files;
  std::set<std::string> changed;  // of them
  bool adds = false;
  for (const PlannedUnit& unit : units) {
    ids.insert(unit.id);
    others.erase(unit.id);
    if (started.count(unit.id) == 0 || !Begun(unit.id)) {
      adds = true;
      alike.Add(present_files.Of(AsPlayed(unit.config)), kHere);
      continue;
    }
    const UnitConfig now = present_files.Of(unit.config);
    const UnitConfig then = WithPlayedFilesOf(unit.id, now);
    for (const auto& [hash, played, named] :
         {std::tie(now.libero_tasks, then.libero_tasks, unit.config.libero_tasks),
          std::tie(now.libero_fixtures, then.libero_fixtures, unit.config.libero_fixtures)}) {
      // Empty: LIBERO's own tasks, on a machine that has them not.
      const std::string label = named.empty() ? "LIBERO's " + unit.config.suite : named;
      if (hash.empty() || hash == played || !changed.insert(label).second) continue;
      complaints.push_back(
          absl::StrCat(label, " has changed since ", Unit(unit.id),
                       " was played with it; restore it, or choose another --out"));
    }
    const std::string file = PlanFile(unit.id);
    const absl::StatusOr<std::string> present = ReadFile(file);
    const std::string wanted = texts.Of({unit.id, AsPlayed(unit.config)});
    if (!present.ok() || *present == wanted) continue;
    // Versions up to 0.2 planned the user's own scenario file; a run directory may be moved.
    absl::StatusOr<UnitConfig> begun = reader.Read(file, *present);
    if (begun.ok()) *begun = AsPlayed(*std::move(begun));
    if (begun.ok() && DumpConfig(*begun) == wanted) continue;
    complaints.push_back(absl::StrCat(
        file, " plans this unit with another configuration, and it has been started: ",
        begun.ok()
            ? FirstDifference(FlatOptionsOf(DumpConfig(*begun)), "it", FlatOptionsOf(wanted), kHere)
            : std::string(begun.status().message())));
  }
  if (adds) {
    for (const std::string& id : others) {
      absl::StatusOr<std::string> text = ReadFile(PlanFile(id));
      if (!text.ok()) text = ReadFile(Unit(id) + "/config.yaml");
      if (!text.ok() || !Begun(id)) continue;
      const absl::StatusOr<UnitConfig> begun = reader.Read(PlanFile(id), *text);
      if (!begun.ok()) continue;  // what is damaged is said where it is read
      if (const std::string named = UnitId(*begun); named != id && ids.count(named) > 0) {
        complaints.push_back(absl::StrCat(
            Unit(id), " was begun by a version up to 0.2, and this one calls the unit ", named));
      }
      alike.Compare(WithPlayedFilesOf(id, AsPlayed(*begun)), id);
    }
    complaints.insert(complaints.end(), alike.complaints().begin(), alike.complaints().end());
  }
  if (!complaints.empty()) {
    complaints.push_back(absl::StrCat(
        "results of different configurations cannot share a run directory. Choose another --out, "
        "or repeat the options of ",
        path_, "/sweep.yaml"));
  }
  // A scenario file may change; results of two versions of it cannot share a run directory.
  for (const std::string& scenario : grid.scenarios) {
    const std::string kept = KeptScenario(scenario);
    if (!IsScenarioFile(scenario) || !Exists(kept)) continue;
    if (ReadFile(kept).value_or("") == ReadFile(scenario).value_or("")) continue;
    complaints.push_back(absl::StrCat(scenario,
                                      " has changed since this run began, which kept it as ", kept,
                                      "; choose another --out, or restore the file"));
  }
  if (complaints.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrJoin(complaints, "\n"));
}

absl::Status RunDirectory::Prepare(const SweepGrid& grid,
                                   const std::vector<PlannedUnit>& units) const {
  for (const char* folder : {"", "/plan", "/units", "/logs", "/grids"})
    RS_RETURN_IF_ERROR(MakeDirectories(path_ + folder));
  RS_RETURN_IF_ERROR(CheckStarted(grid, units));
  for (const std::string& scenario : grid.scenarios) {
    if (!IsScenarioFile(scenario) || Exists(KeptScenario(scenario))) continue;
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(scenario));
    RS_RETURN_IF_ERROR(MakeDirectories(path_ + "/scenarios"));
    RS_RETURN_IF_ERROR(WriteFileAtomically(KeptScenario(scenario), text));
  }
  const std::string text = DumpConfig(grid);
  const std::string kept = absl::StrCat(path_, "/grids/", Sha256Hex(text).substr(0, 12), ".yaml");
  if (!Exists(kept)) RS_RETURN_IF_ERROR(WriteFileAtomically(kept, text));
  return WriteFileAtomically(path_ + "/sweep.yaml", text);
}

absl::Status RunDirectory::WritePlan(const PlannedUnit& unit) const {
  const std::string text = DumpConfig(AsPlayed(unit.config));
  if (ReadFile(PlanFile(unit.id)).value_or("") == text) return absl::OkStatus();
  return WriteFileAtomically(PlanFile(unit.id), text);
}

absl::StatusOr<std::vector<SweepGrid>> RunDirectory::Grids() const {
  std::vector<std::string> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(path_ + "/grids", error)) {
    if (entry.path().extension() == ".yaml") files.push_back(entry.path().string());
  }
  std::sort(files.begin(), files.end());
  if (files.empty() && Exists(path_ + "/sweep.yaml")) files.push_back(path_ + "/sweep.yaml");
  std::vector<SweepGrid> grids;
  for (const std::string& file : files) {
    absl::StatusOr<SweepGrid> grid = LoadConfig<SweepGrid>(file);
    if (!grid.ok()) return absl::DataLossError(grid.status().message());
    grids.push_back(*std::move(grid));
  }
  return grids;
}

absl::StatusOr<std::set<std::string>> RunDirectory::PlannedIds(
    const std::set<std::string>& present) const {
  RS_ASSIGN_OR_RETURN(std::vector<SweepGrid> grids, Grids());
  std::set<std::string> ids;
  for (SweepGrid& grid : grids) {
    for (std::string& scenario : grid.scenarios) {
      if (IsScenarioFile(scenario) && Exists(KeptScenario(scenario)))
        scenario = KeptScenario(scenario);
    }
    // They decide nothing in an id, and a task folder may be gone.
    if (grid.tasks.empty()) grid.tasks = {0};
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
    for (const PlannedUnit& unit : units) {
      const std::string older = OlderUnitId(unit.config);
      ids.insert(present.count(unit.id) == 0 && present.count(older) > 0 ? older : unit.id);
    }
  }
  return ids;
}

absl::Status CheckRunDirectories(const std::vector<std::string>& dirs) {
  std::vector<std::string> complaints;
  for (const std::string& dir : dirs) {
    std::error_code error;
    if (fs::is_directory(dir + "/units", error)) continue;
    complaints.push_back(absl::StrCat(
        dir, " is not a run directory: it has no folder units/. Give the --out of a sweep"));
  }
  if (complaints.empty()) return absl::OkStatus();
  return absl::NotFoundError(absl::StrJoin(complaints, "\n"));
}

absl::StatusOr<std::vector<std::string>> UnitFolders(const std::string& dir) {
  std::error_code error;
  std::vector<std::string> folders;
  for (const auto& entry : fs::directory_iterator(dir + "/units", error))
    folders.push_back(entry.path().string());
  if (error)
    return absl::UnavailableError(absl::StrCat("cannot read ", dir, "/units: ", error.message()));
  std::sort(folders.begin(), folders.end());
  return folders;
}

int CountLines(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  return static_cast<int>(
      std::count(std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>(), '\n'));
}

}  // namespace robostress
