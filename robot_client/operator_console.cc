#include "robot_client/operator_console.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/clock.h"
#include "robot_client/robot_arm.h"

namespace robostress {
namespace {

std::atomic<int> signals{0}, terminations{0};
static_assert(std::atomic<int>::is_always_lock_free);  // or a handler could not touch it
void CountSignal(int) { signals.fetch_add(1); }
void CountTermination(int) { terminations.fetch_add(1); }
constexpr int64_t kWindow_ns = 3'000'000'000;
constexpr double kMostJog = 0.5;          // [rad]
constexpr double kMostOpeningJog = 0.05;  // [m]

constexpr std::pair<const char*, OperatorCommand> kCommands[] = {
    {"enable", OperatorCommand::kEnable},   {"start", OperatorCommand::kStart},
    {"home", OperatorCommand::kHome},       {"", OperatorCommand::kHold},
    {"hold", OperatorCommand::kHold},       {"resume", OperatorCommand::kResume},
    {"success", OperatorCommand::kSuccess}, {"failure", OperatorCommand::kFailure},
    {"end", OperatorCommand::kEnd},         {"clear", OperatorCommand::kClear},
    {"stop", OperatorCommand::kQuickStop},  {"follow", OperatorCommand::kFollow},
    {"record", OperatorCommand::kRecord},   {"discard", OperatorCommand::kDiscard},
    {"quit", OperatorCommand::kQuit},       {"quit limp", OperatorCommand::kQuitLimp},
};

bool Stops(OperatorCommand command) {
  return command == OperatorCommand::kHold || command == OperatorCommand::kQuickStop;
}

absl::StatusOr<OperatorOrder> ParseJog(const std::vector<std::string>& words) {
  const auto wrong = [] {
    return absl::InvalidArgumentError(
        absl::StrCat("a jog is a joint and a way: 'jog J2 5deg', 'jog J2 -0.05rad', 'jog gripper "
                     "10mm'; at most ",
                     kMostJog, " rad or ", 1000 * kMostOpeningJog, " mm at a time"));
  };
  if (words.size() != 3) return wrong();
  OperatorOrder order{OperatorCommand::kJog};
  absl::string_view amount = words[2];
  double unit = 0;
  if (words[1] == "gripper") {
    order.axis = kGripperAxis;
    unit = absl::ConsumeSuffix(&amount, "mm") ? 1e-3 : 0;
  } else {
    if (words[1].size() != 2 || words[1][0] != 'j' || words[1][1] < '1' ||
        words[1][1] > '0' + kMostJoints)
      return wrong();
    order.axis = words[1][1] - '1';
    if (absl::ConsumeSuffix(&amount, "deg")) unit = M_PI / 180;
    if (absl::ConsumeSuffix(&amount, "rad")) unit = 1;
  }
  if (unit == 0 || !absl::SimpleAtod(amount, &order.amount)) return wrong();
  order.amount *= unit;
  if (!(std::abs(order.amount) <= (order.axis == kGripperAxis ? kMostOpeningJog : kMostJog)))
    return wrong();
  return order;
}

absl::StatusOr<OperatorOrder> ParsePlay(const std::vector<std::string>& words) {
  OperatorOrder order{OperatorCommand::kPlay};
  order.amount = 1;
  const bool fine =
      words.size() == 1 ||
      (words.size() == 2 && (words[1] == "slow" || (absl::SimpleAtod(words[1], &order.amount) &&
                                                    order.amount >= 0.01 && order.amount <= 1)));
  if (!fine)
    return absl::InvalidArgumentError(
        "a motion is played by 'play slow', 'play 0.5' (of its speed, 0.01 to 1) or 'play'");
  if (words.size() == 2 && words[1] == "slow") order.amount = kSlowly;
  return order;
}

}  // namespace

const char kOperatorHelp[] =
    "Orders, one a line\n"
    "  enable      give the joints power; the arm holds where it is\n"
    "  jog J2 5deg move one joint that far, slowly (rad, deg; jog gripper 10mm)\n"
    "  home        drive to the configured starting pose, slowly: clear the way first\n"
    "  play slow   play the motion of replay or excite at a quarter of its speed; then play\n"
    "  start       begin an episode\n"
    "  hold        or just Enter, or Ctrl-C: brake and hold\n"
    "  resume      go on with the episode that was held\n"
    "  success     end the episode: the task was done      failure   ... it was not\n"
    "  end         end the episode without a judgement\n"
    "  stop        or Ctrl-C again within 3 s: damped stop, the arm SINKS\n"
    "  clear       leave FAULT once its cause is gone; then enable again\n"
    "  quit        leave; the arm keeps its power and holds\n"
    "  quit limp   leave and take the power off: the arm FALLS, support it\n";

absl::StatusOr<OperatorOrder> ParseOperatorOrder(std::string_view line) {
  const std::string text = absl::AsciiStrToLower(
      absl::StripAsciiWhitespace(absl::string_view(line.data(), line.size())));
  for (const auto& [name, command] : kCommands) {
    if (text == name) return OperatorOrder{command};
  }
  const std::vector<std::string> words = absl::StrSplit(text, ' ', absl::SkipEmpty());
  if (!words.empty() && words[0] == "jog") return ParseJog(words);
  if (!words.empty() && words[0] == "play") return ParsePlay(words);
  return absl::InvalidArgumentError(
      absl::StrCat("'", text.substr(0, 64), "' is no order; the arm holds\n", kOperatorHelp));
}

const std::atomic<int>* OperatorConsole::presses() { return &signals; }
const std::atomic<int>* OperatorConsole::gentle_presses() { return &terminations; }

OperatorConsole::OperatorConsole()
    : signals_seen_(signals), terminations_seen_(terminations), terminal_(isatty(STDIN_FILENO)) {
  struct sigaction action {};
  action.sa_handler = CountSignal;
  sigaction(SIGINT, &action, nullptr);
  action.sa_handler = CountTermination;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGHUP, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
}

OperatorConsole::~OperatorConsole() {
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) std::signal(number, SIG_DFL);
}

void OperatorConsole::Read(int timeout_ms) {
  pollfd wait{ended_ ? -1 : STDIN_FILENO, POLLIN, 0};
  // A signal ends the wait.
  if (poll(&wait, 1, timeout_ms) <= 0) return;
  char bytes[256];
  const ssize_t count = read(STDIN_FILENO, bytes, sizeof(bytes));
  if (count > 0) return TakeBytes({bytes, static_cast<size_t>(count)});
  if (count < 0 && (errno == EINTR || errno == EAGAIN)) return;
  TakeEnd(count < 0 || !terminal_ || (wait.revents & POLLHUP) != 0);
}

void OperatorConsole::TakeEnd(bool for_good) {
  if (!for_good) {  // Ctrl-D
    complaint_ = "end of input: the arm holds; Enter goes on stopping it, quit leaves";
    orders_.push_back({OperatorCommand::kHold});
    return;
  }
  ended_ = true;
  if (keys_ != nullptr) keys_->End();
}

void OperatorConsole::TakeBytes(std::string_view bytes) {
  attended_ = true;
  if (keys_ != nullptr) {
    keys_->Take(bytes, &orders_);
  } else {
    buffer_.append(bytes);
  }
  for (size_t end; (end = buffer_.find('\n')) != std::string::npos; buffer_.erase(0, end + 1)) {
    const absl::StatusOr<OperatorOrder> order =
        ParseOperatorOrder(std::string_view(buffer_).substr(0, end));
    if (!order.ok()) complaint_ = std::string(order.status().message());
    // Whoever types something unknown while the arm moves may have meant to stop it.
    orders_.push_back(order.value_or(OperatorOrder{OperatorCommand::kHold}));
  }
}

std::optional<OperatorCommand> OperatorConsole::OfSignals() {
  if (terminations_seen_ < terminations) {
    // The loop holds at once; quitting leaves the arm with its power.
    terminations_seen_ = terminations;
    return OperatorCommand::kQuit;
  }
  if (signals_seen_ >= signals) return std::nullopt;
  ++signals_seen_;
  const int64_t now = MonotonicClock().now_ns();
  stage_ = now - last_press_ns_ < kWindow_ns ? stage_ + 1 : 1;
  last_press_ns_ = now;
  if (stage_ == 1) return OperatorCommand::kHold;
  return stage_ == 2 ? OperatorCommand::kQuickStop : OperatorCommand::kQuit;
}

std::optional<OperatorOrder> OperatorConsole::Next(int timeout_ms, bool busy) {
  const auto ready = [&] {
    return std::find_if(orders_.begin(), orders_.end(), [&](const OperatorOrder& order) {
      return !busy || terminal_ || Stops(order.command);
    });
  };
  if (signals_seen_ == signals && terminations_seen_ == terminations && ready() == orders_.end())
    Read(timeout_ms);
  if (const auto command = OfSignals()) return OperatorOrder{*command};
  const auto next = ready();
  if (ended_ && orders_.empty() && std::exchange(attended_, false)) {
    complaint_ =
        absl::StrCat("the input has ended and nobody can type any more: the arm holds; kill -TERM ",
                     getpid(), " ends the client, and the arm keeps its power");
    return OperatorOrder{OperatorCommand::kHold};
  }
  if (next == orders_.end()) return std::nullopt;
  const OperatorOrder order = *next;
  orders_.erase(next);
  return order;
}

}  // namespace robostress
