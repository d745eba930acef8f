#include "tests/eval/launch/random_kills.h"

#include <poll.h>
#include <signal.h>

#include <algorithm>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

struct Process {
  int pid = 0;
  std::string kind;  // sweep, worker, serve
};

std::vector<int> Children(int pid) {
  std::vector<int> children;
  const std::string text =
      ReadFile(absl::StrCat("/proc/", pid, "/task/", pid, "/children")).value_or("");
  for (absl::string_view word : absl::StrSplit(text, ' ', absl::SkipEmpty())) {
    int child = 0;
    if (absl::SimpleAtoi(word, &child)) children.push_back(child);
  }
  return children;
}

int FinishedUnits(const std::string& run) {
  int count = 0;
  std::error_code error;
  for (const char* folder : {"/units", "/parts"}) {
    for (const auto& entry : fs::recursive_directory_iterator(run + folder, error))
      count += entry.path().filename() == "DONE";
  }
  return count;
}

class Killer {
 public:
  explicit Killer(const KillPlan& plan)
      : plan_(plan), random_(StreamKey("kills").With(static_cast<int64_t>(plan.seed))) {}

  absl::StatusOr<KillResult> Run() {
    RS_ASSIGN_OR_RETURN(ChildProcess first, StartSweep("undisturbed"));
    if (const ExitState end = first.WaitForEnd(); end.code != 0) {
      return absl::InternalError(absl::StrCat("the undisturbed sweep: ", end.text, "\n",
                                              LastLines(Log("undisturbed"), 20)));
    }
    RS_ASSIGN_OR_RETURN(const std::string wanted,
                        ReadFile(plan_.folder + "/undisturbed/episodes.csv"));
    while (result_.Kills() < plan_.kills) {
      const std::string name = absl::StrCat("killed-", result_.runs);
      RS_RETURN_IF_ERROR(Complete(name));
      ++result_.runs;
      RS_ASSIGN_OR_RETURN(const std::string table,
                          ReadFile(absl::StrCat(plan_.folder, "/", name, "/episodes.csv")));
      if (table == wanted) continue;
      return absl::DataLossError(absl::StrCat(plan_.folder, "/", name, "/episodes.csv is not ",
                                              plan_.folder, "/undisturbed/episodes.csv after ",
                                              result_.Kills(), " kills"));
    }
    return result_;
  }

 private:
  std::string Log(const std::string& name) const { return plan_.folder + "/" + name + ".log"; }

  absl::StatusOr<ChildProcess> StartSweep(const std::string& name) {
    std::vector<std::string> command = {plan_.sweep};
    command.insert(command.end(), plan_.arguments.begin(), plan_.arguments.end());
    command.insert(command.end(), {"--no-report", "--out", plan_.folder + "/" + name});
    return ChildProcess::Start(command, {{"ROBOSTRESS_BIN", plan_.programs}}, Log(name));
  }

  // Until the same command says that everything is done.
  absl::Status Complete(const std::string& name) {
    int pause_ms = plan_.longest_pause_ms;
    for (int finished = 0;;) {
      ++result_.commands;
      RS_ASSIGN_OR_RETURN(ChildProcess sweep, StartSweep(name));
      while (result_.Kills() < plan_.kills) {
        pollfd end{sweep.exit_fd(), POLLIN, 0};
        if (poll(&end, 1, static_cast<int>(pause_ms * random_.Uniform())) == 1) break;
        KillOne(sweep.pid());
      }
      const ExitState end = sweep.WaitForEnd();
      if (end.code == 0) return absl::OkStatus();
      if (end.code == 2) {
        return absl::InternalError(absl::StrCat("the sweep refuses: ", LastLines(Log(name), 20)));
      }
      const int now = FinishedUnits(plan_.folder + "/" + name);
      pause_ms = now > finished ? plan_.longest_pause_ms : 2 * pause_ms;
      finished = now;
      if (result_.Kills() >= plan_.kills && ++commands_after_ > 3) {
        return absl::InternalError(absl::StrCat(
            "without kills the same command does not complete it: ", LastLines(Log(name), 20)));
      }
    }
  }

  void KillOne(int sweep) {
    std::vector<Process> processes = {{sweep, "sweep"}};
    for (const int child : Children(sweep)) {
      const std::string command = ReadFile(absl::StrCat("/proc/", child, "/cmdline")).value_or("");
      if (absl::StrContains(command, "robostress-worker")) processes.push_back({child, "worker"});
      if (absl::StrContains(command, "robostress-serve")) processes.push_back({child, "serve"});
    }
    const size_t drawn =
        std::min(processes.size() - 1, static_cast<size_t>(random_.Uniform() * processes.size()));
    const Process& victim = processes[drawn];
    if (kill(victim.pid, SIGKILL) != 0) return;
    result_.sweeps_killed += victim.kind == "sweep";
    result_.workers_killed += victim.kind == "worker";
    result_.servers_killed += victim.kind == "serve";
  }

  const KillPlan& plan_;
  RandomStream random_;
  KillResult result_;
  int commands_after_ = 0;
};

}  // namespace

absl::StatusOr<KillResult> KillAtRandom(const KillPlan& plan) { return Killer(plan).Run(); }

}  // namespace robostress
