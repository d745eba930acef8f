#include "eval/piper_study/piper_study_live.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/method_options.h"
#include "common/program_folder.h"
#include "common/records/arm_episode.h"
#include "common/status_macros.h"
#include "eval/launch/process.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Steady = std::chrono::steady_clock;

constexpr double kAnswer_s = 60;  // of a program that starts, or of an arm that drives home

// A program whose standard input is a pipe of ours and whose output is a file that we read.
class Console {
 public:
  static absl::StatusOr<Console> Start(const std::vector<std::string>& command,
                                       const std::string& log) {
    const std::string pipe = log + ".stdin";
    std::error_code ignored;
    fs::remove(pipe, ignored);
    fs::remove(log, ignored);
    if (mkfifo(pipe.c_str(), 0600) != 0)
      return absl::InternalError(absl::StrCat(pipe, ": no pipe can be made there"));
    const int fd = open(pipe.c_str(), O_RDWR | O_CLOEXEC);
    if (fd < 0) return absl::InternalError(absl::StrCat(pipe, ": cannot be opened"));
    std::vector<std::string> through = {"/bin/sh", "-c", "exec \"$@\" < \"$0\"", pipe};
    through.insert(through.end(), command.begin(), command.end());
    absl::StatusOr<ChildProcess> process = ChildProcess::Start(through, {}, log);
    if (!process.ok()) {
      close(fd);
      return process.status();
    }
    return Console(*std::move(process), fd, log);
  }
  Console(Console&& other) noexcept
      : process_(std::move(other.process_)),
        fd_(std::exchange(other.fd_, -1)),
        log_(other.log_),
        read_(other.read_) {}
  ~Console() {
    if (fd_ >= 0) close(fd_);
  }

  absl::Status Type(const std::string& line) {
    const std::string text = line + "\n";
    if (write(fd_, text.data(), text.size()) == static_cast<ssize_t>(text.size()))
      return absl::OkStatus();
    return absl::InternalError(absl::StrCat(log_, ": '", line, "' could not be typed"));
  }
  // The next line of output that holds one of `wanted`, skipping others; NOT_FOUND after `seconds`.
  absl::StatusOr<std::string> Await(const std::vector<std::string>& wanted, double seconds) {
    const auto until = Steady::now() + std::chrono::duration<double>(seconds);
    while (true) {
      RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(log_));
      for (size_t end; (end = text.find('\n', read_)) != std::string::npos;) {
        const std::string line = text.substr(read_, end - read_);
        read_ = end + 1;
        for (const std::string& word : wanted) {
          if (absl::StrContains(line, word)) return line;
        }
      }
      if (const auto exit = process_.Poll()) {
        return absl::UnavailableError(
            absl::StrCat("it ended with ", exit->text, ": ", LastLines(log_, 8)));
      }
      if (Steady::now() > until) {
        return absl::NotFoundError(absl::StrCat(log_, ": no '", wanted[0], "' within ", seconds,
                                                " s; it ends:\n", LastLines(log_, 8)));
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }
  ChildProcess& process() { return process_; }

 private:
  Console(ChildProcess process, int fd, std::string log)
      : process_(std::move(process)), fd_(fd), log_(std::move(log)) {}
  ChildProcess process_;
  int fd_;
  std::string log_;
  size_t read_ = 0;
};

// Instruction of the task and starting pose, from the worker, which knows them.
struct TaskFacts {
  std::string instruction, home;
};
absl::StatusOr<TaskFacts> FactsOf(const std::string& task, const std::string& log) {
  std::error_code ignored;
  fs::remove(log, ignored);
  RS_ASSIGN_OR_RETURN(
      ChildProcess list,
      ChildProcess::Start({(fs::path(ProgramFolder()) / "piper_study_worker").string(), "list"}, {},
                          log));
  if (list.WaitForEnd().code != 0)
    return absl::InternalError("piper_study_worker list failed: " + LastLines(log, 5));
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(log));
  TaskFacts facts;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    if (absl::ConsumePrefix(&line, "home ")) facts.home = std::string(line);
    const std::vector<std::string> words =
        absl::StrSplit(line, absl::ByChar(' '), absl::SkipEmpty());
    if (words.size() > 2 && words[0] == "task" && words[1] == task)
      facts.instruction =
          std::string(line.substr(line.find(words[2], line.find(task) + task.size())));
  }
  if (facts.instruction.empty() || facts.home.empty())
    return absl::InternalError(absl::StrCat("piper_study_worker list says nothing of ", task));
  return facts;
}

absl::StatusOr<std::string> ClientYaml(const PiperStudyOptions& options, const PiperUnit& unit,
                                       const std::string& weights, const std::string& server,
                                       const std::string& bus, const std::string& views,
                                       const TaskFacts& facts) {
  const bool adapts = unit.method == "ours" || unit.method == "dob_ours";
  const bool observer = unit.method == "dob" || unit.method == "dob_ours";
  RS_ASSIGN_OR_RETURN(MethodOptions method,
                      MakeMethod(adapts ? "ours" : "base",
                                 adapts ? options.overrides : std::vector<std::string>()));
  std::string section = absl::StrCat("\n", DumpConfig(method));
  while (!section.empty() && section.back() == '\n') section.pop_back();
  return absl::StrCat("bus: \"", bus, "\"\ninstruction: \"", facts.instruction,
                      "\"\ncameras: [\"base=mapped:", views, ".base\", \"wrist=mapped:", views,
                      ".wrist\"]\ntask: ", unit.task - 1, "\nepisodes: ", options.episodes,
                      "\nepisode_s: 600\nhome: [", facts.home,
                      "]\ncontrol:\n  observer: ", observer ? "true" : "false",
                      "\nfeedback:\n  moved_bound: ", options.moved_bound,
                      "\nrealtime:\n  priority: 0\n  lock_memory: false\npolicy:\n  server: \"",
                      server, "\"\n  policy: \"", weights, "\"\n  robot: piper_", unit.arm,
                      "\n  suite: piper_table\n  scenario: ", unit.arm, "\n  seed: ", options.seed,
                      "\n  method:", absl::StrReplaceAll(section, {{"\n", "\n    "}}), "\n");
}

// The client's own row, with what the person saw.
absl::StatusOr<std::string> Row(const std::string& client_rows, const TaskFacts& facts, int episode,
                                bool success) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(client_rows));
  const std::vector<std::string> lines = absl::StrSplit(text, '\n', absl::SkipEmpty());
  if (lines.size() != static_cast<size_t>(episode) + 1) {
    return absl::DataLossError(
        absl::StrCat(client_rows, " has ", lines.size(), " rows after ", episode + 1, " episodes"));
  }
  RS_ASSIGN_OR_RETURN(ArmEpisode row, ParseArmEpisode(client_rows, lines.back()));
  row.episode = episode;
  row.variant = kPiperVariants[0];
  row.instruction = facts.instruction;
  row.success = success;
  return ArmEpisodeLine(row);
}

}  // namespace

absl::Status RunLiveUnit(const PiperStudyOptions& options, const PiperUnit& unit,
                         const std::string& weights, const std::string& server,
                         const PiperStudyLaunch& launch) {
  if (unit.experiment == "unseen") {
    return absl::UnimplementedError(
        "the object variants have five instructions on one session, a client in real time is told "
        "one: leave 'unseen' to simulated time (--experiments main,dob with --real-time)");
  }
  const std::string folder = absl::StrCat(launch.out, "/live/", unit.id);
  std::error_code ignored;
  fs::remove_all(folder, ignored);  // of a call that was cut off
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  const std::string bus = absl::StrCat("udp:239.74.163.2:", launch.udp_port);
  const std::string views = absl::StrCat("/dev/shm/piper_study_", getpid());
  const std::string task = kPiperTasks[unit.task - 1];
  RS_ASSIGN_OR_RETURN(const TaskFacts facts, FactsOf(task, folder + "/facts.log"));
  RS_ASSIGN_OR_RETURN(const std::string yaml,
                      ClientYaml(options, unit, weights, server, bus, views, facts));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/client.yaml", yaml));
  const std::string bin = ProgramFolder();
  RS_ASSIGN_OR_RETURN(Console arm,
                      Console::Start({bin + "/piper_emulator", "--bus", bus, "--profile", unit.arm,
                                      "--task", task, "--views", views, "--view-size", "64"},
                                     folder + "/arm.log"));
  RS_RETURN_IF_ERROR(arm.Await({"placed 0"}, kAnswer_s).status());
  RS_ASSIGN_OR_RETURN(Console client,
                      Console::Start({bin + "/robot_client", "--config", folder + "/client.yaml",
                                      "--out", folder + "/client"},
                                     folder + "/client.log"));
  RS_RETURN_IF_ERROR(client.Await({"control thread"}, kAnswer_s).status());
  RS_RETURN_IF_ERROR(client.Type("enable"));
  RS_RETURN_IF_ERROR(client.Await({"holds"}, kAnswer_s).status());
  for (int episode = 0; episode < options.episodes; ++episode) {
    RS_RETURN_IF_ERROR(client.Type("home"));
    RS_ASSIGN_OR_RETURN(const std::string way,
                        client.Await({"the arm is home", "refused:"}, kAnswer_s));
    if (absl::StrContains(way, "refused:"))
      return absl::AbortedError(absl::StrCat(unit.id, " episode ", episode, ": ", way));
    RS_RETURN_IF_ERROR(arm.Type(absl::StrCat("place ", episode)));
    RS_RETURN_IF_ERROR(arm.Await({absl::StrCat("placed ", episode)}, kAnswer_s).status());
    RS_RETURN_IF_ERROR(client.Type("start"));
    RS_ASSIGN_OR_RETURN(const std::string started,
                        client.Await({"of task", "refused:"}, kAnswer_s));
    if (absl::StrContains(started, "refused:"))
      return absl::AbortedError(absl::StrCat(unit.id, " episode ", episode, ": ", started));
    const absl::StatusOr<std::string> done =
        arm.Await({absl::StrCat("done ", episode)}, options.episode_s);
    if (!done.ok() && !absl::IsNotFound(done.status())) return done.status();
    RS_RETURN_IF_ERROR(client.Type(done.ok() ? "success" : "failure"));
    RS_RETURN_IF_ERROR(client.Await({"episode ended"}, kAnswer_s).status());
    RS_ASSIGN_OR_RETURN(const std::string row,
                        Row(folder + "/client/episodes.jsonl", facts, episode, done.ok()));
    RS_RETURN_IF_ERROR(AppendLine(folder + "/episodes.jsonl", row));
    std::printf("piper-study: %s episode %d %s\n", unit.id.c_str(), episode,
                done.ok() ? "success" : "failure");
    std::fflush(stdout);
  }
  RS_RETURN_IF_ERROR(client.Type("quit"));
  if (const ExitState exit = client.process().WaitForEnd(); exit.code != 0)
    return absl::InternalError(absl::StrCat("robot_client ended with ", exit.text));
  for (const char* ending : {".base", ".wrist"}) fs::remove(views + ending, ignored);
  return WriteFileAtomically(folder + "/DONE", "");
}

}  // namespace robostress
