#include "eval/launch/slurm_launcher.h"

#include <poll.h>

#include <algorithm>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/program_folder.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

std::string Quoted(const std::string& text) {
  return absl::StrCat("'", absl::StrReplaceAll(text, {{"'", "'\\''"}}), "'");
}

// What every script begins with; arguments after --requeue come from the command line of sbatch.
std::string Head(const Submission& submission, const std::string& kind) {
  // Slurm splits at spaces, and replaces %x, in what #SBATCH says.
  const std::string folder =
      absl::StrReplaceAll(submission.run().path(), {{"%", "%%"}, {"\\", "\\\\"}, {"\"", "\\\""}});
  const std::string log = absl::StrCat("\"", folder, "/logs/slurm-", submission.name(), "-", kind,
                                       kind == "merge" ? "" : "-%a", ".log\"");
  return absl::StrCat("#!/bin/bash\n#SBATCH --job-name=", SlurmJobName(submission.run()), "-", kind,
                      "\n#SBATCH --requeue\n#SBATCH --open-mode=append\n#SBATCH --output=", log,
                      "\nexport ROBOSTRESS_BIN=", Quoted(ProgramFolder()), "\ncd ",
                      Quoted(fs::current_path().string()), "\n");
}

std::string GridJob(const Submission& submission, const std::string& command) {
  const absl::StatusOr<std::string> program = FindProgram("grid-job");
  return absl::StrCat(Quoted(program.value_or("robostress-grid-job")), " ", command,
                      " --submission ", Quoted(submission.folder()));
}

// Runs a command of Slurm; its output. NotFound where it is not installed, Unavailable when it
// fails. The output goes through a file, as that of every process here.
absl::StatusOr<std::string> Ask(const RunDirectory& run, std::vector<std::string> command) {
  const std::string file = run.path() + "/logs/slurm-command.txt";
  std::error_code ignored;
  fs::remove(file, ignored);
  const std::string text = absl::StrJoin(command, " ");
  command.insert(command.begin(), "/usr/bin/env");
  RS_ASSIGN_OR_RETURN(ChildProcess process, ChildProcess::Start(command, {}, file));
  const ExitState exit = process.WaitForEnd();
  const std::string output = ReadFile(file).value_or("");
  if (exit.code == 0) return std::string(absl::StripAsciiWhitespace(output));
  const std::string message =
      absl::StrCat("`", text, "` failed (", exit.text, "): ", absl::StripAsciiWhitespace(output));
  constexpr int kNoSuchProgram = 127;  // of env
  if (exit.code == kNoSuchProgram) return absl::NotFoundError(message);
  return absl::UnavailableError(message);
}

// Submits a script of the submission's folder; the job's id.
absl::StatusOr<std::string> Submit(const Submission& submission, const std::string& name,
                                   const std::string& script, std::vector<std::string> arguments) {
  const std::string file = absl::StrCat(submission.folder(), "/", name);
  RS_RETURN_IF_ERROR(WriteFileAtomically(file, script));
  arguments.insert(arguments.begin(), {"sbatch", "--parsable"});
  arguments.push_back(file);
  RS_ASSIGN_OR_RETURN(const std::string answer, Ask(submission.run(), arguments));
  const std::vector<std::string> fields = absl::StrSplit(answer, ';');  // ID[;CLUSTER]
  return fields[0];
}

std::vector<std::string> With(std::vector<std::string> arguments,
                              const std::vector<std::string>& more) {
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

absl::Status SubmitAll(const Submission& submission, const LaunchOptions& options) {
  const ClusterOptions& cluster = options.cluster;
  std::vector<std::string> servers;
  for (const std::string& policy : submission.ServedPolicies()) {
    RS_ASSIGN_OR_RETURN(const std::string id,
                        Submit(submission, absl::StrCat("serve-", PolicyLabel(policy), ".sh"),
                               ServeScript(submission, policy),
                               With({absl::StrCat("--array=0-", submission.servers() - 1),
                                     absl::StrCat("--cpus-per-task=", submission.server_threads())},
                                    cluster.slurm_server)));
    servers.push_back(id);
  }
  std::vector<std::string> work = {
      absl::StrCat("--array=0-", submission.tasks() - 1, "%", std::max(1, options.workers)),
      absl::StrCat("--cpus-per-task=", submission.pool().workers)};
  // Workers that hold every core before the servers run would wait for ever.
  if (!servers.empty())
    work.push_back(absl::StrCat("--dependency=after:", absl::StrJoin(servers, ":")));
  RS_ASSIGN_OR_RETURN(
      const std::string workers,
      Submit(submission, "work.sh", WorkScript(submission), With(work, cluster.slurm_worker)));
  return Submit(submission, "merge.sh", MergeScript(submission),
                With({absl::StrCat("--dependency=afterany:", workers)}, cluster.slurm_merge))
      .status();
}

// Shows what is done until nothing of the run is in the queue.
absl::Status WaitForQueue(const LaunchRequest& request, LaunchResult& result) {
  constexpr size_t kLooks = 2000;  // items looked at per round: a shared file system is slow
  std::vector<const WorkItem*> open;
  for (const WorkItem& item : request.items) open.push_back(&item);
  bool in_queue = true;
  for (size_t at = 0; in_queue;) {
    pollfd item{request.signals.fd(), POLLIN, 0};
    poll(&item, 1, 1000 * std::max(1, request.options.cluster.poll_s));
    if (request.signals.Received() != 0) {
      result.outcome.signal = request.signals.Received();
      break;
    }
    // A controller that does not answer for a while knows the jobs again later.
    const absl::StatusOr<std::string> jobs = SlurmJobsInQueue(request.run);
    in_queue = !jobs.ok() || !jobs->empty();
    for (size_t looks = in_queue ? std::min(kLooks, open.size()) : open.size(); looks > 0;
         --looks) {
      if (at >= open.size()) at = 0;
      if (!open[at]->Done(request.run)) {
        ++at;
        continue;
      }
      ++result.outcome.completed;
      request.progress.Finish(open[at]->Name(), false);
      open[at] = open.back();
      open.pop_back();
    }
    request.progress.Show();
  }
  request.progress.End();
  if (in_queue) return absl::OkStatus();
  for (const WorkItem* item : open) result.outcome.failed.push_back(item->Name());
  std::sort(result.outcome.failed.begin(), result.outcome.failed.end());
  return absl::OkStatus();
}

}  // namespace

std::string SlurmJobName(const RunDirectory& run) {
  const std::string path = fs::absolute(run.path()).lexically_normal().string();
  return absl::StrCat("robostress-", Sha256Hex(path).substr(0, 10));
}

absl::StatusOr<std::string> SlurmJobsInQueue(const RunDirectory& run) {
  const std::string name = SlurmJobName(run);
  const absl::StatusOr<std::string> jobs =
      Ask(run, {"squeue", "--noheader", "--format=%i",
                absl::StrCat("--name=", name, "-serve,", name, "-work,", name, "-merge")});
  if (absl::IsNotFound(jobs.status())) return "";
  RS_RETURN_IF_ERROR(jobs.status());
  return absl::StrReplaceAll(*jobs, {{"\n", " "}});
}

std::string ServeScript(const Submission& submission, const std::string& policy) {
  return absl::StrCat(Head(submission, "serve"), "exec ", GridJob(submission, "serve"),
                      " --policy ", Quoted(policy), " --index \"$SLURM_ARRAY_TASK_ID\"\n");
}

std::string WorkScript(const Submission& submission) {
  return absl::StrCat(
      Head(submission, "work"), GridJob(submission, "work"),
      " --index \"$SLURM_ARRAY_TASK_ID\"\ncode=$?\n"
      "# 75: no server answered, perhaps because its job was preempted; later there may be one.\n"
      "if [ \"$code\" -eq 75 ] && [ \"${SLURM_RESTART_COUNT:-0}\" -lt 50 ]; then\n"
      "  scontrol requeue \"$SLURM_JOB_ID\"\n"
      "fi\n"
      "exit \"$code\"\n");
}

std::string MergeScript(const Submission& submission) {
  return absl::StrCat(Head(submission, "merge"),
                      "# Servers of tasks that were killed for good would stay.\n"
                      "scancel --name=",
                      SlurmJobName(submission.run()), "-serve\nexec ", GridJob(submission, "merge"),
                      "\n");
}

absl::StatusOr<LaunchResult> SlurmLauncher::Launch(const LaunchRequest& request) {
  RS_RETURN_IF_ERROR(FindProgram("grid-job").status());
  RS_RETURN_IF_ERROR(Ask(request.run, {"sbatch", "--version"}).status());
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Submission> submission, Submission::Create(request));
  if (const absl::Status status = SubmitAll(*submission, request.options); !status.ok()) {
    const std::string name = SlurmJobName(request.run);
    Ask(request.run, {"scancel", absl::StrCat("--name=", name, "-serve,", name, "-work")})
        .IgnoreError();
    return status;
  }
  LaunchResult result;
  result.submitted = !request.options.cluster.wait;
  if (request.options.cluster.wait) RS_RETURN_IF_ERROR(WaitForQueue(request, result));
  if (result.submitted || result.outcome.signal != 0) {
    result.hint = absl::StrCat(
        submission->tasks(),
        " worker tasks are in the queue; `squeue --name=", SlurmJobName(request.run),
        "-work` shows them, the report comes by itself, and the same command submits what is "
        "missing once they have left");
  }
  return result;
}

}  // namespace robostress
