// robostress-grid-job: what the jobs of a scheduler run, started by the scripts and manifests that
// `robostress sweep --launcher slurm|kubernetes` writes.

#include <poll.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/launch/exit_code.h"
#include "eval/launch/merged_sweep.h"
#include "eval/launch/progress.h"
#include "eval/launch/published_servers.h"
#include "eval/launch/server_process.h"
#include "eval/launch/submission.h"
#include "eval/report/report.h"
#include "eval/store/environment.h"
#include "eval/store/processor_kind.h"

namespace robostress {
namespace {

constexpr char kExamples[] =
    "\nExamples (of Slurm; the arguments come from the scripts that a sweep has written)\n"
    "  robostress grid-job serve --submission RUN/submissions/0001 --policy nano --index 0\n"
    "  robostress grid-job work  --submission RUN/submissions/0001 --index $SLURM_ARRAY_TASK_ID\n"
    "  robostress grid-job merge --submission RUN/submissions/0001\n\n"
    "Exit code: 0 done; 1 a unit failed; 2 the command is wrong; 75 no server answered, worth "
    "another try; 128 + signal when\n"
    "stopped. Whatever the end, the same command does what is missing.\n";

struct CommandLine {
  std::string submission, policy, host;
  int index = 0, tries = 0;
  double patience_s = 600;
  bool wait = false;
};

std::string HostName() {
  char name[256] = "localhost";
  gethostname(name, sizeof(name) - 1);
  return name;
}

// Waits until every worker task has left, a signal comes (returned) or `exit_fd` is readable.
int WaitForTasks(const Submission& submission, SignalGuard& signals, int exit_fd) {
  while (submission.TasksThatLeft() < submission.tasks()) {
    pollfd items[] = {{signals.fd(), POLLIN, 0}, {exit_fd, POLLIN, 0}};
    poll(items, 2, 2000);
    if (signals.Received() != 0) return signals.Received();
    if (items[1].revents != 0) break;
  }
  return 0;
}

absl::StatusOr<int> Serve(const Submission& submission, const CommandLine& line) {
  SignalGuard signals;
  ServerStart start;
  start.policy = line.policy;
  start.label = absl::StrCat(PolicyLabel(line.policy), "-", line.index);
  start.log_folder = submission.run().path() + "/logs";
  start.threads = submission.server_threads();
  std::string host = !line.host.empty() ? line.host : submission.server_host();
  start.listen = host == "127.0.0.1" ? "127.0.0.1:0" : "0.0.0.0:0";
  if (host.empty()) host = HostName();
  RS_ASSIGN_OR_RETURN(ServerProcess server, StartServer(start, signals));
  const ServerPlace place = {absl::StrCat(host, ":", server.port), ThisProcessor().Text()};
  RS_RETURN_IF_ERROR(PublishServer(submission, line.policy, line.index, place));
  std::printf("%s serves %s\n", place.address.c_str(), line.policy.c_str());
  std::fflush(stdout);
  int signal = WaitForTasks(submission, signals, server.process.exit_fd());
  if (signal == 0) signal = signals.Received();  // a scheduler sends it to every process of a job
  std::error_code ignored;
  std::filesystem::remove(submission.ServerFile(line.policy, line.index), ignored);
  if (const std::optional<ExitState> exit = server.process.Poll(); exit && signal == 0) {
    return absl::UnavailableError(absl::StrCat("the server ended (", exit->text, "). Its log ",
                                               server.log, " ends:\n", LastLines(server.log, 15)));
  }
  server.process.Terminate(20000);
  return signal == 0 ? kExitDone : 128 + signal;
}

absl::StatusOr<int> Work(const Submission& submission, const CommandLine& line) {
  SignalGuard signals;
  std::vector<WorkItem> items;
  for (const WorkItem& item : submission.Share(line.index)) {
    if (!item.Done(submission.run())) items.push_back(item);
  }
  Progress progress(Progress::Output::kAutomatic);
  for (const WorkItem& item : items) {
    progress.Expect(item.Name(), item.Folder(submission.run()) + "/episodes.jsonl", item.count);
  }
  PublishedServers servers(submission, line.index, line.patience_s, signals);
  WorkerPool pool(submission.run(), submission.pool(), servers, signals, progress);
  PoolOutcome outcome;
  const absl::Status status = pool.Run(items, outcome);
  if (outcome.signal != 0) return 128 + outcome.signal;
  if (absl::IsCancelled(status) && signals.Received() != 0) return 128 + signals.Received();
  if (absl::IsUnavailable(status)) {
    std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
    return kExitTryAgain;
  }
  RS_RETURN_IF_ERROR(status);
  for (const std::string& name : outcome.failed)
    std::fprintf(stderr, "FAILED %s (%s)\n", name.c_str(), submission.run().Log(name).c_str());
  const int code = outcome.failed.empty() ? kExitDone : kExitUnitFailed;
  RS_RETURN_IF_ERROR(submission.Leave(line.index, code));
  return code;
}

// As Work, for a scheduler that starts a failed task again until its `tries` are used up, and never
// where the command is wrong: then nobody must wait for that task. A stop is no failure.
absl::StatusOr<int> WorkOrGiveUp(const Submission& submission, const CommandLine& line) {
  if (line.index < 0 || line.index >= submission.tasks()) {
    return absl::InvalidArgumentError(absl::StrCat("--index ", line.index,
                                                   " is no task of this submission; it has 0 to ",
                                                   submission.tasks() - 1));
  }
  absl::StatusOr<int> result = Work(submission, line);
  const int code = result.ok() ? *result : ExitCodeOfError(result.status());
  if (line.tries == 0 || code == kExitDone || code > 128) return result;
  RS_ASSIGN_OR_RETURN(const int failures, submission.CountFailure(line.index));
  if (failures >= line.tries || code == kExitWrongCommand)
    RS_RETURN_IF_ERROR(submission.Leave(line.index, code));
  return result;
}

absl::StatusOr<int> Merge(const Submission& submission, const CommandLine& line) {
  SignalGuard signals;
  if (line.wait) {
    if (const int signal = WaitForTasks(submission, signals, -1); signal != 0) return 128 + signal;
  }
  int missing = 0;
  for (const PlannedUnit& unit : submission.UnitsOfItems()) {
    RS_RETURN_IF_ERROR(JoinParts(submission.run(), unit));
    if (submission.run().Done(unit.id)) continue;
    ++missing;
    std::fprintf(stderr, "not done: %s (%s)\n", unit.id.c_str(),
                 submission.run().Log(unit.id).c_str());
  }
  RS_RETURN_IF_ERROR(WriteEnvironment(submission.run().path()));
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(submission.run().path()));
  RS_RETURN_IF_ERROR(WriteTables(run));
  RS_RETURN_IF_ERROR(WriteReport(run, ReportOptions()));
  return missing == 0 ? kExitDone : kExitUnitFailed;
}

int Main(int argc, char** argv) {
  cli::App app("Runs one job of a grid that a scheduler distributes.", "robostress grid-job");
  app.footer(kExamples);
  app.require_subcommand(1);
  CommandLine line;
  const auto add = [&](const char* name, const char* help) {
    cli::App* command = app.add_subcommand(name, help);
    command->add_option("--submission", line.submission, "Folder of the submission")->required();
    return command;
  };
  cli::App* serve = add("serve", "Serve a policy until every worker task has left");
  serve->add_option("--policy", line.policy, "Policy to serve")->required();
  serve->add_option("--index", line.index, "Which of the policy's servers");
  serve->add_option("--host", line.host, "Name or address to publish (default: this machine's)");
  cli::App* work = add("work", "Run one task's share of the units");
  work->add_option("--index", line.index, "Which worker task")->required();
  work->add_option("--patience", line.patience_s, "Seconds to wait for a server")
      ->capture_default_str();
  work->add_option("--tries", line.tries,
                   "How often the scheduler starts a task that fails (default: not said); after "
                   "the last nobody waits for it")
      ->check(cli::Range(0, 1000));
  cli::App* merge = add("merge", "Merge the tables and write the report");
  merge->add_flag("--wait", line.wait, "First wait until every worker task has left");
  const auto run = [&]() -> absl::StatusOr<int> {
    ChooseOpenMpBlas();
    RS_ASSIGN_OR_RETURN(const std::unique_ptr<Submission> submission,
                        Submission::Open(line.submission));
    if (serve->parsed()) return Serve(*submission, line);
    if (work->parsed()) return WorkOrGiveUp(*submission, line);
    return Merge(*submission, line);
  };
  return RunMain(app, argc, argv, run, ExitCodeOfError);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
