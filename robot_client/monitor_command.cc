#include "robot_client/monitor_command.h"

#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "adapter/method_options.h"
#include "common/clock.h"
#include "common/config.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/can/bus_address.h"
#include "robot_client/client_config.h"
#include "robot_client/piper/arm_monitor.h"
#include "robot_client/piper/arm_report_text.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robot_client monitor --bus can:can0                   a page that is redrawn; Ctrl-C ends
  robot_client monitor --config lab.yaml --once         one report; exit code 0: the arm is well
  robot_client monitor --once --json | python3 -m json.tool
  robot_client monitor --silent                         sends nothing at all

It never commands: it listens, and asks for firmware, limits, collision levels and the gripper's
range, one question at a time. While another program commands the arm it does not even ask.

Exit codes: 0 the arm is well (warnings do not count); 1 something is wrong with it; 2 bad input or
nothing to connect to: no bus, or nothing comes from an arm.
)";

constexpr int64_t kPoll_ns = 2'000'000;
constexpr int64_t kListen_ns = 1'000'000'000;    // at least, for rates
constexpr int64_t kPatience_ns = 8'000'000'000;  // with --once, for answers that do not come
constexpr int64_t kSilence_ns = 2'000'000'000;   // with --once, without a frame

struct CommandLine {
  std::string bus, config_file;
  double seconds = 0, every_s = 1;
  bool once = false, json = false, silent = false;
};

volatile std::sig_atomic_t stop_asked = 0;

absl::StatusOr<std::string> BusOf(const CommandLine& line) {
  if (!line.bus.empty()) return line.bus;
  if (line.config_file.empty()) return "can:can0";
  RS_ASSIGN_OR_RETURN(const ClientConfig config, LoadConfig<ClientConfig>(line.config_file));
  if (config.bus == "rehearse")
    return absl::InvalidArgumentError(
        absl::StrCat(line.config_file,
                     ": bus is rehearse, where there is no arm to look at; give "
                     "--bus can:can0"));
  return config.bus;
}

// What is shown, and the last verdict.
class Screen {
 public:
  explicit Screen(const CommandLine& line)
      : json_(line.json), page_(line.once), redraws_(!line.once && isatty(STDOUT_FILENO) != 0) {
    if (redraws_ && !json_) std::fputs("\033[2J", stdout);
  }

  void Show(const piper::ArmReport& report) {
    const std::vector<piper::Finding> findings = piper::Diagnose(report);
    well_ = !piper::HasError(findings);
    if (json_) {
      std::fputs(ReportJson(report, findings).c_str(), stdout);
    } else if (redraws_) {
      // Over the page before: each line to its end, then what is left of it.
      const std::string page =
          absl::StrReplaceAll(ReportPage(report, findings), {{"\n", "\033[K\n"}});
      std::fputs(absl::StrCat("\033[H", page, "\033[J").c_str(), stdout);
    } else if (page_) {
      std::fputs(ReportPage(report, findings).c_str(), stdout);
    } else {
      ShowLines(report, findings);
    }
    std::fflush(stdout);
  }
  bool well() const { return well_; }

 private:
  // What is found is said when it appears, not every second.
  void ShowLines(const piper::ArmReport& report, const std::vector<piper::Finding>& findings) {
    std::fputs(ReportLine(report, findings).c_str(), stdout);
    std::vector<std::string> texts;
    for (const piper::Finding& finding : findings) {
      texts.push_back(absl::StrCat(finding.error ? "WRONG    " : "WARNING  ", finding.text));
      if (std::find(said_.begin(), said_.end(), texts.back()) == said_.end())
        std::printf("  %s\n", texts.back().c_str());
    }
    said_ = std::move(texts);
  }

  const bool json_, page_, redraws_;
  bool well_ = false;
  std::vector<std::string> said_;
};

absl::StatusOr<bool> Once(piper::ArmMonitor& monitor, Clock& clock, Screen& screen) {
  const int64_t begin_ns = clock.now_ns();
  while (!stop_asked) {
    clock.SleepUntil(clock.now_ns() + kPoll_ns);
    monitor.Poll();
    const int64_t waited_ns = clock.now_ns() - begin_ns;
    if (!monitor.heard() && waited_ns >= kSilence_ns) break;
    if (monitor.heard() && waited_ns >= kListen_ns && monitor.asked_all()) break;
    if (waited_ns >= kPatience_ns) break;
  }
  screen.Show(monitor.TakeReport());
  return screen.well();
}

absl::StatusOr<bool> Watch(const CommandLine& line, piper::ArmMonitor& monitor, Clock& clock,
                           Screen& screen) {
  const auto every_ns = static_cast<int64_t>(1e9 * line.every_s);
  const int64_t begin_ns = clock.now_ns();
  int64_t next_ns = begin_ns + every_ns;
  while (!stop_asked) {
    clock.SleepUntil(clock.now_ns() + kPoll_ns);
    monitor.Poll();
    const int64_t now_ns = clock.now_ns();
    if (now_ns >= next_ns) {
      screen.Show(monitor.TakeReport());
      next_ns = std::max(next_ns + every_ns, now_ns);
    }
    if (line.seconds > 0 && now_ns - begin_ns >= static_cast<int64_t>(1e9 * line.seconds)) break;
  }
  return screen.well();
}

absl::StatusOr<bool> Run(const CommandLine& line) {
  MonotonicClock clock;
  RS_ASSIGN_OR_RETURN(const std::string address, BusOf(line));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<CanBus> bus, MakeCanBus(address, clock));
  piper::ArmMonitorOptions options;
  options.silent = line.silent;
  piper::ArmMonitor monitor(std::move(bus), clock, options);
  RS_RETURN_IF_ERROR(monitor.Open());
  Screen screen(line);
  RS_ASSIGN_OR_RETURN(const bool well, line.once ? Once(monitor, clock, screen)
                                                 : Watch(line, monitor, clock, screen));
  if (!monitor.heard())
    return absl::UnavailableError(absl::StrCat(
        address, ": nothing came from an arm; check its power, the cable and the bit rate"));
  return well;
}

}  // namespace

int MonitorMain(int argc, char** argv) {
  cli::App app(
      "Shows the state of an arm without commanding it: joints, power, temperatures, faults, "
      "limits, delays, other senders, and what to do about what is wrong.",
      "robot_client monitor");
  app.footer(kExamples);
  CommandLine line;
  auto* bus = app.add_option("--bus", line.bus, "can:can0 (default) or udp:GROUP:PORT");
  app.add_option("--config", line.config_file, "take the bus from this configuration (YAML)")
      ->excludes(bus);
  app.add_option("--seconds", line.seconds, "end after this long (default: on Ctrl-C)")
      ->check(cli::Range(0.1, 1e6));
  app.add_option("--every", line.every_s, "time between two reports [s]")
      ->check(cli::Range(0.1, 3600.0))
      ->capture_default_str();
  app.add_flag("--once", line.once, "one report, then end");
  app.add_flag("--json", line.json, "reports as JSON, one a line");
  app.add_flag("--silent", line.silent, "send nothing, not even questions");
  return RunMain(
      app, argc, argv,
      [&]() -> absl::StatusOr<int> {
        for (const int signal : {SIGINT, SIGTERM}) std::signal(signal, [](int) { stop_asked = 1; });
        RS_ASSIGN_OR_RETURN(const bool well, Run(line));
        return well ? 0 : kFailed;
      },
      [](const absl::Status&) { return kWrongCommand; });
}

}  // namespace robostress
