// piper_emulator: a Piper in software on a CAN bus, in real time. A client or the vendor's SDK sees
// the frames of an arm; see README.md beside this file.

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/clock.h"
#include "common/status_macros.h"
#include "robot_client/can/bus_address.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/emulator/view_server.h"

namespace robostress::piper {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  piper_emulator --bus udp:239.74.163.2:43113 --profile new\n"
    "  piper_emulator --bus udp:239.74.163.2:43113 --profile used_one_year --payload-kg 1.0\n"
    "  piper_emulator --bus udp:239.74.163.2:43114 --fault collision:J2@20 --fault silent@30+0.5\n"
    "  piper_emulator --bus can:vcan0 --firmware S-V1.8-2 --command-lag-ms 100\n\n"
    "One port per arm. Frames stay on this machine unless the bus names an interface\n"
    "(udp:239.74.163.2:43113%eth1). The arm starts on its rest, disabled; Ctrl-C ends it.\n";

struct CommandLine {
  std::string bus = "udp:239.74.163.2:43113";
  std::string firmware = "S-V1.8-9";
  double command_lag_ms = -1;
  std::vector<std::string> faults;
  std::vector<double> start_deg;
  double duration_s = 0;
  std::string views;
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
  if (!line.views.empty()) {
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
  // An arm in software beside a real one on the same wires would answer for it.
  if (absl::StartsWith(line.bus, "can:") && !absl::StartsWith(line.bus, "can:vcan"))
    return absl::InvalidArgumentError(absl::StrCat(
        "--bus ", line.bus, ": an emulator runs on virtual interfaces only (can:vcan0, udp:...)"));
  return options;
}

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
  std::unique_ptr<ViewServer> views;
  if (!line.views.empty()) {
    RS_ASSIGN_OR_RETURN(views,
                        ViewServer::Create({.prefix = line.views}, emulator->plant(), &clock));
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
    if (views != nullptr && ++ticks % 16 == 0) views->Show(emulator->plant().data());
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
  CLI::App app("An AgileX Piper in software: mechanics, firmware and frames on a CAN bus.",
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
      ->check(CLI::Range(0.0, 3.0))
      ->capture_default_str();
  app.add_option("--firmware", line.firmware, "Version that the arm reports")
      ->capture_default_str();
  app.add_option("--command-lag-ms", line.command_lag_ms,
                 "From a target's frame to its effect (default: the profile's)")
      ->check(CLI::Range(0.0, 1000.0));
  app.add_flag("--motor-encoders", line.options.motor_encoders,
               "Encoders before backlash and compliance (default: at the joints)");
  app.add_option(
      "--fault", line.faults, "KIND[:J1..J6]@SECONDS[+DURATION], repeatable: " + [] {
        std::string names;
        for (const std::string& name : robostress::piper::FaultNames())
          names += (names.empty() ? "" : ", ") + name;
        return names;
      }());
  app.add_option("--start-deg", line.start_deg, "Joint angles at power-on [degrees]")
      ->expected(6)
      ->delimiter(',');
  app.add_option("--views", line.views,
                 "also draw the base and wrist views: files PREFIX.base and PREFIX.wrist, e.g. "
                 "/dev/shm/piper, for robot_client --camera base=mapped:PREFIX.base");
  app.add_option("--seconds", line.duration_s, "End after this long (default: on a signal)")
      ->check(CLI::NonNegativeNumber);
  CLI11_PARSE(app, argc, argv);
  std::signal(SIGINT, [](int) { robostress::piper::stop_asked = 1; });
  std::signal(SIGTERM, [](int) { robostress::piper::stop_asked = 1; });
  if (const absl::Status status = robostress::piper::Run(line); !status.ok()) {
    std::fprintf(stderr, "piper_emulator: %s\n", std::string(status.message()).c_str());
    return 2;
  }
  return 0;
}
