#include "common/unit/unit_directory.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/check.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "common/version.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr char kAdapterTensor[] = "session";

bool Exists(const std::string& path) {
  std::error_code error;
  return fs::exists(path, error);
}

void Remove(const std::string& path) {
  std::error_code error;
  fs::remove(path, error);
}

absl::StatusOr<std::string> ReadIfPresent(const std::string& path) {
  if (!Exists(path)) return std::string();
  return ReadFile(path);
}

// Complete lines; `torn` tells that text follows the last of them.
std::vector<std::string> CompleteLines(const std::string& text, bool& torn) {
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  torn = !lines.back().empty();
  lines.pop_back();
  return lines;
}

// First line in which two texts differ, for a message.
std::string FirstDifference(const std::string& present, const std::string& wanted) {
  const std::vector<std::string> a = absl::StrSplit(present, '\n'),
                                 b = absl::StrSplit(wanted, '\n');
  for (size_t i = 0; i < std::max(a.size(), b.size()); ++i) {
    const std::string left = i < a.size() ? a[i] : "", right = i < b.size() ? b[i] : "";
    if (left != right) return absl::StrCat("it has '", left, "', asked for '", right, "'");
  }
  return "it differs";
}

}  // namespace

absl::StatusOr<std::unique_ptr<UnitDirectory>> UnitDirectory::Open(
    const std::string& path, const UnitConfig& resolved, const std::vector<PlannedEpisode>& plan) {
  RS_RETURN_IF_ERROR(MakeDirectories(path));
  std::unique_ptr<UnitDirectory> directory(new UnitDirectory(path));
  RS_RETURN_IF_ERROR(directory->Lock());
  directory->planned_ = plan.size();
  RS_RETURN_IF_ERROR(directory->CheckConfig(resolved));
  RS_RETURN_IF_ERROR(directory->LoadRows(resolved, plan));
  RS_RETURN_IF_ERROR(directory->CheckDone());
  return directory;
}

UnitDirectory::~UnitDirectory() {
  if (lock_ >= 0) ::close(lock_);
}

absl::Status UnitDirectory::Lock() {
  lock_ = ::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (lock_ < 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot open directory '", path_, "': ", std::strerror(errno)));
  }
  if (::flock(lock_, LOCK_EX | LOCK_NB) == 0) return absl::OkStatus();
  // A file system without locks (some network ones) cannot protect; it does not stop the work
  // either.
  if (errno != EWOULDBLOCK) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("another worker is writing to '", path_,
                                                    "'; wait for it or choose another --out"));
}

absl::Status UnitDirectory::CheckConfig(const UnitConfig& resolved) {
  const std::string file = File("config.yaml");
  const std::string wanted = DumpConfig(resolved);
  const bool begun = Exists(File("episodes.jsonl")) || Exists(File("adapter_state.safetensors")) ||
                     Exists(File("DONE"));
  if (!begun) return WriteFileAtomically(file, wanted);  // nothing to protect yet
  if (!Exists(file)) {
    return absl::FailedPreconditionError(
        absl::StrCat("'", path_, "' has episodes without a config.yaml; choose another --out"));
  }
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  RS_ASSIGN_OR_RETURN(UnitConfig read, ReadUnit(file, text));
  // Where a scenario file lies may change; what it holds is CheckModel's.
  if (ScenarioLabel(read.scenario) == ScenarioLabel(resolved.scenario))
    read.scenario = resolved.scenario;
  RS_ASSIGN_OR_RETURN(const UnitConfig present, ResolveUnit(read));
  if (DumpConfig(present) == wanted) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      "'", path_, "' belongs to another unit: ", FirstDifference(DumpConfig(present), wanted),
      "; choose another --out or remove the directory"));
}

absl::Status UnitDirectory::LoadRows(const UnitConfig& resolved,
                                     const std::vector<PlannedEpisode>& plan) {
  const std::string file = File("episodes.jsonl");
  RS_ASSIGN_OR_RETURN(const std::string text, ReadIfPresent(file));
  bool torn = false;
  std::vector<std::string> lines = CompleteLines(text, torn);
  if (lines.size() > plan.size()) {
    return absl::DataLossError(absl::StrCat(file, " has ", lines.size(), " rows, the unit has ",
                                            plan.size(), " episodes; remove '", path_,
                                            "' and run again"));
  }
  for (size_t i = 0; i < lines.size(); ++i) {
    if (IsRowOf(IdentityOf(resolved, plan[i]), lines[i])) continue;
    return absl::DataLossError(absl::StrCat(file, ":", i + 1, " is not the row of task ",
                                            plan[i].task, ", episode ", plan[i].episode,
                                            "; remove '", path_, "' and run again"));
  }
  rows_ = std::move(lines);
  if (torn) RS_RETURN_IF_ERROR(WriteFileAtomically(file, RowsText()));
  return TrimTimings();
}

absl::Status UnitDirectory::TrimTimings() {
  const std::string file = File("timing.jsonl");
  RS_ASSIGN_OR_RETURN(const std::string text, ReadIfPresent(file));
  std::set<std::pair<int, int>> finished;
  for (const std::string& line : rows_) {
    RS_ASSIGN_OR_RETURN(const EpisodeRow row, ParseEpisode(File("episodes.jsonl"), line));
    finished.insert({row.task, row.episode});
  }
  bool torn = false;
  std::string kept;
  for (const std::string& line : CompleteLines(text, torn)) {
    const std::optional<TimingRow> timing = ParseTiming(line);
    if (!timing || finished.erase({timing->task, timing->episode}) == 0) continue;
    absl::StrAppend(&kept, line, "\n");
  }
  return kept == text ? absl::OkStatus() : WriteFileAtomically(file, kept);
}

absl::Status UnitDirectory::CheckDone() {
  if (!Exists(File("DONE"))) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(File("DONE")));
  const json done = json::parse(text, nullptr, false);
  if (rows_.size() != planned_ || TextAt(done, "episodes_sha256") != Sha256Hex(RowsText())) {
    return absl::DataLossError(absl::StrCat(
        File("episodes.jsonl"), " is not what DONE says; remove '", path_, "' and run again"));
  }
  done_ = true;
  return absl::OkStatus();
}

std::string UnitDirectory::RowsText() const {
  std::string text;
  for (const std::string& row : rows_) absl::StrAppend(&text, row, "\n");
  return text;
}

namespace {

// No table mixes weights under one name: said before hours of a run that could not be read. One
// finished unit of the policy beside `path` says for all.
absl::Status CheckWithFinishedUnits(const std::string& path, const std::string& policy,
                                    const std::string& model_hash) {
  const fs::path units = fs::path(path).parent_path();
  if (units.filename() != "units" || model_hash.empty()) return absl::OkStatus();
  std::error_code ignored;
  for (const auto& unit : fs::directory_iterator(units, ignored)) {
    if (!fs::exists(unit.path() / "DONE", ignored)) continue;
    const json finished = json::parse(
        ReadFile((unit.path() / "provenance.json").string()).value_or(""), nullptr, false);
    const std::string played = TextAt(finished, "model_hash");
    if (TextAt(finished, "policy") != policy || played.empty()) continue;
    if (played == model_hash) return absl::OkStatus();
    return absl::FailedPreconditionError(absl::StrCat(
        unit.path().string(), " was played with weights ", played.substr(0, 12), " of policy '",
        policy, "', which now has ", model_hash.substr(0, 12),
        "; a run has one model under a name: give the new weights another name or --out"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status UnitDirectory::CheckModel(const std::string& policy, const std::string& model_hash,
                                       const std::map<std::string, std::string>& notes) {
  const std::string file = File("provenance.json");
  json wanted = notes;
  wanted.update({{"policy", policy}, {"model_hash", model_hash}, {"version", BuildVersion()}});
  RS_ASSIGN_OR_RETURN(const std::string text, ReadIfPresent(file));
  if (text.empty() || rows_.empty()) {
    RS_RETURN_IF_ERROR(CheckWithFinishedUnits(path_, policy, model_hash));
    return WriteFileAtomically(file, wanted.dump() + "\n");
  }
  const json present = json::parse(text, nullptr, false);
  for (const auto& [key, what] : {std::pair{kScenarioSha256, "a scenario file"},
                                  {kLiberoTasksSha256, "LIBERO tasks"},
                                  {kLiberoFixturesSha256, "a table of LIBERO's fixtures"}}) {
    const auto now = notes.find(key);
    const std::string played = TextAt(present, key);
    if (now == notes.end() || played.empty() || played == now->second) continue;
    return absl::FailedPreconditionError(
        absl::StrCat("'", path_, "' was begun with ", what, " whose SHA-256 begins ",
                     played.substr(0, 12), ", now it begins ", now->second.substr(0, 12),
                     "; restore it, choose another --out or remove the directory"));
  }
  const std::string begun = TextAt(present, "model_hash");
  if (begun == model_hash) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      "'", path_, "' was begun with weights ", begun.substr(0, 12), ", policy '", policy,
      "' now has ", model_hash.substr(0, 12),
      "; serve the first weights again, choose another --out or remove the directory"));
}

absl::StatusOr<std::string> UnitDirectory::LoadAdapterState() {
  const std::string file = File("adapter_state.safetensors");
  if (!Exists(file)) return absl::NotFoundError("there is no adapter state");
  absl::StatusOr<SafetensorsFile> state = SafetensorsFile::Open(file);
  if (!state.ok()) return absl::NotFoundError(state.status().message());
  const auto& metadata = state->metadata();
  const auto field = [&](const char* key) {
    const auto found = metadata.find(key);
    return found == metadata.end() ? std::string() : found->second;
  };
  uint64_t episodes = 0;
  if (!absl::SimpleAtoi(field("episodes"), &episodes) || episodes < rows_.size() ||
      episodes > rows_.size() + 1 || episodes == 0) {
    return absl::NotFoundError(absl::StrCat("the adapter state is of episode '", field("episodes"),
                                            "', the rows end at ", rows_.size()));
  }
  const bool row_is_missing = episodes == rows_.size() + 1;
  std::string rows = RowsText();
  if (row_is_missing) absl::StrAppend(&rows, field("row"), "\n");
  if (Sha256Hex(rows) != field("episodes_sha256")) {
    return absl::NotFoundError("the adapter state belongs to other rows");
  }
  absl::StatusOr<TensorView> session = state->Get(kAdapterTensor);
  if (!session.ok() || session->dtype != DType::kU8) {
    return absl::NotFoundError(absl::StrCat(file, " has no tensor '", kAdapterTensor, "'"));
  }
  if (row_is_missing) {
    RS_RETURN_IF_ERROR(AppendLine(File("episodes.jsonl"), field("row")));
    rows_.push_back(field("row"));
  }
  return std::string(reinterpret_cast<const char*>(session->bytes.data()), session->bytes.size());
}

absl::Status UnitDirectory::Restart() {
  rows_.clear();
  RS_RETURN_IF_ERROR(WriteFileAtomically(File("episodes.jsonl"), ""));
  Remove(File("adapter_state.safetensors"));
  return TrimTimings();
}

absl::StatusOr<std::string> UnitDirectory::EpisodeFile(const char* folder,
                                                       const PlannedEpisode& planned,
                                                       const char* ending) const {
  RS_RETURN_IF_ERROR(MakeDirectories(File(folder)));
  return absl::StrCat(File(folder), "/task", planned.task, "_episode", planned.episode, ending);
}

absl::Status UnitDirectory::Append(const std::string& row, const std::string& timing,
                                   const std::string* adapter_state) {
  if (adapter_state != nullptr) {
    SafetensorsWriter writer;
    writer.SetMetadata("episodes", absl::StrCat(rows_.size() + 1));
    writer.SetMetadata("row", row);
    writer.SetMetadata("episodes_sha256", Sha256Hex(absl::StrCat(RowsText(), row, "\n")));
    writer.Add(kAdapterTensor, DType::kU8, {static_cast<int64_t>(adapter_state->size())},
               adapter_state->data(), adapter_state->size());
    RS_RETURN_IF_ERROR(writer.Write(File("adapter_state.safetensors")));
  }
  RS_RETURN_IF_ERROR(AppendLine(File("episodes.jsonl"), row));
  rows_.push_back(row);
  return AppendLine(File("timing.jsonl"), timing);
}

absl::Status UnitDirectory::AppendServer(const std::string& row) {
  return AppendLine(File("servers.jsonl"), row);
}

absl::Status UnitDirectory::Finish(const std::string* adapter) {
  RS_CHECK(rows_.size() == planned_);
  if (adapter != nullptr) {
    RS_RETURN_IF_ERROR(WriteFileAtomically(File("adapter.safetensors"), *adapter));
  }
  const json done = {{"episodes", rows_.size()}, {"episodes_sha256", Sha256Hex(RowsText())}};
  RS_RETURN_IF_ERROR(WriteFileAtomically(File("DONE"), done.dump() + "\n"));
  Remove(File("adapter_state.safetensors"));
  done_ = true;
  return absl::OkStatus();
}

}  // namespace robostress
