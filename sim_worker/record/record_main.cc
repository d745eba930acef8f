// robostress-record: records demonstrations of the scripted expert, with labels for what a learned
// policy got into (DAgger), and measures the expert.

#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/libero/task_folder.h"
#include "common/rpc/policy_client.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/unit_directory.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/record/episode_file.h"
#include "sim_worker/record/expert_demonstration.h"
#include "sim_worker/record/interruption.h"

namespace robostress {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress record --suite tabletop_goal --episodes 40 --out data/demos --workers 2\n"
    "  robostress record --suite all --eval --episodes 20 --first-draw 0 --workers 2\n"
    "  robostress record --suite tabletop_goal --server 127.0.0.1:7777 --policy nano --mix 0.5 "
    "--episodes 10 --out data/dagger1\n"
    "  robostress record --suite all --execution-noise 0.05 --out data/dr          domain "
    "randomisation\n"
    "  robostress record --suite tabletop_goal --format hdf5 --episodes 50 --out data/hdf5\n"
    "  robostress record --suite libero --out data/libero          LIBERO's four suites\n\n"
    "Draws from 1000 on are training draws; 0 to 49 are the reproducible initial states and are "
    "refused for recording. In LIBERO a draw is the first reset of its environment seeded with "
    "that number.\n"
    "The same command goes on after an interruption: files that are there are not recorded again; "
    "of the task under way nothing is kept.\n";

struct CommandLine {
  std::string suite;  // empty: all
  std::vector<int> tasks;
  int episodes = 40, first_draw = kFirstTrainingDraw, workers = 1;
  int64_t seed = 0;
  std::string libero_root, robosuite_root;
  std::vector<std::string> libero_tasks;             // folders
  std::vector<std::string> folder_suites;            // their suites
  std::map<std::string, std::string> folder_hashes;  // of a suite's files
  std::string out, server, policy = "nano", scenario = "clean", tag = "expert";
  int severity = 5;
  double mix = DaggerOptions().mix;
  bool eval = false, plain = false;
  std::string format = "shards";
  RecordOptions record;
};

// One task of one suite: the unit that worker processes share out.
struct Job {
  std::string suite;
  int task = 0;
};

double Now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Of all threads of this process.
double CpuSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) { return t.tv_sec + 1e-6 * t.tv_usec; };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

UnitConfig UnitOf(const CommandLine& line, const Job& job) {
  UnitConfig unit;
  unit.suite = job.suite;
  unit.scenario = line.scenario;
  unit.severity = line.severity;
  unit.libero_root = line.libero_root;
  unit.robosuite_root = line.robosuite_root;
  unit.libero_tasks = TaskFolderOf(job.suite);
  unit.episodes = 1;
  if (line.plain) unit.sim.pictures = SimOptions::kPlainPictures;
  return unit;
}

// With --eval that there are as many initial states as are played; training draws have no end.
absl::Status CheckStoredStates(const CommandLine& line, const Job& job) {
  if (!line.eval || line.first_draw >= kFirstTrainingDraw) return absl::OkStatus();
  int states = FindSuite(job.suite)->num_initial_states;
  if (FindSuite(job.suite)->needs_libero) {
    RS_ASSIGN_OR_RETURN(states, CountInitialStates(UnitOf(line, job), job.task));
  }
  if (line.first_draw >= 0 && line.first_draw <= states - line.episodes) return absl::OkStatus();
  return absl::OutOfRangeError(absl::StrCat("--first-draw ", line.first_draw, " --episodes ",
                                            line.episodes, ": ", job.suite, " task ", job.task,
                                            " has initial states 0 to ", states - 1,
                                            ", training draws begin at ", kFirstTrainingDraw));
}

absl::StatusOr<std::vector<Job>> PlanJobs(const CommandLine& line) {
  std::vector<Job> jobs;
  std::vector<std::string> suites = line.folder_suites;
  if (!suites.empty() && !line.suite.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("--suite ", line.suite,
                     " is beside --libero-tasks, which are suites of their own; give "
                     "one of them"));
  }
  const std::string asked = line.suite.empty() ? "all" : line.suite;
  for (const SuiteInfo& info : AllSuites()) {
    const std::string group = info.needs_libero ? "libero" : "all";
    if (info.robot == "panda" && line.folder_suites.empty() &&
        (asked == group || asked == info.name))
      suites.push_back(info.name);
  }
  for (const std::string& suite : suites) {
    const SuiteInfo& info = *FindSuite(suite);
    for (const int task : line.tasks) {
      if (task >= 0 && task < info.num_tasks) continue;
      return absl::NotFoundError(absl::StrCat("task ", task, " of ", suite,
                                              " does not exist; it has 0 to ", info.num_tasks - 1));
    }
    for (int task = 0; task < info.num_tasks; ++task) {
      if (line.tasks.empty() || absl::c_linear_search(line.tasks, task))
        jobs.push_back({info.name, task});
    }
  }
  for (const Job& job : jobs) RS_RETURN_IF_ERROR(CheckStoredStates(line, job));
  if (jobs.empty()) {
    return absl::NotFoundError(
        absl::StrCat("no suite '", asked,
                     "'; all, libero, one of what `robostress suites` lists, or another's "
                     "folder of LIBERO tasks by --libero-tasks DIR"));
  }
  if (!line.eval && line.first_draw < kFirstTrainingDraw) {
    return absl::InvalidArgumentError(absl::StrCat("--first-draw ", line.first_draw,
                                                   " is not a training draw; use ",
                                                   kFirstTrainingDraw, " or above"));
  }
  if (line.format == "hdf5" && !line.server.empty()) {
    return absl::InvalidArgumentError(
        "--format hdf5 is of whole demonstrations; what a policy drives into (--server) has labels "
        "of its own and goes to shards");
  }
  if (line.record.execution_noise > 0 && !line.server.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--execution-noise ", line.record.execution_noise,
        " is of what the expert executes, and --server lets a policy drive; give one of them"));
  }
  if (!line.eval && line.out.empty()) return absl::InvalidArgumentError("--out DIR is missing");
  return jobs;
}

// What an episode is a function of beside its suite, task and draw; and how many a file was to
// hold.
std::string SettingsOf(const CommandLine& line, const Job& job, const std::string& model_sha256) {
  nlohmann::ordered_json settings = {{"scenario", line.scenario},
                                     {"severity", line.severity},
                                     {"seed", line.seed},
                                     {"stride", line.record.stride},
                                     {"image_size", line.record.image_size},
                                     {"noisy_share", line.record.noisy_share},
                                     {"execution_noise", line.record.execution_noise},
                                     {"pictures", line.plain ? "plain" : "original"}};
  if (!line.server.empty()) settings["policy"] = line.policy, settings["mix"] = line.mix;
  if (!model_sha256.empty()) settings["model_sha256"] = model_sha256;
  if (const auto hash = line.folder_hashes.find(job.suite); hash != line.folder_hashes.end())
    settings[kLiberoTasksSha256] = hash->second;
  settings[kEpisodesAsked] = line.episodes;
  return settings.dump();
}

std::string PathOf(const CommandLine& line, const Job& job) {
  return absl::StrFormat("%s/%s_task%02d_%s_%d.%s", line.out, job.suite, job.task, line.tag,
                         line.first_draw, line.format == "hdf5" ? "hdf5" : "safetensors");
}

// What an interruption drops.
class Unfinished {
 public:
  void Begin(const Job& job, const std::string& temporary) {
    const std::lock_guard<std::mutex> lock(mutex_);
    job_ = job;
    temporary_ = temporary;
    episodes_ = 0;
  }
  void Keep() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++episodes_;
  }
  void End() { Begin({}, ""); }
  void Drop() {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (job_.suite.empty()) {
      std::fprintf(stderr, "record: interrupted\n");
      return;
    }
    std::fprintf(stderr,
                 "record: interrupted in %s task %d, %d episodes of it are dropped; the same "
                 "command records it anew and goes on\n",
                 job_.suite.c_str(), job_.task, episodes_);
    if (!temporary_.empty()) unlink(temporary_.c_str());
  }

 private:
  std::mutex mutex_;
  Job job_;
  std::string temporary_;
  int episodes_ = 0;
};

// Success, steps and speed of one task; the frames go to a file when recording.
absl::Status RunJob(const CommandLine& line, const Job& job, Unfinished& unfinished) {
  const UnitConfig unit = UnitOf(line, job);
  std::unique_ptr<GrpcPolicyClient> policy;
  if (!line.server.empty()) {
    RequestedSession session;
    session.suite = job.suite;
    session.scenario = line.scenario;
    session.policy = line.policy;
    session.seed = line.seed;
    session.method_yaml = "{method: base, track_intent: false}";
    RS_ASSIGN_OR_RETURN(policy, GrpcPolicyClient::Connect({line.server}, session));
    if (policy->spec().cameras.size() != 2) {
      return absl::InvalidArgumentError(
          absl::StrCat("policy '", line.policy, "' looks at ", policy->spec().cameras.size(),
                       " cameras; recording needs agentview and robot0_eye_in_hand"));
    }
  }
  const std::string path = PathOf(line, job);
  const std::string model_sha256 = policy == nullptr ? "" : policy->spec().model_hash;
  const std::string settings = SettingsOf(line, job, model_sha256);
  if (!line.eval && std::filesystem::exists(path)) {
    RS_ASSIGN_OR_RETURN(const bool whole, HoldsAlready(path, settings));
    // Behind one name without a model's hash there may be another policy now.
    if (whole && (policy == nullptr || !model_sha256.empty())) {
      std::printf("%-17s %2d  is recorded: %s\n", job.suite.c_str(), job.task, path.c_str());
      std::fflush(stdout);
      return absl::OkStatus();
    }
  }
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<SimTask> task, MakeSimTask(unit, job.task));
  RS_ASSIGN_OR_RETURN(const Expert expert, task->MakeExpert());
  RecordOptions options = line.record;
  options.render = !line.eval;
  if (line.eval && line.tag == "expert") options.noisy_share = 0;
  options.simulator_state = line.format == "hdf5";
  std::optional<EpisodeFile> file;
  if (!line.eval) {
    RS_ASSIGN_OR_RETURN(
        file, EpisodeFile::Create(
                  path, {job.suite, job.task, settings, line.record.execution_noise}, *task));
    unfinished.Begin(job, file->temporary());
  }
  const bool shows_progress = isatty(STDERR_FILENO) != 0;
  int successes = 0, steps = 0;
  std::string failed, no_room;
  double render = 0;
  const double start = Now(), cpu_start = CpuSeconds();
  // An episode that fails teaches nothing, nor does one in which the expert never drove: the next
  // draw replaces it, up to twice as many draws.
  int kept = 0, draws = 0, played = 0;
  for (; kept < line.episodes && draws < 2 * line.episodes; ++draws) {
    const int draw = line.first_draw + draws;
    const absl::Status reset = task->Reset(draw);
    if (absl::IsResourceExhausted(reset)) {  // nowhere to put an object: another draw has its place
      absl::StrAppend(&no_room, " ", draw);
      continue;
    }
    RS_RETURN_IF_ERROR(reset);
    const StreamKey key =
        StreamKey("record").With(line.seed).With(job.suite).With(job.task).With(draw);
    absl::StatusOr<Demonstration> episode =
        policy != nullptr ? RecordDagger(*task, expert, {job.task, draw},
                                         {line.mix, options.stride}, *policy, RandomStream(key))
                          : RecordExpert(*task, expert, options, key);
    RS_RETURN_IF_ERROR(episode.status());
    ++played;
    successes += episode->success;
    steps += episode->steps;
    render += episode->render_seconds;
    if (!episode->success) absl::StrAppend(&failed, " ", draw);
    if (shows_progress) {
      std::fprintf(stderr, "\r%s %d: %d of %d episodes, %d draws\033[K", job.suite.c_str(),
                   job.task, kept + (line.eval || episode->success), line.episodes, draws + 1);
    }
    if (!line.eval && (!episode->success || episode->frames.empty())) continue;
    ++kept;
    if (file.has_value()) RS_RETURN_IF_ERROR(file->Add(*task, draw, *episode));
    unfinished.Keep();
  }
  if (shows_progress) std::fprintf(stderr, "\r\033[K");
  const double wall = Now() - start;
  std::string written;
  if (file.has_value() && kept > 0) {
    RS_RETURN_IF_ERROR(file->Publish());
    unfinished.End();
    written = absl::StrFormat("  %d frames, %.0f frames/s, render %.0f %%, CPU %.0f %% -> %s",
                              file->frames(), file->frames() / wall, 100 * render / wall,
                              100 * (CpuSeconds() - cpu_start) / wall, file->path());
  }
  std::printf("%-17s %2d  success %3d/%-3d  mean steps %5.1f  %6.0f steps/s%s  %s%s%s%s%s\n",
              job.suite.c_str(), job.task, successes, played,
              static_cast<double>(steps) / std::max(played, 1), steps / wall, written.c_str(),
              task->instruction().c_str(), failed.empty() ? "" : "  failed draws:", failed.c_str(),
              no_room.empty() ? "" : "  draws without room for an object:", no_room.c_str());
  std::fflush(stdout);
  if (file.has_value() && kept == 0) {
    return absl::NotFoundError(
        absl::StrCat("none of the draws ", line.first_draw, " to ", line.first_draw + draws - 1,
                     " gave an episode to keep, no ", file->path(), " was written"));
  }
  return absl::OkStatus();
}

// The tasks after one that fails are recorded all the same, unless they fail by the same error.
int RunJobs(const CommandLine& line, const std::vector<Job>& jobs, int worker) {
  Unfinished& unfinished = *new Unfinished;  // as long as whoever waits for an interruption
  OnInterruption([&unfinished](int signal) {
    unfinished.Drop();
    _exit(128 + signal);
  });
  std::string error;
  for (size_t i = worker; i < jobs.size(); i += line.workers) {
    const absl::Status status = RunJob(line, jobs[i], unfinished);
    unfinished.End();
    if (status.ok()) continue;
    const bool again = status.message() == error;
    error = std::string(status.message());
    std::fprintf(stderr, "record: %s task %d: %s\n", jobs[i].suite.c_str(), jobs[i].task,
                 error.c_str());
    if (again) break;
  }
  return error.empty() ? 0 : 1;
}

int Run(const CommandLine& line) {
  absl::StatusOr<std::vector<Job>> jobs = PlanJobs(line);
  if (jobs.ok() && !line.eval) {
    if (absl::Status made = MakeDirectories(line.out); !made.ok()) jobs = made;
  }
  if (!jobs.ok()) {
    std::fprintf(stderr, "record: %s\n", std::string(jobs.status().message()).c_str());
    return 2;
  }
  HoldInterruptions();
  if (line.workers == 1) return RunJobs(line, *jobs, 0);
  std::vector<pid_t> children;
  for (int worker = 0; worker < line.workers; ++worker) {
    const pid_t child = fork();
    if (child == 0) {
      prctl(PR_SET_PDEATHSIG, SIGTERM);
      _exit(RunJobs(line, *jobs, worker));
    }
    if (child < 0) {
      std::perror("record: fork");
      break;
    }
    children.push_back(child);
  }
  OnInterruption([children](int) {
    for (const pid_t child : children) kill(child, SIGTERM);
  });
  int interrupted = 0, failures = line.workers - static_cast<int>(children.size());
  for (const pid_t child : children) {
    int status = 0;
    waitpid(child, &status, 0);
    const int code = WIFEXITED(status) ? WEXITSTATUS(status) : 1;
    failures += code != 0;
    if (code > 128) interrupted = code;
  }
  return interrupted > 0 ? interrupted : failures == 0 ? 0 : 1;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Records demonstrations of the scripted expert, or measures it.",
                           "robostress record");
  robostress::CommandLine line;
  app.footer(robostress::kExamples);
  app.add_option("--suite", line.suite,
                 "A suite; all (default): the embedded ones; libero: LIBERO's four");
  app.add_option("--tasks", line.tasks, "Task indices (default: all)")->delimiter(',');
  app.add_option("--libero-tasks", line.libero_tasks,
                 "Folders of .bddl files with initial states, instead of --suite")
      ->type_name("FOLDER");
  app.add_option(
      "--libero-root", line.libero_root,
      "LIBERO checkout (default: LIBERO_ROOT, else what `robostress libero setup` linked)");
  app.add_option("--robosuite-root", line.robosuite_root, "robosuite checkout");
  app.add_option("--episodes", line.episodes, "Episodes per task")
      ->check(robostress::cli::Range(1, 100000))
      ->capture_default_str();
  app.add_option("--first-draw", line.first_draw, "First initial state")
      ->check(robostress::cli::Range(0, 1000000000))
      ->capture_default_str();
  app.add_option("--out", line.out, "Folder for the shards, one file per task");
  app.add_option("--tag", line.tag, "Part of the shards' names")->capture_default_str();
  app.add_option("--image-size", line.record.image_size, "Of the views [px]")
      ->check(robostress::cli::Range(16, 512))
      ->capture_default_str();
  app.add_option("--stride", line.record.stride, "Control steps between frames")
      ->check(robostress::cli::Range(1, 50))
      ->capture_default_str();
  app.add_option("--noisy-share", line.record.noisy_share,
                 "Share of episodes with bursts of action noise")
      ->check(robostress::cli::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--execution-noise", line.record.execution_noise,
                 "Domain randomisation: per episode sigma ~ U[0, this], Gaussian noise on the "
                 "executed motion command [command units]; labels stay clean")
      ->check(robostress::cli::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--seed", line.seed, "Of the noise")->capture_default_str();
  app.add_option("--workers", line.workers, "Processes")
      ->check(robostress::cli::Range(1, 256))
      ->capture_default_str();
  app.add_option("--scenario", line.scenario, "See `robostress scenarios`")->capture_default_str();
  app.add_option("--severity", line.severity, "Level")
      ->check(robostress::cli::Range(1, 5))
      ->capture_default_str();
  app.add_option("--server", line.server,
                 "HOST:PORT of a policy that drives in turns with the expert (DAgger)");
  app.add_option("--policy", line.policy, "Which of the server's policies")->capture_default_str();
  app.add_option("--mix", line.mix, "The expert's share of the driving (DAgger)")
      ->check(robostress::cli::Range(0.05, 0.95))
      ->capture_default_str();
  app.add_flag("--plain-pictures", line.plain,
               "LIBERO's views drawn quickly, as sim.pictures=plain does in a sweep");
  app.add_flag("--eval", line.eval, "Only print the success table, record nothing");
  robostress::cli::Option* const image_size = app.get_option("--image-size");
  robostress::cli::Option* const stride = app.get_option("--stride");
  app.add_option("--format", line.format,
                 "shards: safetensors for training; hdf5: LIBERO's form, one file per task, every "
                 "control step, views of 128 pixels unless given")
      ->check(robostress::cli::IsMember({"shards", "hdf5"}))
      ->capture_default_str();
  return robostress::RunMain(
      app, argc, argv,
      [&]() -> absl::StatusOr<int> {
        for (const std::string& folder : line.libero_tasks) {
          RS_ASSIGN_OR_RETURN(std::string suite, robostress::AddTaskFolder(folder));
          if (line.folder_hashes.contains(suite)) {
            return absl::InvalidArgumentError(
                absl::StrCat("--libero-tasks ", folder, " is given twice; remove one"));
          }
          RS_ASSIGN_OR_RETURN(line.folder_hashes[suite], robostress::LiberoTasksSha256(folder));
          line.folder_suites.push_back(std::move(suite));
        }
        if (line.format == "hdf5") {
          if (image_size->count() == 0) line.record.image_size = 128;
          if (stride->count() == 0) line.record.stride = 1;
          if (line.record.stride != 1) {
            return absl::InvalidArgumentError(
                absl::StrCat("--stride ", line.record.stride,
                             ": --format hdf5 holds every control step; use 1"));
          }
        }
        return robostress::Run(line);
      },
      [](const absl::Status&) { return robostress::kWrongCommand; });
}
