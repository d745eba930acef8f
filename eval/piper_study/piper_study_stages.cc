#include <algorithm>
#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/config.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "eval/launch/merged_sweep.h"
#include "eval/launch/server_process.h"
#include "eval/piper_study/piper_study.h"
#include "eval/piper_study/piper_study_page.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr int kPoll_ms = 100;

// A process that a stage waits for, and the file that says it is done.
struct Job {
  std::string name;
  std::vector<std::string> command;
  std::string done;
};

class Study {
 public:
  Study(const PiperStudyOptions& options, const PiperStudyLaunch& launch)
      : options_(options), launch_(launch), protocol_(ProtocolOf(options, launch.out)) {}

  // The exit code of the units.
  absl::StatusOr<int> Run() {
    // Names what is wrong before anything is recorded; the weights may not be there yet.
    RS_RETURN_IF_ERROR(PlanOf(options_, launch_, PolicyHome::kElsewhere).status());
    for (const char* folder : {"/demos", "/train", "/logs"})
      RS_RETURN_IF_ERROR(MakeDirectories(launch_.out + folder));
    RS_RETURN_IF_ERROR(KeepOptions());
    for (const std::string& stage : launch_.stages) {
      if (stage == "record") {
        RS_RETURN_IF_ERROR(Record());
      } else if (stage == "train") {
        RS_RETURN_IF_ERROR(Train());
      } else if (stage == "evaluate") {
        RS_ASSIGN_OR_RETURN(const int code, Evaluate());
        if (code != 0) return code;
      } else if (stage == "report") {
        RS_RETURN_IF_ERROR(Report());
      } else {
        return absl::InvalidArgumentError(absl::StrCat(
            "stage '", stage, "' is unknown; there are record, train, evaluate, report"));
      }
    }
    return 0;
  }

 private:
  std::string Out(const std::string& name) const { return absl::StrCat(launch_.out, "/", name); }
  bool given_weights() const { return !options_.base_weights.empty(); }

  // Results of different options cannot share a folder.
  absl::Status KeepOptions() {
    const std::string file = Out("study.yaml"), text = DumpConfig(options_);
    if (fs::exists(file)) {
      RS_ASSIGN_OR_RETURN(const std::string present, ReadFile(file));
      if (present == text) return absl::OkStatus();
      return absl::FailedPreconditionError(
          absl::StrCat(file, " is of a study with other options; repeat them (--config ", file,
                       ") or choose another --out"));
    }
    return WriteFileAtomically(file, text);
  }

  // Runs the jobs that are not done, launch_.workers at a time.
  absl::Status RunJobs(const std::vector<Job>& jobs, int workers) {
    struct Running {
      const Job* job;
      ChildProcess process;
    };
    std::deque<const Job*> waiting;
    for (const Job& job : jobs) {
      if (!fs::exists(job.done)) waiting.push_back(&job);
    }
    std::vector<Running> running;
    std::vector<std::string> failed;  // the others go on
    size_t finished = jobs.size() - waiting.size();
    while (!waiting.empty() || !running.empty()) {
      while (!waiting.empty() && static_cast<int>(running.size()) < workers) {
        const Job* const job = waiting.front();
        waiting.pop_front();
        RS_ASSIGN_OR_RETURN(ChildProcess process,
                            ChildProcess::Start(job->command, ChildEnvironment(), Log(job->name)));
        running.push_back({job, std::move(process)});
      }
      for (auto it = running.begin(); it != running.end();) {
        const std::optional<ExitState> exit = it->process.Poll();
        if (!exit) {
          ++it;
          continue;
        }
        if (exit->code != 0 || !fs::exists(it->job->done)) {
          failed.push_back(it->job->name);
          std::printf("piper-study: %s ended with %s; %s ends:\n%s\n", it->job->name.c_str(),
                      exit->text.c_str(), Log(it->job->name).c_str(),
                      LastLines(Log(it->job->name), 12).c_str());
          std::fflush(stdout);
          it = running.erase(it);
          continue;
        }
        std::printf("piper-study: %s done (%zu of %zu)\n", it->job->name.c_str(), ++finished,
                    jobs.size());
        std::fflush(stdout);
        it = running.erase(it);
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(kPoll_ms));
    }
    if (!failed.empty()) {
      return absl::InternalError(
          absl::StrCat(absl::StrJoin(failed, ", "), " failed; the same command tries again"));
    }
    return absl::OkStatus();
  }
  std::string Log(const std::string& name) const { return Out("logs/" + name + ".log"); }

  absl::Status Record() {
    if (given_weights()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("piper-worker"));
    std::vector<Job> jobs;
    for (const std::string& arm : options_.arms) {
      for (const int task : options_.tasks) {
        const std::string name = absl::StrCat(arm, "_", kPiperTasks[task - 1]);
        const std::string shard = Out(absl::StrCat("demos/", name, ".safetensors"));
        jobs.push_back({"record_" + name,
                        {program, "record", "--arm", arm, "--task", kPiperTasks[task - 1],
                         "--episodes", absl::StrCat(options_.demonstrations), "--out", shard},
                        shard});
      }
    }
    return RunJobs(jobs, launch_.workers);
  }

  absl::StatusOr<Job> TrainJob(const std::string& name, int64_t steps,
                               const std::vector<std::string>& settings) const {
    RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("train"));
    Job job{
        "train_" + name,
        {program, "--recipe",
         options_.recipe.empty() ? std::string(PiperRecipe()) : options_.recipe, "--data",
         Out("demos"), "--out", Out("train/" + name), "--resume", "--steps", absl::StrCat(steps)},
        Out("train/" + name + "/DONE")};
    for (const std::string& setting : settings) {
      job.command.push_back("--set");
      job.command.push_back(setting);
    }
    return job;
  }

  // One policy for all arms, as a lab with two arms of a kind may; then base and RobustVLA go on
  // from it with the same steps, batch, rates and seed.
  absl::Status Train() {
    if (given_weights()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const Job start, TrainJob("start", options_.train_steps,
                                                  {absl::StrCat("graft=", PiperGraft())}));
    RS_RETURN_IF_ERROR(RunJobs({start}, 1));
    const std::vector<std::string> go_on = {
        absl::StrCat("init=", Out("train/start/nano.safetensors")), "lr=0.0002", "warmup=10",
        "seed=32"};
    RS_ASSIGN_OR_RETURN(const Job base, TrainJob("base", options_.tune_steps, go_on));
    std::vector<std::string> worst = go_on;
    worst.push_back("objective=robust");
    RS_ASSIGN_OR_RETURN(const Job robust, TrainJob("robust", options_.tune_steps, worst));
    RS_RETURN_IF_ERROR(RunJobs({base, robust}, launch_.workers));
    RS_RETURN_IF_ERROR(Name(Out("train/base/nano.safetensors"), protocol_.base));
    return Name(Out("train/robust/nano.safetensors"), protocol_.robust);
  }

  // A policy is called by its file's name.
  static absl::Status Name(const std::string& weights, const std::string& as) {
    if (fs::exists(as)) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(weights));
    return WriteFileAtomically(as, bytes);
  }

  absl::StatusOr<int> Evaluate() {
    for (const std::string& weights : {protocol_.base, protocol_.robust}) {
      if (fs::exists(weights)) continue;
      return absl::NotFoundError(absl::StrCat(
          weights, " is missing: run the stages record and train first, or give weights"));
    }
    RS_ASSIGN_OR_RETURN(const std::vector<PiperTablePlan> plans,
                        PlanOf(options_, launch_, PolicyHome::kHere));
    LaunchOptions sweep;
    sweep.run_dir = launch_.RunFolder();
    sweep.workers = launch_.real_time ? 1 : launch_.workers;
    int code = 0;
    for (const PiperTablePlan& plan : plans) {
      for (const SweepGrid& grid : plan.grids) {
        RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
        RS_ASSIGN_OR_RETURN(const MergedSweep merged,
                            RunAndMerge("piper-study", grid, units, sweep));
        code = std::max(code, ExitCodeOf(merged.outcome));
        if (code > 128) return code;  // interrupted
      }
    }
    return code;
  }

  absl::Status Report() {
    RS_ASSIGN_OR_RETURN(const std::vector<PiperTablePlan> plans,
                        PlanOf(options_, launch_, PolicyHome::kElsewhere));
    RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(launch_.RunFolder()));
    return WritePiperPage(plans, protocol_, run);
  }

  static std::string PiperRecipe() { return DataPath("server/training/nano_piper.yaml"); }
  static std::string PiperGraft() { return DataPath("server/models/weights/nano.safetensors"); }

  const PiperStudyOptions& options_;
  const PiperStudyLaunch& launch_;
  const PaperProtocol protocol_;
};

}  // namespace

absl::StatusOr<int> RunPiperStudy(const PiperStudyOptions& options,
                                  const PiperStudyLaunch& launch) {
  return Study(options, launch).Run();
}

}  // namespace robostress
