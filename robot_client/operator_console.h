#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "absl/status/statusor.h"

namespace robostress {

// What a person tells the client, one order a line on standard input.
enum class OperatorCommand {
  kEnable,
  kHome,     // drives to the configured starting pose
  kJog,      // moves one joint
  kPlay,     // plays the run's motion
  kFollow,   // teach: the arm follows leader, keyboard or gamepad
  kRecord,   // teach: a demonstration begins
  kDiscard,  // teach: ... and is dropped
  kStart,
  kHold,  // also an empty line: the nearest key stops
  kResume,
  kSuccess,  // ends the episode, counted as a success
  kFailure,  // ends the episode, counted as a failure
  kEnd,      // ends the episode, not judged
  kClear,
  kQuickStop,
  kQuit,      // the arm keeps its power and holds
  kQuitLimp,  // the arm loses its power and FALLS
};
inline constexpr int kGripperAxis = -1;
struct OperatorOrder {
  OperatorCommand command = OperatorCommand::kHold;
  int axis = 0;       // kJog: 0 is J1; or kGripperAxis
  double amount = 0;  // kJog: [rad], [m]; kPlay: of the motion's own speed
};

// The speed of `play slow`.
inline constexpr double kSlowly = 0.25;

// The order of a line. INVALID_ARGUMENT says what is wrong and what to type.
absl::StatusOr<OperatorOrder> ParseOperatorOrder(std::string_view line);
extern const char kOperatorHelp[];

// Takes single keys instead of lines.
class KeySink {
 public:
  virtual ~KeySink() = default;
  virtual void Take(std::string_view bytes, std::deque<OperatorOrder>* orders) = 0;
  virtual void End() = 0;  // no more will come
};

// Standard input and signals as orders. SIGINT: one means hold, a second within three seconds the
// quick stop, a third quit. SIGTERM and SIGHUP, which programs send and not people, hold and then
// quit; they never make the arm sink. The end of the input means hold, for nobody can press Enter
// any more: a pipe's once its last line was obeyed, Ctrl-D at a terminal whenever it is typed. An
// input that never had an order is nobody's. One object at a time, one thread.
class OperatorConsole {
 public:
  OperatorConsole();  // takes the signals over, and ignores a closed output
  ~OperatorConsole();

  // The next order, waiting for up to `timeout_ms`. Of lines that come from a program and not from
  // a terminal those that stop nothing stay where they are while `busy`. A line that is no order
  // holds, and its error is in `complaint` once.
  std::optional<OperatorOrder> Next(int timeout_ms, bool busy = false);
  // Bytes go to `keys` as they come, until it is null again. It outlives that.
  void GiveKeysTo(KeySink* keys) { keys_ = keys; }
  std::string TakeComplaint() { return std::exchange(complaint_, ""); }
  bool input_ended() const { return ended_; }  // a terminal's: when it was closed
  // Counts the signals as they come, for ControlLoop::ObeyStops.
  static const std::atomic<int>* presses();
  static const std::atomic<int>* gentle_presses();

 private:
  void Read(int timeout_ms);
  void TakeBytes(std::string_view bytes);
  void TakeEnd(bool for_good);
  std::optional<OperatorCommand> OfSignals();

  int signals_seen_ = 0, terminations_seen_ = 0;
  int stage_ = 0;  // presses in a row
  int64_t last_press_ns_ = 0;
  const bool terminal_;
  bool ended_ = false;
  bool attended_ = false;  // an order came, and the end of the input was not told
  KeySink* keys_ = nullptr;
  std::string buffer_, complaint_;
  std::deque<OperatorOrder> orders_;
};

}  // namespace robostress
