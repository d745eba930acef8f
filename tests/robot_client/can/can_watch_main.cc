// can_watch: a client without an arm on a real CAN bus, for vcan_machine.sh. It sends the frames of
// a command at 30 Hz, reads, and says what it notices and when: a line per change.
#include <array>
#include <csignal>
#include <cstdio>
#include <string>

#include "common/command_line.h"
#include "common/run_main.h"
#include "robot_client/can/bus_address.h"

namespace robostress {
namespace {

volatile std::sig_atomic_t stop_asked = 0;

int Watch(const std::string& address, double seconds) {
  MonotonicClock clock;
  auto bus = MakeCanBus(address, clock);
  absl::Status status = bus.ok() ? (*bus)->Open() : bus.status();
  if (!status.ok()) {
    std::printf("can_watch: %s\n", std::string(status.message()).c_str());
    return 2;
  }
  const int64_t start_ns = clock.now_ns();
  std::string before;
  constexpr std::array<uint16_t, 5> kCommand = {0x151, 0x155, 0x156, 0x157, 0x159};
  for (int64_t tick = 0; !stop_asked; ++tick) {
    const int64_t due_ns = start_ns + tick * 33'333'333;
    if (1e-9 * static_cast<double>(due_ns - start_ns) > seconds) break;
    clock.SleepUntil(due_ns);
    StampedFrame received;
    for (int i = 0; i < 1000 && (*bus)->Receive(received); ++i) {
    }
    bool taken = true;
    for (const uint16_t id : kCommand) taken = taken && (*bus)->Send({id, 8, {}}).ok();
    const CanHealth health = (*bus)->health();
    const std::string now = std::string(CanStateName(health.state)) +
                            (taken ? ", takes commands" : ", refuses commands") +
                            (health.restart == CanRestart::kDone       ? ", taken down and up"
                             : health.restart == CanRestart::kNoRights ? ", no right to restart"
                                                                       : "");
    if (now != before) {
      // The machine's uptime, as a shell reads it from /proc/uptime.
      std::printf("%.3f %s; %s\n", 1e-9 * static_cast<double>(clock.now_ns()), now.c_str(),
                  BusAdvice((*bus)->description(), health).c_str());
      std::fflush(stdout);
    }
    before = now;
  }
  const CanHealth health = (*bus)->health();
  std::printf("sent %llu, echoes %llu, refused %llu (stalled %llu), reopened %llu, bus-offs %llu\n",
              static_cast<unsigned long long>(health.sent),
              static_cast<unsigned long long>(health.own_echoes),
              static_cast<unsigned long long>(health.send_failures),
              static_cast<unsigned long long>(health.stalled_sends),
              static_cast<unsigned long long>(health.reopened),
              static_cast<unsigned long long>(health.bus_offs));
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Sends a command's frames at 30 Hz and says what it notices.",
                           "can_watch");
  std::string bus;
  double seconds = 1e9;
  app.add_option("bus", bus, "can:INTERFACE")->required();
  app.add_option("--seconds", seconds, "ends after this long");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  std::signal(SIGINT, [](int) { robostress::stop_asked = 1; });
  std::signal(SIGTERM, [](int) { robostress::stop_asked = 1; });
  return robostress::Watch(bus, seconds);
}
