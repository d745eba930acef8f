#include "common/suites.h"

#include <deque>

#include "absl/base/thread_annotations.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "common/libero/task_folder.h"
#include "common/status_macros.h"
#include "common/unit_config.h"

namespace robostress {
namespace {

constexpr int kFolderHorizon = 400;
constexpr int kMostStates = 10000;  // of a task folder's file

struct AddedSuite {
  SuiteInfo info;
  std::string folder;
};

struct AddedSuites {
  absl::Mutex mu;
  std::deque<AddedSuite> suites ABSL_GUARDED_BY(mu);  // whose elements stay where they are
};

AddedSuites& Added() {
  static AddedSuites& added = *new AddedSuites();
  return added;
}

const SuiteInfo* FindBuiltIn(const std::string& name) {
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.name == name) return &suite;
  }
  return nullptr;
}

}  // namespace

const std::vector<SuiteInfo>& AllSuites() {
  static const std::vector<SuiteInfo>& suites = *new std::vector<SuiteInfo>{
      {"tabletop_spatial", "Spatial", 10, 220, 50, false},
      {"tabletop_object", "Object", 10, 280, 50, false},
      {"tabletop_goal", "Goal", 10, 300, 50, false},
      {"tabletop_long", "Long", 10, 520, 50, false},
      {"libero_spatial", "LIBERO-Spatial", 10, 220, 50, true},
      {"libero_object", "LIBERO-Object", 10, 280, 50, true},
      {"libero_goal", "LIBERO-Goal", 10, 300, 50, true},
      {"libero_10", "LIBERO-Long", 10, 520, 50, true},
      // The paper's real-arm tasks; each is a suite, because each has a session of its own.
      {"piper_1_next_to_plate", "1 bowl next to the plate", 1, 450, 1000, false, "piper"},
      {"piper_2_on_cabinet", "2 bowl on the cabinet", 1, 450, 1000, false, "piper"},
      {"piper_3_on_box", "3 bowl on the box", 1, 450, 1000, false, "piper"},
      {"piper_4_open_drawer", "4 top drawer", 1, 450, 1000, false, "piper"},
      {"piper_unseen", "unseen objects", 5, 450, 1000, false, "piper", true},
  };
  return suites;
}

absl::StatusOr<std::string> AddTaskFolder(const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const LiberoTaskFolder read, ReadLiberoTaskFolder(folder));
  SuiteInfo info;
  info.name = info.title = read.suite;
  info.num_tasks = static_cast<int>(read.tasks.size());
  info.horizon = kFolderHorizon;
  info.num_initial_states = kMostStates;
  info.needs_libero = true;
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.needs_libero && absl::StartsWith(read.suite, suite.name + "_"))
      info.horizon = suite.horizon;
  }
  AddedSuites& added = Added();
  const absl::MutexLock lock(&added.mu);
  std::string taken =
      FindBuiltIn(read.suite) != nullptr ? "a suite that comes with this program" : "";
  for (const AddedSuite& suite : added.suites) {
    if (suite.folder == read.path) return read.suite;
    if (suite.info.name == read.suite) taken = suite.folder;
  }
  if (!taken.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "task folder ", read.path, " would be suite '", read.suite, "', which is the name of ",
        taken, "; give the folder, or a link to it, another name"));
  }
  added.suites.push_back({std::move(info), read.path});
  return read.suite;
}

std::string TaskFolderOf(const std::string& suite) {
  AddedSuites& added = Added();
  const absl::MutexLock lock(&added.mu);
  for (const AddedSuite& one : added.suites) {
    if (one.info.name == suite) return one.folder;
  }
  return "";
}

bool IsLiberosOwn(const std::string& suite) {
  const SuiteInfo* info = FindSuite(suite);
  return info != nullptr && info->needs_libero && TaskFolderOf(suite).empty();
}

std::vector<std::string> SuitesOf(const std::string& robot) {
  std::vector<std::string> names;
  for (const SuiteInfo& suite : AllSuites()) {
    if (suite.robot == robot) names.push_back(suite.name);
  }
  AddedSuites& added = Added();
  const absl::MutexLock lock(&added.mu);
  for (const AddedSuite& suite : added.suites) {
    if (suite.info.robot == robot) names.push_back(suite.info.name);
  }
  return names;
}

const SuiteInfo* FindSuite(const std::string& name) {
  if (const SuiteInfo* suite = FindBuiltIn(name)) return suite;
  AddedSuites& added = Added();
  const absl::MutexLock lock(&added.mu);
  for (const AddedSuite& suite : added.suites) {
    if (suite.info.name == name) return &suite.info;
  }
  return nullptr;
}

int HorizonOf(const UnitConfig& unit) {
  const SuiteInfo* suite = FindSuite(unit.suite);
  return unit.horizon > 0 || suite == nullptr ? unit.horizon : suite->horizon;
}

}  // namespace robostress
