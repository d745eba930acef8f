#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <thread>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "eval/launch/process.h"
#include "eval/piper_study/piper_study.h"
#include "eval/piper_study/piper_study_live.h"
#include "eval/piper_study/piper_study_report.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr int kPoll_ms = 100;
constexpr int kServerStart_s = 180;

const std::map<std::string, std::string>& OneThread() {
  static const auto& environment =
      *new std::map<std::string, std::string>{{"OMP_NUM_THREADS", "1"},
                                              {"OPENBLAS_NUM_THREADS", "1"},
                                              {"MKL_NUM_THREADS", "1"},
                                              {"LP_NUM_THREADS", "0"}};
  return environment;
}

// A process that a stage waits for, and the file that says it is done.
struct Job {
  std::string name;
  std::vector<std::string> command;
  std::string done;
};

class Study {
 public:
  Study(const PiperStudyOptions& options, const PiperStudyLaunch& launch,
        std::vector<PiperUnit> units)
      : options_(options), launch_(launch), units_(std::move(units)) {}

  absl::Status Run() {
    for (const char* folder : {"/demos", "/train", "/units", "/plan", "/logs"})
      RS_RETURN_IF_ERROR(MakeDirectories(launch_.out + folder));
    RS_RETURN_IF_ERROR(KeepOptions());
    for (const std::string& stage : launch_.stages) {
      if (stage == "record") {
        RS_RETURN_IF_ERROR(Record());
      } else if (stage == "train") {
        RS_RETURN_IF_ERROR(Train());
      } else if (stage == "evaluate") {
        RS_RETURN_IF_ERROR(Evaluate());
      } else if (stage == "report") {
        RS_RETURN_IF_ERROR(Report());
      } else {
        return absl::InvalidArgumentError(absl::StrCat(
            "stage '", stage, "' is unknown; there are record, train, evaluate, report"));
      }
    }
    return absl::OkStatus();
  }

 private:
  std::string Out(const std::string& name) const { return absl::StrCat(launch_.out, "/", name); }
  std::string Program(const std::string& name) const {
    return (fs::path(ProgramFolder()) / name).string();
  }
  bool given_weights() const { return !options_.base_weights.empty(); }
  std::string Weights(bool robust) const {
    if (given_weights()) return robust ? options_.robust_weights : options_.base_weights;
    return fs::absolute(
               Out(robust ? "train/robust/nano.safetensors" : "train/base/nano.safetensors"))
        .lexically_normal()
        .string();
  }

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
                            ChildProcess::Start(job->command, OneThread(), Log(job->name)));
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
    std::vector<Job> jobs;
    for (const std::string& arm : options_.arms) {
      for (const int task : options_.tasks) {
        const std::string name = absl::StrCat(arm, "_", kPiperTasks[task - 1]);
        const std::string shard = Out(absl::StrCat("demos/", name, ".safetensors"));
        jobs.push_back({"record_" + name,
                        {Program("piper_study_worker"), "record", "--arm", arm, "--task",
                         kPiperTasks[task - 1], "--episodes", absl::StrCat(options_.demonstrations),
                         "--out", shard},
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
    return RunJobs({base, robust}, launch_.workers);
  }

  absl::StatusOr<std::pair<ChildProcess, std::string>> StartServer(const std::string& name,
                                                                   const std::string& weights) {
    RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("serve"));
    const std::string port_file = Out("logs/server_" + name + ".port");
    std::error_code ignored;
    fs::remove(port_file, ignored);
    RS_ASSIGN_OR_RETURN(
        ChildProcess process,
        ChildProcess::Start({program, "--policy", weights, "--listen", "127.0.0.1:0", "--port-file",
                             port_file, "--threads", absl::StrCat(launch_.workers)},
                            OneThread(), Log("server_" + name)));
    for (int i = 0; !fs::exists(port_file); ++i) {
      if (const auto exit = process.Poll()) {
        return absl::UnavailableError(absl::StrCat("the policy server ended (", exit->text, "); ",
                                                   Log("server_" + name), " ends:\n",
                                                   LastLines(Log("server_" + name), 12)));
      }
      if (i * kPoll_ms > kServerStart_s * 1000)
        return absl::UnavailableError(
            absl::StrCat("no port after ", kServerStart_s, " s; see ", Log("server_" + name)));
      std::this_thread::sleep_for(std::chrono::milliseconds(kPoll_ms));
    }
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(port_file));
    const std::string port(absl::StripAsciiWhitespace(text));
    return std::make_pair(std::move(process),
                          port.find(':') == std::string::npos ? "127.0.0.1:" + port : port);
  }

  absl::Status Evaluate() {
    for (const bool robust : {false, true}) {
      std::vector<const PiperUnit*> units;
      const char* const folder = launch_.real_time ? "live/" : "units/";
      for (const PiperUnit& unit : units_) {
        if ((unit.method == "robust") == robust && !fs::exists(Out(folder + unit.id + "/DONE")))
          units.push_back(&unit);
      }
      if (units.empty()) continue;
      const std::string weights = Weights(robust);
      if (!fs::exists(weights)) {
        return absl::NotFoundError(absl::StrCat(
            weights, " is missing: run the stages record and train first, or give weights"));
      }
      RS_ASSIGN_OR_RETURN(const auto server, StartServer(robust ? "robust" : "base", weights));
      std::vector<Job> jobs;
      for (const PiperUnit* unit : units) {
        if (launch_.real_time) {
          RS_RETURN_IF_ERROR(RunLiveUnit(options_, *unit, weights, server.second, launch_));
          continue;
        }
        RS_ASSIGN_OR_RETURN(const std::string yaml, PiperUnitYaml(options_, *unit, weights));
        const std::string plan = Out("plan/" + unit->id + ".yaml");
        RS_RETURN_IF_ERROR(WriteFileAtomically(plan, yaml));
        jobs.push_back({unit->id,
                        {Program("piper_study_worker"), "evaluate", "--unit", plan, "--server",
                         server.second, "--out", Out("units/" + unit->id)},
                        Out("units/" + unit->id + "/DONE")});
      }
      RS_RETURN_IF_ERROR(RunJobs(jobs, launch_.workers));
    }
    return absl::OkStatus();
  }

  absl::Status Report() {
    return WritePiperReport(options_, units_, launch_.out, launch_.real_time ? "live" : "units",
                            Weights(false));
  }

  static const char* PiperRecipe() {
    return ROBOSTRESS_SOURCE_DIR "/server/training/nano_piper.yaml";
  }
  static const char* PiperGraft() {
    return ROBOSTRESS_SOURCE_DIR "/server/models/weights/nano.safetensors";
  }

  const PiperStudyOptions& options_;
  const PiperStudyLaunch& launch_;
  const std::vector<PiperUnit> units_;
};

}  // namespace

absl::Status RunPiperStudy(const PiperStudyOptions& options, const PiperStudyLaunch& launch) {
  RS_ASSIGN_OR_RETURN(std::vector<PiperUnit> units, PlanPiperStudy(options));
  return Study(options, launch, std::move(units)).Run();
}

}  // namespace robostress
