#include "eval/store/store_merge.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "eval/store/run_directory.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

absl::Status FileError(const std::string& what, const std::error_code& error) {
  return absl::UnavailableError(absl::StrCat(what, ": ", error.message()));
}

absl::Status CopyUnit(const std::string& from, const RunDirectory& target, const std::string& id) {
  const std::string staged = absl::StrCat(target.path(), "/merging/", id);
  std::error_code error;
  fs::remove_all(staged, error);
  RS_RETURN_IF_ERROR(MakeDirectories(target.path() + "/merging"));
  fs::copy(from, staged, fs::copy_options::recursive, error);
  if (error) {  // "Input/output error" where a disk is full
    std::error_code ignored;
    const double free = fs::space(target.path(), ignored).available / 1e6;
    return FileError(
        absl::StrFormat("cannot copy %s to %s, where %.3g MB are free", from, staged, free), error);
  }
  fs::remove_all(target.Unit(id), error);  // one that was begun and never finished
  fs::rename(staged, target.Unit(id), error);
  if (error) return FileError(absl::StrCat("cannot publish ", target.Unit(id)), error);
  return absl::OkStatus();
}

// What the units of a store were planned and made with.
absl::Status CopyRecords(const std::string& store, const RunDirectory& target) {
  RS_ASSIGN_OR_RETURN(const std::vector<SweepGrid> grids, RunDirectory(store).Grids());
  for (const SweepGrid& grid : grids) {
    const std::string text = DumpConfig(grid);
    RS_RETURN_IF_ERROR(WriteFileAtomically(
        absl::StrCat(target.path(), "/grids/", Sha256Hex(text).substr(0, 12), ".yaml"), text));
    if (!fs::exists(target.path() + "/sweep.yaml"))
      RS_RETURN_IF_ERROR(WriteFileAtomically(target.path() + "/sweep.yaml", text));
  }
  std::error_code error;
  for (const char* folder : {"/plan", "/scenarios"}) {
    for (const auto& entry : fs::directory_iterator(store + folder, error)) {
      RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(entry.path().string()));
      RS_RETURN_IF_ERROR(MakeDirectories(target.path() + folder));
      RS_RETURN_IF_ERROR(WriteFileAtomically(
          absl::StrCat(target.path(), folder, "/", entry.path().filename().string()), text));
    }
  }
  return absl::OkStatus();
}

}  // namespace

std::string FindingsText(const std::vector<StoreFinding>& findings) {
  std::string text;
  for (const StoreFinding& finding : findings) {
    absl::StrAppend(&text, StoreFaultName(finding.fault), ": ", finding.store,
                    finding.unit.empty() || finding.store.empty() ? "" : "/", finding.unit,
                    finding.store.empty() && finding.unit.empty() ? "" : ": ", finding.text, "\n");
  }
  return text;
}

absl::StatusOr<MergeResult> MergeStores(const std::vector<std::string>& stores,
                                        const std::string& target) {
  const RunDirectory merged(target);
  std::vector<std::string> all = stores;
  std::error_code error;
  const bool exists = fs::is_directory(target + "/units", error);
  if (exists) all.insert(all.begin(), target);
  RS_ASSIGN_OR_RETURN(const StoreContents contents, CheckStores(all));
  MergeResult result;
  result.findings = contents.findings;
  std::vector<StoreFinding> bad;
  std::copy_if(contents.findings.begin(), contents.findings.end(), std::back_inserter(bad),
               [](const StoreFinding& finding) { return IsBad(finding.fault); });
  if (!bad.empty()) {
    return absl::FailedPreconditionError(absl::StrCat("nothing was merged:\n", FindingsText(bad)));
  }
  RS_ASSIGN_OR_RETURN(const FileLock lock, merged.Lock());
  for (const char* folder : {"/units", "/grids"})
    RS_RETURN_IF_ERROR(MakeDirectories(target + folder));
  std::set<std::string> present;
  for (const StoredUnit& unit : contents.units) {
    const std::string& id = unit.inspection.unit.id;
    if (!unit.inspection.finished || !present.insert(id).second) continue;
    if (exists && unit.store == target) {
      ++result.present;
      continue;
    }
    RS_RETURN_IF_ERROR(CopyUnit(absl::StrCat(unit.store, "/units/", id), merged, id));
    ++result.copied;
  }
  for (const std::string& store : stores) RS_RETURN_IF_ERROR(CopyRecords(store, merged));
  fs::remove_all(target + "/merging", error);
  return result;
}

}  // namespace robostress
