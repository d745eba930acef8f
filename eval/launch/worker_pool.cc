#include "eval/launch/worker_pool.h"

#include <poll.h>

#include "absl/strings/str_cat.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "common/unit/robots.h"
#include "eval/launch/server_process.h"
#include "eval/store/processor_kind.h"

namespace robostress {

absl::Status WorkerPool::Start(const WorkItem& item) {
  RS_ASSIGN_OR_RETURN(const RobotInfo robot, FindRobot(item.unit->config.robot));
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram(robot.worker));
  RS_RETURN_IF_ERROR(PublishItem(run_, item));
  const std::string folder = item.Folder(run_);
  std::vector<std::string> command = {program, "--unit", run_.PlanFile(item.unit->id), "--out",
                                      folder};
  if (item.IsPart()) command.insert(command.end(), {"--episodes", item.Range()});
  ServerPlace place;
  const std::string& policy = item.unit->config.policy;
  if (!RunsInWorker(policy)) {
    RS_ASSIGN_OR_RETURN(place, servers_.Find(policy));
    command.insert(command.end(), {"--server", place.address});
  }
  if (options_.measure_lag) command.push_back("--lag");
  if (options_.record_joints) command.push_back("--record-joints");
  if (options_.record_views > 0)
    command.insert(command.end(), {"--record-episodes", absl::StrCat(options_.record_views)});
  RS_RETURN_IF_ERROR(RecordMachines(folder, ThisProcessor().Text(), place.machine));
  RS_ASSIGN_OR_RETURN(ChildProcess process,
                      ChildProcess::Start(command, ChildEnvironment(), run_.Log(item.Name())));
  running_.push_back({item, place, std::move(process)});
  progress_.Start(item.Name());
  return absl::OkStatus();
}

void WorkerPool::WaitForEvent() {
  std::vector<pollfd> items = {{signals_.fd(), POLLIN, 0}};
  for (const Running& worker : running_) items.push_back({worker.process.exit_fd(), POLLIN, 0});
  for (const int fd : servers_.wake_fds()) items.push_back({fd, POLLIN, 0});
  poll(items.data(), items.size(), 1000);
}

absl::Status WorkerPool::Collect(PoolOutcome& outcome) {
  for (auto worker = running_.begin(); worker != running_.end();) {
    const std::optional<ExitState> exit = worker->process.Poll();
    if (!exit) {
      ++worker;
      continue;
    }
    const WorkItem item = worker->item;
    const std::string name = item.Name();
    const bool failed = exit->code != 0 || !item.Done(run_);
    const bool served = !worker->place.address.empty();
    if (failed && exit->signal != 0 && kills_[name]++ < options_.kills_per_item) {
      progress_.Say(absl::StrCat("unit ", name, ": its worker was ", exit->text,
                                 "; another one goes on with the episode that it was in"));
      waiting_.push_front(item);
    } else if (failed && served && losses_ < options_.server_losses &&
               servers_.Lost(item.unit->config.policy, worker->place)) {
      ++losses_;
      progress_.Say(absl::StrCat("unit ", name, ": its server ", worker->place.address,
                                 " is gone; it goes on with another one"));
      waiting_.push_front(item);
    } else if (failed) {
      outcome.failed.push_back(name);
      progress_.Finish(name, true);
      progress_.Say(absl::StrCat("unit ", name, " failed (", exit->text,
                                 exit->code == 0 ? ", but it left no DONE" : "", "). Its log ",
                                 run_.Log(name), " ends:\n", LastLines(run_.Log(name), 12)));
    } else {
      ++outcome.completed;
      progress_.Finish(name, false);
      if (item.IsPart()) RS_RETURN_IF_ERROR(JoinParts(run_, *item.unit));
    }
    worker = running_.erase(worker);
  }
  return absl::OkStatus();
}

absl::Status WorkerPool::Run(const std::vector<WorkItem>& items, PoolOutcome& outcome) {
  waiting_.assign(items.begin(), items.end());
  absl::Status status;
  while (status.ok() && (!waiting_.empty() || !running_.empty())) {
    while (status.ok() && !waiting_.empty() &&
           static_cast<int>(running_.size()) < options_.workers) {
      const WorkItem item = waiting_.front();
      waiting_.pop_front();
      status = Start(item);
    }
    progress_.Show();
    if (status.ok()) WaitForEvent();
    if (signals_.Received() != 0) {
      outcome.signal = signals_.Received();
      progress_.Say(
          "interrupted: the units that run are stopped; the same command completes them later");
      break;
    }
    if (status.ok()) status = servers_.Check();
    if (status.ok()) status = Collect(outcome);
    if (status.ok()) status = servers_.Check();
  }
  progress_.End();
  running_.clear();  // stops the workers that still run, before their servers
  return status;
}

}  // namespace robostress
