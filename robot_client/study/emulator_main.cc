// piper_emulator: a Piper in software on a CAN bus, in real time. A client or the vendor's SDK sees
// the frames of an arm; see README.md beside this file.

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/clock.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/can/bus_address.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/emulator/view_server.h"
#include "robot_client/study/table_expert.h"

namespace robostress::piper {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  piper_emulator --bus udp:239.74.163.2:43113 --profile new\n"
    "  piper_emulator --bus udp:239.74.163.2:43113 --profile used_one_year --payload-kg 1.0\n"
    "  piper_emulator --bus udp:239.74.163.2:43114 --fault collision:J2@20 --fault silent@30+0.5\n"
    "  piper_emulator --bus can:vcan0 --firmware S-V1.8-2 --command-lag-ms 100\n"
    "  piper_emulator --teach 0 --hand path.csv\n"
    "  piper_emulator --bus udp:239.74.163.2:43114 --leader --hand path.csv\n"
    "  piper_emulator --task bowl_on_box --views /dev/shm/piper --view-size 64\n\n"
    "One port per arm. Frames stay on this machine unless the bus names an interface\n"
    "(udp:239.74.163.2:43113%eth1). The arm starts on its rest, disabled; Ctrl-C ends it.\n"
    "With --task a table stands in front of it, the arm starts in the pose from which the task's\n"
    "demonstrations start, and a line `place N` on standard input puts the objects where initial\n"
    "state N has them; `done N` is printed when the task is.\n";

struct CommandLine {
  std::string bus = "udp:239.74.163.2:43113";
  std::string firmware = "S-V1.8-9";
  double command_lag_ms = -1;
  std::vector<std::string> faults;
  std::vector<double> start_deg;
  double duration_s = 0;
  std::string teach, hand;
  std::string views, task, variant = kObjectVariants[0].name;
  int view_size = 0;
  EmulatorOptions options;
};

volatile std::sig_atomic_t stop_asked = 0;

absl::StatusOr<EmulatorOptions> Resolve(const CommandLine& line) {
  EmulatorOptions options = line.options;
  const auto version = ParseFirmware(line.firmware);
  if (!version)
    return absl::InvalidArgumentError(
        absl::StrCat("--firmware ", line.firmware, ": expected a version as S-V1.8-9"));
  options.version = *version;
  if (!line.task.empty()) {
    RS_RETURN_IF_ERROR(FindTableTask(line.task).status());
    RS_ASSIGN_OR_RETURN(const int variant, FindObjectVariant(line.variant));
    const double payload_kg = options.scene.payload_kg;
    options.scene = MakeTableScene(kObjectVariants.at(static_cast<size_t>(variant)));
    options.scene.payload_kg = payload_kg;
    if (line.start_deg.empty()) {
      RS_ASSIGN_OR_RETURN(const ArmVector home, TableExpert::Home());
      std::copy_n(home.begin(), kJoints, options.start.begin());
      options.opening = home[kJoints];
    }
  } else if (!line.views.empty()) {
    options.scene.assets_xml += kViewAssets;
    options.scene.world_xml += kViewTable;
  }
  options.command_lag_s = line.command_lag_ms < 0 ? -1 : line.command_lag_ms / 1000;
  for (size_t j = 0; j < line.start_deg.size(); ++j)
    options.start[j] = line.start_deg[j] * M_PI / 180;
  for (int j = 0; j < kJoints; ++j) {
    if (!(options.start[j] >= kJointRanges[j].lower && options.start[j] <= kJointRanges[j].upper))
      return absl::InvalidArgumentError(absl::StrCat(
          "--start-deg: joint ", j + 1, " at ", options.start[j] * 180 / M_PI, " is outside ",
          kJointRanges[j].lower * 180 / M_PI, " to ", kJointRanges[j].upper * 180 / M_PI));
  }
  for (const std::string& text : line.faults) {
    RS_ASSIGN_OR_RETURN(const PlannedFault fault, ParseFault(text));
    options.faults.push_back(fault);
  }
  if (!line.teach.empty()) {
    RS_ASSIGN_OR_RETURN(options.teach, ParseTeachPlan(line.teach));
  }
  if (!line.hand.empty()) {
    RS_ASSIGN_OR_RETURN(options.hand, GuidingHand::Load(line.hand));
  }
  // An arm in software beside a real one on the same wires would answer for it.
  if (absl::StartsWith(line.bus, "can:") && !absl::StartsWith(line.bus, "can:vcan"))
    return absl::InvalidArgumentError(absl::StrCat(
        "--bus ", line.bus, ": an emulator runs on virtual interfaces only (can:vcan0, udp:...)"));
  return options;
}

// The table in front of the arm, as a person on standard input has it.
class Table {
 public:
  static absl::StatusOr<Table> Create(const std::string& task, PiperPlant* plant) {
    RS_ASSIGN_OR_RETURN(const int index, FindTableTask(task));
    RS_ASSIGN_OR_RETURN(TableScene scene,
                        TableScene::Create(plant, kTableTasks.at(static_cast<size_t>(index))));
    Table table(scene);
    table.Place(0);
    fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
    return table;
  }
  // Every now and then: obeys lines that have come, and says when the task is done.
  void Serve() {
    char bytes[256];
    for (ssize_t n; (n = read(STDIN_FILENO, bytes, sizeof bytes)) > 0;)
      input_.append(bytes, static_cast<size_t>(n));
    for (size_t end; (end = input_.find('\n')) != std::string::npos; input_.erase(0, end + 1)) {
      absl::string_view text = absl::string_view(input_).substr(0, end);
      int state = 0;
      if (absl::ConsumePrefix(&text, "place ") && absl::SimpleAtoi(text, &state)) {
        Place(state);
      } else {
        std::printf("not understood; `place N` puts the objects in initial state N\n");
      }
    }
    if (input_.size() > sizeof bytes) input_.clear();
    done_rounds_ = scene_.Done(scene_.Look()) ? done_rounds_ + 1 : 0;
    if (done_rounds_ == kDoneRounds) std::printf("done %d\n", state_);
    std::fflush(stdout);
  }

 private:
  static constexpr int kDoneRounds = 20;  // of 16 ms
  explicit Table(const TableScene& scene) : scene_(scene) {}
  void Place(int state) {
    scene_.Place(state);
    state_ = state;
    done_rounds_ = 0;
    std::printf("placed %d\n", state);
  }
  TableScene scene_;
  std::string input_;
  int state_ = 0, done_rounds_ = 0;
};

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const EmulatorOptions options, Resolve(line));
  MonotonicClock clock;
  RS_ASSIGN_OR_RETURN(std::unique_ptr<CanBus> bus, MakeCanBus(line.bus, clock));
  const std::string description = bus->description();
  RS_ASSIGN_OR_RETURN(const auto emulator, PiperEmulator::Create(options, std::move(bus), clock));
  std::printf("piper_emulator: %s, profile %s, payload %g kg, firmware %s\n", description.c_str(),
              emulator->profile().name.c_str(), options.scene.payload_kg,
              FirmwareName(options.version).c_str());
  std::fflush(stdout);
  std::optional<Table> table;
  if (!line.task.empty()) {
    RS_ASSIGN_OR_RETURN(table, Table::Create(line.task, &emulator->plant()));
  }
  std::unique_ptr<ViewServer> views;
  if (!line.views.empty()) {
    ViewServerOptions shown;
    shown.prefix = line.views;
    if (line.view_size > 0) shown.width = shown.height = line.view_size;
    shown.shadows = line.task.empty();  // as the task's demonstrations are drawn
    RS_ASSIGN_OR_RETURN(views, ViewServer::Create(shown, emulator->plant(), &clock));
  }
  const int64_t start_ns = clock.now_ns();
  int64_t worst_ns = 0, ticks = 0;
  for (int64_t tick_ns = start_ns; !stop_asked; tick_ns += 1'000'000) {
    if (line.duration_s > 0 && 1e-9 * static_cast<double>(tick_ns - start_ns) >= line.duration_s)
      break;
    clock.SleepUntil(tick_ns);
    const int64_t now_ns = clock.now_ns();
    worst_ns = std::max(worst_ns, now_ns - tick_ns);
    emulator->RunUntil(now_ns);
    if (++ticks % 16 != 0) continue;
    if (table) table->Serve();
    if (views != nullptr) views->Show(emulator->plant().data());
  }
  const double seconds = 1e-9 * static_cast<double>(clock.now_ns() - start_ns);
  std::printf(
      "piper_emulator: %.1f s, %.1f frames per second sent, %llu refused by the bus, %llu "
      "datagrams or frames not understood, %llu steps of 1 ms skipped, latest tick %.1f ms\n",
      seconds, static_cast<double>(emulator->frames_sent()) / seconds,
      static_cast<unsigned long long>(emulator->send_failures()),
      static_cast<unsigned long long>(emulator->bus_health().refused),
      static_cast<unsigned long long>(emulator->skipped_steps()),
      1e-6 * static_cast<double>(worst_ns));
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::piper

int main(int argc, char** argv) {
  robostress::cli::App app(
      "An AgileX Piper in software: mechanics, firmware and frames on a CAN bus.",
      "piper_emulator");
  robostress::piper::CommandLine line;
  app.footer(robostress::piper::kExamples);
  app.add_option("--bus", line.bus, "udp:GROUP:PORT[%INTERFACE] or can:VCAN")
      ->capture_default_str();
  app.add_option("--profile", line.options.profile,
                 "Execution errors: new, used_one_year, or a scenario file (.yaml)")
      ->capture_default_str();
  app.add_option("--payload-kg", line.options.scene.payload_kg,
                 "Mass between the finger tips, unknown to the arm's controller")
      ->check(robostress::cli::Range(0.0, 3.0))
      ->capture_default_str();
  app.add_option("--firmware", line.firmware, "Version that the arm reports")
      ->capture_default_str();
  app.add_option("--command-lag-ms", line.command_lag_ms,
                 "From a target's frame to its effect (default: the profile's)")
      ->check(robostress::cli::Range(0.0, 1000.0));
  app.add_flag("--motor-encoders", line.options.motor_encoders,
               "Encoders before backlash and compliance (default: at the joints)");
  app.add_option(
      "--fault", line.faults, "KIND[:J1..J6]@SECONDS[+DURATION], repeatable: " + [] {
        std::string names;
        for (const std::string& name : robostress::piper::FaultNames())
          names += (names.empty() ? "" : ", ") + name;
        return names;
      }());
  app.add_option("--teach", line.teach,
                 "FROM[+DURATION]: the arm's teaching mode, from that second on");
  app.add_flag("--leader", line.options.leader, "a leader arm: limp, it commands its follower");
  app.add_option("--hand", line.hand,
                 "a hand that guides the arm while it is taught or leads: CSV t,J1,J2,J3,J4,J5,J6,"
                 "opening [s, rad, m]");
  app.add_option("--start-deg", line.start_deg, "Joint angles at power-on [degrees]")
      ->expected(6)
      ->delimiter(',');
  app.add_option("--views", line.views,
                 "also draw the base and wrist views: files PREFIX.base and PREFIX.wrist, e.g. "
                 "/dev/shm/piper, for robot_client --camera base=mapped:PREFIX.base");
  app.add_option("--view-size", line.view_size,
                 "square views of so many pixels (default: 320 x 240)")
      ->check(robostress::cli::Range(16, 1024));
  app.add_option("--task", line.task,
                 "a table with objects: bowl_next_to_plate, bowl_on_cabinet, bowl_on_box or "
                 "open_drawer");
  app.add_option("--variant", line.variant, "what bowl and plate look like")->capture_default_str();
  app.add_option("--seconds", line.duration_s, "End after this long (default: on a signal)")
      ->check(robostress::cli::NonNegativeNumber());
  return robostress::RunMain(
      app, argc, argv,
      [&] {
        std::signal(SIGINT, [](int) { robostress::piper::stop_asked = 1; });
        std::signal(SIGTERM, [](int) { robostress::piper::stop_asked = 1; });
        return robostress::piper::Run(line);
      },
      [](const absl::Status&) { return robostress::kWrongCommand; });
}
