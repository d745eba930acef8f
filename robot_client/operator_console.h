#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

namespace robostress {

// What a person tells the client, one word a line on standard input.
enum class OperatorCommand {
  kEnable,
  kHome,  // drives to the configured starting pose
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

// The command of a line; absent: unknown.
std::optional<OperatorCommand> ParseOperatorCommand(std::string_view line);
extern const char kOperatorHelp[];

// Standard input and signals as commands. SIGINT and SIGTERM: one means hold, a second within three
// seconds the quick stop, a third quit. One object at a time, one thread.
class OperatorConsole {
 public:
  OperatorConsole();  // takes the signals over
  ~OperatorConsole();

  // The next command, waiting for up to `timeout_ms`. Lines that are no command print the help.
  // After the end of the input only signals come.
  std::optional<OperatorCommand> Next(int timeout_ms);
  bool input_ended() const { return ended_; }
  // Counts the signals as they come, for ControlLoop::ObeyStops.
  static const std::atomic<int>* presses();

 private:
  int signals_seen_ = 0;
  int stage_ = 0;  // presses in a row
  int64_t last_press_ns_ = 0;
  bool ended_ = false;
  std::string buffer_;
  std::deque<OperatorCommand> commands_;
};

}  // namespace robostress
