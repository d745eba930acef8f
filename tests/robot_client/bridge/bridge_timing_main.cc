// bridge_timing: how long a command takes to a driver and a state to the client, beside bytes of
// the same size between two threads over the same kind of socket, which is the least that they can
// take.
//
//   emulated_driver.py --socket /tmp/arm &
//   bridge_timing --socket /tmp/arm --robot five_servos.yaml --seconds 60
//
// It stands in for the client's end: a command every control period, states as they come. Prints a
// Markdown table [ms].

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "common/clock.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/bridge/robot_file.h"

namespace robostress::bridge {
namespace {

struct Line {
  std::string socket, robot;
  double seconds = 5;
  std::vector<double> rates{30, 100};
};

struct Times {
  std::vector<double> command_ms, state_ms;
};

void Print(const std::string& name, double rate_hz, std::vector<double> ms) {
  if (ms.empty()) return;
  std::sort(ms.begin(), ms.end());
  const auto at = [&](double share) {
    return ms[std::min(ms.size() - 1, static_cast<size_t>(share * static_cast<double>(ms.size())))];
  };
  std::printf("| %s | %.0f | %zu | %.3f | %.3f | %.3f |\n", name.c_str(), rate_hz, ms.size(),
              at(0.5), at(0.99), ms.back());
}

absl::StatusOr<int> Dial(const std::string& path) {
  const int descriptor = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_un where{};
  where.sun_family = AF_UNIX;
  path.copy(where.sun_path, sizeof where.sun_path - 1);
  if (connect(descriptor, reinterpret_cast<const sockaddr*>(&where), sizeof where) != 0)
    return absl::UnavailableError(absl::StrCat(path, ": ", std::strerror(errno)));
  return descriptor;
}

// One driver's connection, with the time at which each frame came.
class Timer {
 public:
  Timer(int descriptor, int axes) : descriptor_(descriptor), axes_(axes) {}

  absl::Status Write(const uint8_t* data, size_t size) {
    if (send(descriptor_, data, size, MSG_NOSIGNAL) != static_cast<ssize_t>(size))
      return absl::UnavailableError("the driver is gone");
    return absl::OkStatus();
  }
  // What comes until `until_ns`; each state's way is noted in `times`.
  absl::Status ReadUntil(int64_t until_ns, Times* times) {
    while (clock_.now_ns() < until_ns) {
      const int64_t left_ns = until_ns - clock_.now_ns();
      const timespec wait{left_ns / 1'000'000'000, left_ns % 1'000'000'000};
      pollfd ready{descriptor_, POLLIN, 0};
      if (left_ns <= 0 || ppoll(&ready, 1, &wait, nullptr) <= 0) continue;
      uint8_t bytes[8192];
      const ssize_t count = recv(descriptor_, bytes, sizeof bytes, 0);
      const int64_t now_ns = clock_.now_ns();
      if (count <= 0) return absl::UnavailableError("the driver is gone");
      came_.insert(came_.end(), bytes, bytes + count);
      FrameHeader header;
      while (!came_.empty() &&
             DecodeHeader(came_.data(), came_.size(), header) == Decoded::kFrame) {
        if (times != nullptr && header.kind == FrameKind::kState) Note(header, now_ns, *times);
        came_.erase(came_.begin(), came_.begin() + static_cast<long>(kHeaderBytes) + header.size);
      }
    }
    return absl::OkStatus();
  }
  absl::Status Command(CommandMode mode, const ArmVector& position) {
    CommandFrame command;
    command.stamp_ns = clock_.now_ns();
    command.mode = mode;
    command.axes = axes_;
    command.position = position;
    std::array<uint8_t, kMostFrame> bytes;
    const size_t size = EncodeCommand(command, ++sequence_, bytes);
    stamps_.resize(sequence_ + 1);
    stamps_[sequence_] = command.stamp_ns;
    return Write(bytes.data(), size);
  }
  const ArmVector& position() const { return state_.position; }
  uint64_t& sequence() { return sequence_; }

 private:
  void Note(const FrameHeader& header, int64_t now_ns, Times& times) {
    if (DecodeState(came_.data() + kHeaderBytes, header.size, axes_, state_) != Decoded::kFrame)
      return;
    times.state_ms.push_back(1e-6 * static_cast<double>(now_ns - state_.sent_ns));
    if (state_.command <= noted_ || state_.command >= stamps_.size()) return;
    noted_ = state_.command;
    times.command_ms.push_back(1e-6 *
                               static_cast<double>(state_.command_ns - stamps_[state_.command]));
  }

  const int descriptor_;
  const int axes_;
  MonotonicClock clock_;
  std::vector<uint8_t> came_;
  std::vector<int64_t> stamps_;  // of commands, by sequence
  uint64_t sequence_ = 0, noted_ = 0;
  StateFrame state_;
};

absl::Status Drive(const Line& line, const BridgeRobot& robot, double rate_hz, Times& times) {
  RS_ASSIGN_OR_RETURN(const int descriptor, Dial(line.socket));
  Timer timer(descriptor, robot.limits.axes.count());
  MonotonicClock clock;
  const std::vector<uint8_t> hello =
      EncodeText(FrameKind::kHello, ++timer.sequence(),
                 HelloText(robot.name, robot.names(), robot.limits.axes.gripper, rate_hz));
  RS_RETURN_IF_ERROR(timer.Write(hello.data(), hello.size()));
  Times ignored;
  RS_RETURN_IF_ERROR(timer.ReadUntil(clock.now_ns() + 300'000'000, &ignored));
  const ArmVector stands = timer.position();
  RS_RETURN_IF_ERROR(timer.Command(CommandMode::kEnable, stands));
  const auto period_ns = static_cast<int64_t>(1e9 / rate_hz);
  const int64_t end_ns = clock.now_ns() + static_cast<int64_t>(line.seconds * 1e9);
  for (int64_t due_ns = clock.now_ns() + period_ns; due_ns < end_ns; due_ns += period_ns) {
    RS_RETURN_IF_ERROR(timer.ReadUntil(due_ns, &times));
    RS_RETURN_IF_ERROR(timer.Command(CommandMode::kTarget, stands));
  }
  close(descriptor);
  return absl::OkStatus();
}

// A thread that waits on the other end of a pair, and notes when bytes came.
std::vector<double> Raw(double rate_hz, double seconds, size_t size) {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) return {};
  std::vector<double> ms;
  MonotonicClock clock;
  std::thread reader([&] {
    std::vector<uint8_t> bytes(size);
    while (recv(ends[1], bytes.data(), size, MSG_WAITALL) == static_cast<ssize_t>(size)) {
      int64_t sent_ns;
      std::memcpy(&sent_ns, bytes.data(), sizeof sent_ns);
      ms.push_back(1e-6 * static_cast<double>(clock.now_ns() - sent_ns));
    }
  });
  std::vector<uint8_t> bytes(size);
  const auto period_ns = static_cast<int64_t>(1e9 / rate_hz);
  const int64_t end_ns = clock.now_ns() + static_cast<int64_t>(seconds * 1e9);
  for (int64_t due_ns = clock.now_ns() + period_ns; due_ns < end_ns; due_ns += period_ns) {
    clock.SleepUntil(due_ns);
    const int64_t now_ns = clock.now_ns();
    std::memcpy(bytes.data(), &now_ns, sizeof now_ns);
    if (send(ends[0], bytes.data(), size, MSG_NOSIGNAL) != static_cast<ssize_t>(size)) break;
  }
  close(ends[0]);
  reader.join();
  close(ends[1]);
  return ms;
}

absl::Status Run(const Line& line) {
  RS_ASSIGN_OR_RETURN(const BridgeRobot robot, LoadBridgeRobot(line.robot));
  std::printf("| way | rate [Hz] | n | median | 99 %% | most |\n|---|---:|---:|---:|---:|---:|\n");
  for (const double rate_hz : line.rates) {
    Times times;
    std::vector<double> raw;
    std::thread beside([&] {
      raw = Raw(rate_hz, line.seconds,
                kHeaderBytes + kCommandBytes + 8 * static_cast<size_t>(robot.limits.axes.count()));
    });
    const absl::Status driven = Drive(line, robot, rate_hz, times);
    beside.join();
    RS_RETURN_IF_ERROR(driven);
    if (times.command_ms.empty() || times.state_ms.empty())
      return absl::UnavailableError("no command was taken, or no state came");
    Print("command to the driver", rate_hz, std::move(times.command_ms));
    Print("state to the client", rate_hz, std::move(times.state_ms));
    Print("bytes between two threads", rate_hz, std::move(raw));
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::bridge

int main(int argc, char** argv) {
  robostress::cli::App app("Times a driver's end of the bridge.", "bridge_timing");
  robostress::bridge::Line line;
  app.add_option("--socket", line.socket, "path of the driver's socket")->required();
  app.add_option("--robot", line.robot, "robot file")->required();
  app.add_option("--seconds", line.seconds, "of each rate");
  app.add_option("--rates", line.rates, "of commands [Hz]");
  return robostress::RunMain(app, argc, argv, [&] { return robostress::bridge::Run(line); });
}
