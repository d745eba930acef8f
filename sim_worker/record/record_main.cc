// robostress-record: records demonstrations of the scripted expert, with labels for what a learned
// policy got into (DAgger), and measures the expert.

#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/hdf5_file.h"
#include "common/rpc/policy_client.h"
#include "common/run_main.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/record/expert_demonstration.h"
#include "sim_worker/record/libero_recorder.h"
#include "sim_worker/record/shard.h"

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
    "that "
    "number.\n";

constexpr char kEpisodes[] = "episodes";

struct CommandLine {
  std::string suite;  // empty: all
  std::vector<int> tasks;
  int episodes = 40, first_draw = kFirstTrainingDraw, workers = 1;
  int64_t seed = 0;
  std::string libero_root, robosuite_root;
  std::vector<std::string> libero_tasks;   // folders
  std::vector<std::string> folder_suites;  // their suites
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
  if (jobs.empty()) {
    return absl::NotFoundError(absl::StrCat(
        "no suite '", asked, "'; all, libero, or one of what `robostress suites` lists"));
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
std::string SettingsOf(const CommandLine& line) {
  nlohmann::ordered_json settings = {{"scenario", line.scenario},
                                     {"severity", line.severity},
                                     {"seed", line.seed},
                                     {"stride", line.record.stride},
                                     {"image_size", line.record.image_size},
                                     {"noisy_share", line.record.noisy_share},
                                     {"execution_noise", line.record.execution_noise},
                                     {"pictures", line.plain ? "plain" : "original"}};
  if (!line.server.empty()) settings["policy"] = line.policy, settings["mix"] = line.mix;
  settings[kEpisodes] = line.episodes;
  return settings.dump();
}

// Whether a file with the settings `before` may be replaced by one with `now`.
absl::Status CheckReplaced(const std::string& path, const std::string& before,
                           const std::string& now) {
  auto old = nlohmann::ordered_json::parse(before, nullptr, false),
       fresh = nlohmann::ordered_json::parse(now);
  const auto take = [](nlohmann::ordered_json& settings) {
    if (!settings.is_object() || !settings.contains(kEpisodes)) return 0;  // of version 0.2
    const int episodes =
        settings[kEpisodes].is_number_integer() ? settings[kEpisodes].get<int>() : 0;
    settings.erase(kEpisodes);
    return episodes;
  };
  const int held = take(old), asked = take(fresh);
  if (old.is_discarded() || old != fresh) {
    return absl::AlreadyExistsError(absl::StrCat(
        path, " was recorded with ", before.empty() ? "settings that it does not name" : before,
        ", now it is ", now, "; give another --out or --tag, or remove it"));
  }
  if (held > asked) {
    return absl::AlreadyExistsError(
        absl::StrCat(path, " was recorded with --episodes ", held, ", of which --episodes ", asked,
                     " would leave a part; give another --out or --tag, or remove it"));
  }
  return absl::OkStatus();
}

// The settings with which a file was recorded; "" where it does not say.
std::string SettingsIn(const std::string& path, bool hdf5) {
  if (hdf5) {
    const absl::StatusOr<Hdf5File> file = Hdf5File::Open(path);
    return file.ok() ? file->StringAttribute("data/demo_0", "origin").value_or("") : "";
  }
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
  if (!file.ok() || !file->metadata().contains("settings")) return "";
  return file->metadata().at("settings");
}

// Where a task's episodes go: a shard, or a file in LIBERO's form.
class EpisodeFile {
 public:
  static absl::StatusOr<EpisodeFile> Create(const CommandLine& line, const Job& job,
                                            const SimTask& task) {
    const bool hdf5 = line.format == "hdf5";
    const std::string settings = SettingsOf(line);
    EpisodeFile file(
        absl::StrFormat("%s/%s_task%02d_%s_%d.%s", line.out, job.suite, job.task, line.tag,
                        line.first_draw, hdf5 ? "hdf5" : "safetensors"),
        Shard(job.suite, job.task, task.instruction(), settings, line.record.execution_noise),
        FindSuite(job.suite)->needs_libero);
    file.settings_ = settings;
    const std::string before = SettingsIn(file.path_, hdf5);
    if (std::filesystem::exists(file.path_))
      RS_RETURN_IF_ERROR(CheckReplaced(file.path_, before, settings));
    if (hdf5) {
      RS_ASSIGN_OR_RETURN(file.libero_, LiberoDemonstrationWriter::Create(
                                            file.path_, {.suite = job.suite,
                                                         .task = task.name(),
                                                         .instruction = task.instruction(),
                                                         .problem = task.problem()}));
    }
    return file;
  }
  // Of the task's last reset.
  absl::Status Add(const SimTask& task, int draw, const Demonstration& episode) {
    frames_ += static_cast<int>(episode.frames.size());
    if (libero_.has_value()) {
      LiberoDemonstration demonstration = ToLibero(episode, task.mjcf(), libero_suite_);
      demonstration.initial_state = draw;
      demonstration.origin = settings_;
      return libero_->Add(demonstration);
    }
    shard_.Add(draw, episode);
    return absl::OkStatus();
  }
  absl::Status Publish() { return libero_.has_value() ? libero_->Publish() : shard_.Write(path_); }
  const std::string& path() const { return path_; }
  int frames() const { return frames_; }

 private:
  EpisodeFile(std::string path, Shard shard, bool libero_suite)
      : path_(std::move(path)), shard_(std::move(shard)), libero_suite_(libero_suite) {}
  std::string path_, settings_;
  Shard shard_;
  bool libero_suite_;
  std::optional<LiberoDemonstrationWriter> libero_;
  int frames_ = 0;
};

// Success, steps and speed of one task; the frames go to a file when recording.
absl::Status RunJob(const CommandLine& line, const Job& job) {
  UnitConfig unit;
  unit.suite = job.suite;
  unit.scenario = line.scenario;
  unit.severity = line.severity;
  unit.libero_root = line.libero_root;
  unit.robosuite_root = line.robosuite_root;
  unit.libero_tasks = TaskFolderOf(job.suite);
  unit.episodes = 1;
  if (line.plain) unit.sim.pictures = SimOptions::kPlainPictures;
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<SimTask> task, MakeSimTask(unit, job.task));
  RS_ASSIGN_OR_RETURN(const Expert expert, task->MakeExpert());
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
  RecordOptions options = line.record;
  options.render = !line.eval;
  if (line.eval && line.tag == "expert") options.noisy_share = 0;
  options.simulator_state = line.format == "hdf5";
  std::optional<EpisodeFile> file;
  if (!line.eval) {
    RS_ASSIGN_OR_RETURN(file, EpisodeFile::Create(line, job, *task));
  }
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
    if (!line.eval && (!episode->success || episode->frames.empty())) continue;
    ++kept;
    if (file.has_value()) RS_RETURN_IF_ERROR(file->Add(*task, draw, *episode));
  }
  const double wall = Now() - start;
  std::string written;
  if (file.has_value() && kept > 0) {
    RS_RETURN_IF_ERROR(file->Publish());
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
  std::string error;
  for (size_t i = worker; i < jobs.size(); i += line.workers) {
    const absl::Status status = RunJob(line, jobs[i]);
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
  if (line.workers == 1) return RunJobs(line, *jobs, 0);
  std::vector<pid_t> children;
  for (int worker = 0; worker < line.workers; ++worker) {
    const pid_t child = fork();
    if (child == 0) _exit(RunJobs(line, *jobs, worker));
    if (child < 0) {
      std::perror("record: fork");
      break;
    }
    children.push_back(child);
  }
  int failures = line.workers - static_cast<int>(children.size());
  for (const pid_t child : children) {
    int status = 0;
    waitpid(child, &status, 0);
    failures += !(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  return failures == 0 ? 0 : 1;
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
  app.add_option("--first-draw", line.first_draw, "First initial state")->capture_default_str();
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
