#include "eval/launch/submission.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <unordered_map>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

int NextNumber(const std::string& folder) {
  int last = 0;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    int number = 0;
    if (absl::SimpleAtoi(entry.path().filename().string(), &number)) last = std::max(last, number);
  }
  return last + 1;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Submission>> Submission::Create(const LaunchRequest& request) {
  const ClusterOptions& cluster = request.options.cluster;
  const std::string run_dir = fs::absolute(request.run.path()).lexically_normal().string();
  const std::string all = run_dir + "/submissions";
  RS_RETURN_IF_ERROR(MakeDirectories(all));
  const std::string folder = absl::StrCat(all, absl::StrFormat("/%04d", NextNumber(all)));
  for (const char* part : {"", "/servers", "/left"})
    RS_RETURN_IF_ERROR(MakeDirectories(folder + part));
  std::string items;
  for (const WorkItem& item : request.items) {
    absl::StrAppend(&items, item.unit->id, "\t", item.first, "\t", item.count, "\t",
                    item.part_episodes, "\n");
  }
  const int tasks = std::min<int>(request.items.size(), std::max(1, cluster.max_tasks));
  const int workers = std::max(1, request.options.workers);
  const int threads = cluster.server_threads > 0
                          ? cluster.server_threads
                          : (workers + cluster.servers - 1) / cluster.servers;
  const json settings = {{"tasks", tasks},
                         {"servers", cluster.servers},
                         {"server_threads", threads},
                         {"server_host", cluster.server_host},
                         {"elsewhere", request.options.Elsewhere()},
                         {"workers_per_task", cluster.workers_per_task},
                         {"lag", request.options.measure_lag},
                         {"record_joints", request.options.record_joints},
                         {"record_views", request.options.record_views}};
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/grid.yaml", DumpConfig(request.grid)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/items.txt", items));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/settings.json", settings.dump(2) + "\n"));
  return Open(folder);
}

absl::StatusOr<std::unique_ptr<Submission>> Submission::Open(const std::string& folder) {
  const fs::path path = fs::absolute(folder).lexically_normal();
  std::unique_ptr<Submission> submission(
      new Submission(path.string(), path.parent_path().parent_path().string()));
  RS_RETURN_IF_ERROR(submission->Read());
  return submission;
}

absl::Status Submission::Read() {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(folder_ + "/settings.json"));
  const json settings = json::parse(text, nullptr, false);
  try {
    tasks_ = settings.at("tasks").get<int>();
    servers_ = settings.at("servers").get<int>();
    server_threads_ = settings.at("server_threads").get<int>();
    server_host_ = settings.at("server_host").get<std::string>();
    elsewhere_ = settings.at("elsewhere").get<std::vector<std::string>>();
    pool_.workers = settings.at("workers_per_task").get<int>();
    pool_.measure_lag = settings.at("lag").get<bool>();
    pool_.record_joints = settings.at("record_joints").get<bool>();
    pool_.record_views = settings.value("record_views", 0);
  } catch (const json::exception& error) {
    return absl::DataLossError(absl::StrCat(folder_, "/settings.json: ", error.what()));
  }
  if (tasks_ < 1 || servers_ < 0) {
    return absl::DataLossError(absl::StrCat(folder_, "/settings.json: tasks is ", tasks_,
                                            ", must be at least 1; servers is ", servers_,
                                            ", must be at least 0; submit again"));
  }
  RS_ASSIGN_OR_RETURN(const SweepGrid grid, LoadConfig<SweepGrid>(folder_ + "/grid.yaml"));
  RS_ASSIGN_OR_RETURN(units_, ExpandUnits(grid));
  std::unordered_map<std::string, const PlannedUnit*> by_id;
  for (const PlannedUnit& unit : units_) by_id[unit.id] = &unit;
  RS_ASSIGN_OR_RETURN(const std::string items, ReadFile(folder_ + "/items.txt"));
  for (absl::string_view line : absl::StrSplit(items, '\n', absl::SkipEmpty())) {
    const std::vector<std::string> fields = absl::StrSplit(line, '\t');
    WorkItem item;
    const auto unit = by_id.find(fields[0]);
    if (fields.size() != 4 || unit == by_id.end() || !absl::SimpleAtoi(fields[1], &item.first) ||
        !absl::SimpleAtoi(fields[2], &item.count) ||
        !absl::SimpleAtoi(fields[3], &item.part_episodes)) {
      return absl::DataLossError(
          absl::StrCat(folder_, "/items.txt: '", line, "' is no item of grid.yaml; submit again"));
    }
    item.unit = unit->second;
    items_.push_back(item);
  }
  return absl::OkStatus();
}

std::string Submission::name() const { return fs::path(folder_).filename().string(); }

std::vector<WorkItem> Submission::Share(int task) const {
  std::vector<WorkItem> share;
  for (size_t i = task; i < items_.size(); i += tasks_) share.push_back(items_[i]);
  return share;
}

std::vector<PlannedUnit> Submission::UnitsOfItems() const {
  std::set<std::string> ids;
  std::vector<PlannedUnit> units;
  for (const WorkItem& item : items_) {
    if (ids.insert(item.unit->id).second) units.push_back(*item.unit);
  }
  return units;
}

std::vector<std::string> Submission::ServedPolicies() const {
  std::set<std::string> policies;
  for (const WorkItem& item : items_) {
    const std::string& policy = item.unit->config.policy;
    if (!RunsInWorker(policy) && elsewhere_.empty()) policies.insert(policy);
  }
  return {policies.begin(), policies.end()};
}

std::string Submission::ServerFile(const std::string& policy, int index) const {
  return absl::StrCat(folder_, "/servers/", PolicyLabel(policy), "-", index, ".json");
}

absl::Status Submission::Leave(int task, int exit_code) const {
  return WriteFileAtomically(absl::StrCat(folder_, "/left/", task), absl::StrCat(exit_code, "\n"));
}

int Submission::TasksThatLeft() const {
  int count = 0, number = 0;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_ + "/left", error))
    count += absl::SimpleAtoi(entry.path().filename().string(), &number);
  return count;
}

absl::StatusOr<int> Submission::CountFailure(int task) const {
  const std::string file = absl::StrCat(folder_, "/failures/", task);
  int count = 0;
  if (fs::exists(file)) {
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(file, 100));
    if (!absl::SimpleAtoi(text, &count) || count < 0) count = 0;
  }
  RS_RETURN_IF_ERROR(MakeDirectories(folder_ + "/failures"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(file, absl::StrCat(++count, "\n")));
  return count;
}

}  // namespace robostress
