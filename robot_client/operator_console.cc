#include "robot_client/operator_console.h"

#include <poll.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <utility>

#include "absl/strings/ascii.h"
#include "common/clock.h"

namespace robostress {
namespace {

std::atomic<int> signals{0};
static_assert(std::atomic<int>::is_always_lock_free);  // or a handler could not touch it
void CountSignal(int) { signals.fetch_add(1); }
constexpr int64_t kWindow_ns = 3'000'000'000;

constexpr std::pair<const char*, OperatorCommand> kCommands[] = {
    {"enable", OperatorCommand::kEnable},
    {"start", OperatorCommand::kStart},
    {"home", OperatorCommand::kHome},
    {"", OperatorCommand::kHold},
    {"hold", OperatorCommand::kHold},
    {"resume", OperatorCommand::kResume},
    {"success", OperatorCommand::kSuccess},
    {"failure", OperatorCommand::kFailure},
    {"end", OperatorCommand::kEnd},
    {"clear", OperatorCommand::kClear},
    {"stop", OperatorCommand::kQuickStop},
    {"quit", OperatorCommand::kQuit},
    {"quit limp", OperatorCommand::kQuitLimp},
};

}  // namespace

const char kOperatorHelp[] =
    "Commands, one a line\n"
    "  enable      give the joints power; the arm holds where it is\n"
    "  start       begin an episode\n"
    "  home        drive to the configured starting pose, slowly: clear the way first\n"
    "  hold        or just Enter, or Ctrl-C: brake and hold\n"
    "  resume      go on with the episode that was held\n"
    "  success     end the episode: the task was done      failure   ... it was not\n"
    "  end         end the episode without a judgement\n"
    "  stop        or Ctrl-C again within 3 s: damped stop, the arm SINKS\n"
    "  clear       leave FAULT once its cause is gone; then enable again\n"
    "  quit        leave; the arm keeps its power and holds\n"
    "  quit limp   leave and take the power off: the arm FALLS, support it\n";

std::optional<OperatorCommand> ParseOperatorCommand(std::string_view line) {
  const std::string text = absl::AsciiStrToLower(
      absl::StripAsciiWhitespace(absl::string_view(line.data(), line.size())));
  for (const auto& [name, command] : kCommands) {
    if (text == name) return command;
  }
  return std::nullopt;
}

const std::atomic<int>* OperatorConsole::presses() { return &signals; }

OperatorConsole::OperatorConsole() : signals_seen_(signals) {
  struct sigaction action {};
  action.sa_handler = CountSignal;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

OperatorConsole::~OperatorConsole() {
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

std::optional<OperatorCommand> OperatorConsole::Next(int timeout_ms) {
  if (signals_seen_ == signals && commands_.empty()) {
    pollfd wait{ended_ ? -1 : STDIN_FILENO, POLLIN, 0};
    // A signal ends the wait.
    if (poll(&wait, 1, timeout_ms) > 0) {
      char bytes[256];
      const ssize_t count = read(STDIN_FILENO, bytes, sizeof(bytes));
      if (count <= 0) ended_ = true;
      if (count > 0) buffer_.append(bytes, static_cast<size_t>(count));
    }
    for (size_t end; (end = buffer_.find('\n')) != std::string::npos; buffer_.erase(0, end + 1)) {
      const std::optional<OperatorCommand> command =
          ParseOperatorCommand(std::string_view(buffer_).substr(0, end));
      if (command) {
        commands_.push_back(*command);
      } else {
        std::printf("%s", kOperatorHelp);
        // Whoever types something unknown while the arm moves may have meant to stop it.
        commands_.push_back(OperatorCommand::kHold);
      }
    }
  }
  if (signals_seen_ < signals) {
    ++signals_seen_;
    const int64_t now = MonotonicClock().now_ns();
    stage_ = now - last_press_ns_ < kWindow_ns ? stage_ + 1 : 1;
    last_press_ns_ = now;
    if (stage_ == 1) return OperatorCommand::kHold;
    if (stage_ == 2) return OperatorCommand::kQuickStop;
    return OperatorCommand::kQuit;
  }
  if (commands_.empty()) return std::nullopt;
  const OperatorCommand command = commands_.front();
  commands_.pop_front();
  return command;
}

}  // namespace robostress
