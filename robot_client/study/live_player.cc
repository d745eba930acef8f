#include "robot_client/study/live_player.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/config.h"
#include "common/program_folder.h"
#include "common/records/arm_episode.h"
#include "common/status_macros.h"
#include "robot_client/study/client_method.h"
#include "robot_client/study/table_expert.h"
#include "robot_client/study/table_tasks.h"

namespace robostress::piper {
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
        log_(std::move(other.log_)),
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

template <class Options>
std::string Section(const Options& options) {
  std::string text = absl::StrCat("\n", DumpConfig(options));
  while (text.back() == '\n') text.pop_back();
  return absl::StrReplaceAll(text, {{"\n", "\n  "}});
}

absl::StatusOr<std::string> ClientYaml(const UnitConfig& unit, const TableSuite& suite,
                                       const std::string& server, const std::string& bus,
                                       const std::string& views) {
  RS_ASSIGN_OR_RETURN(const ArmVector home, TableExpert::Home());
  ControlOptions control;
  UseMethod(*unit.method, Follow::kPlanned, control);
  return absl::StrCat(
      "bus: \"", bus, "\"\ninstruction: \"", InstructionOf(suite, 0),
      "\"\ncameras: [\"base=mapped:", views, ".base\", \"wrist=mapped:", views,
      ".wrist\"]\ntask: ", suite.task, "\nepisodes: ", unit.episodes, "\nepisode_s: 600\nhome: [",
      absl::StrJoin(home, ", "), "]\ncontrol:", Section(control),
      "\nfeedback:\n  moved_bound: ", unit.client.moved_bound,
      "\nrealtime:\n  priority: 0\n  lock_memory: false\npolicy:", Section(SessionOf(unit, server)),
      "\n");
}

// The client's own row of its newest episode.
absl::StatusOr<ArmEpisode> NewestRow(const std::string& client_rows, size_t episodes) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(client_rows));
  const std::vector<std::string> lines = absl::StrSplit(text, '\n', absl::SkipEmpty());
  if (lines.size() != episodes) {
    return absl::DataLossError(
        absl::StrCat(client_rows, " has ", lines.size(), " rows after ", episodes, " episodes"));
  }
  return ParseArmEpisode(client_rows, lines.back());
}

}  // namespace

class LivePlayer::Bench {
 public:
  static absl::StatusOr<std::unique_ptr<Bench>> Create(const UnitConfig& unit,
                                                       const TableSuite& suite,
                                                       const std::string& server,
                                                       const std::string& folder) {
    const std::string bus = absl::StrCat("udp:239.74.163.2:", unit.client.udp_port);
    const std::string views = absl::StrCat("/dev/shm/piper_unit_", getpid());
    std::error_code ignored;
    fs::remove_all(folder + "/client", ignored);  // of a call that was cut off
    RS_ASSIGN_OR_RETURN(const std::string yaml, ClientYaml(unit, suite, server, bus, views));
    RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/client.yaml", yaml));
    const std::string bin = ProgramFolder();
    RS_ASSIGN_OR_RETURN(
        Console arm,
        Console::Start({bin + "/piper_emulator", "--bus", bus, "--profile", unit.scenario, "--task",
                        kTableTasks.at(static_cast<size_t>(suite.task)).name, "--views", views,
                        "--view-size", "64"},
                       folder + "/arm.log"));
    RS_RETURN_IF_ERROR(arm.Await({"placed 0"}, kAnswer_s).status());
    RS_ASSIGN_OR_RETURN(Console client,
                        Console::Start({bin + "/robot_client", "--config", folder + "/client.yaml",
                                        "--out", folder + "/client"},
                                       folder + "/client.log"));
    RS_RETURN_IF_ERROR(client.Await({"control thread"}, kAnswer_s).status());
    RS_RETURN_IF_ERROR(client.Type("enable"));
    RS_RETURN_IF_ERROR(client.Await({"holds"}, kAnswer_s).status());
    return std::unique_ptr<Bench>(
        new Bench(unit, suite, folder, views, std::move(arm), std::move(client)));
  }
  ~Bench() {
    std::error_code ignored;
    for (const char* ending : {".base", ".wrist"}) fs::remove(views_ + ending, ignored);
  }

  absl::StatusOr<EpisodeRow> Play(const PlannedEpisode& planned) {
    RS_RETURN_IF_ERROR(client_.Type("home"));
    RS_RETURN_IF_ERROR(AwaitOrRefused("the arm is home"));
    RS_RETURN_IF_ERROR(arm_.Type(absl::StrCat("place ", planned.initial_state)));
    RS_RETURN_IF_ERROR(
        arm_.Await({absl::StrCat("placed ", planned.initial_state)}, kAnswer_s).status());
    RS_RETURN_IF_ERROR(client_.Type("start"));
    RS_RETURN_IF_ERROR(AwaitOrRefused("of task"));
    const absl::StatusOr<std::string> done =
        arm_.Await({absl::StrCat("done ", planned.initial_state)}, unit_.client.episode_s);
    if (!done.ok() && !absl::IsNotFound(done.status())) return done.status();
    RS_RETURN_IF_ERROR(client_.Type(done.ok() ? "success" : "failure"));
    RS_RETURN_IF_ERROR(client_.Await({"episode ended"}, kAnswer_s).status());
    RS_ASSIGN_OR_RETURN(const ArmEpisode seen,
                        NewestRow(folder_ + "/client/episodes.jsonl", ++played_));
    EpisodeRow row;
    row.instruction = InstructionOf(suite_, 0);
    row.success = done.ok();
    row.seconds = seen.seconds;
    row.steps = static_cast<int>(seen.steps + seen.steps_masked);
    row.chunks = static_cast<int>(seen.feedback_chunks);
    row.measured_steps = seen.steps;
    row.masked_steps = seen.steps_masked;
    row.updates = static_cast<int>(seen.adapter_version);
    row.residual = seen.residual;
    row.eta_sq = seen.eta_sq;
    row.a_sq = seen.displacement_sq;
    row.state = seen.state;
    row.cause = seen.cause;
    return row;
  }

  absl::Status Quit() {
    RS_RETURN_IF_ERROR(client_.Type("quit"));
    if (const ExitState exit = client_.process().WaitForEnd(); exit.code != 0)
      return absl::InternalError(absl::StrCat("robot_client ended with ", exit.text));
    return absl::OkStatus();
  }

 private:
  Bench(const UnitConfig& unit, TableSuite suite, std::string folder, std::string views,
        Console arm, Console client)
      : unit_(unit),
        suite_(std::move(suite)),
        folder_(std::move(folder)),
        views_(std::move(views)),
        arm_(std::move(arm)),
        client_(std::move(client)) {}

  absl::Status AwaitOrRefused(const std::string& wanted) {
    RS_ASSIGN_OR_RETURN(const std::string line, client_.Await({wanted, "refused:"}, kAnswer_s));
    if (!absl::StrContains(line, "refused:")) return absl::OkStatus();
    return absl::AbortedError(absl::StrCat("after ", played_, " episodes: ", line));
  }

  const UnitConfig& unit_;
  const TableSuite suite_;
  const std::string folder_, views_;
  Console arm_, client_;
  size_t played_ = 0;
};

LivePlayer::LivePlayer(const UnitConfig& unit, std::string server, std::string folder)
    : unit_(unit), server_(std::move(server)), folder_(std::move(folder)) {}

LivePlayer::~LivePlayer() = default;

absl::StatusOr<std::unique_ptr<LivePlayer>> LivePlayer::Create(const UnitConfig& unit,
                                                               const std::string& server,
                                                               const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const TableSuite suite, FindTableSuite(unit.suite));
  if (suite.variants != std::vector<int>{0}) {
    return absl::UnimplementedError(absl::StrCat(
        "suite ", unit.suite,
        ": the object variants have five instructions on one session, a client in real time is "
        "told one; leave it to simulated time"));
  }
  return std::unique_ptr<LivePlayer>(new LivePlayer(unit, server, folder));
}

absl::StatusOr<std::string> LivePlayer::Open() {
  // A session of its own, for the hash of the weights alone: the client opens the one that plays.
  PolicyConnectionOptions asking = SessionOf(unit_, server_);
  asking.connect_timeout_s = 60;
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<PolicyEndpoint> policy,
                      ConnectTo(asking, 1 / ControlOptions().rate_hz)());
  const std::string hash = policy->spec().model_hash;
  RS_ASSIGN_OR_RETURN(const TableSuite suite, FindTableSuite(unit_.suite));
  RS_ASSIGN_OR_RETURN(bench_, Bench::Create(unit_, suite, server_, folder_));
  return hash;
}

absl::StatusOr<PlayedEpisode> LivePlayer::Play(const PlannedEpisode& planned,
                                               UnitDirectory& directory) {
  const auto start = Steady::now();
  PlayedEpisode played;
  RS_ASSIGN_OR_RETURN(played.row, bench_->Play(planned));
  played.timing.wall_s = std::chrono::duration<double>(Steady::now() - start).count();
  // The client leaves as it should, or the unit has no DONE.
  if (directory.episodes() + 1 == PlanEpisodes(unit_).size()) RS_RETURN_IF_ERROR(bench_->Quit());
  return played;
}

}  // namespace robostress::piper
