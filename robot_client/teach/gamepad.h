#pragma once

#include <sys/types.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <memory>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "common/clock.h"
#include "robot_client/snapshot_cell.h"
#include "robot_client/teach/jog_target.h"

namespace robostress {

// The system calls of a gamepad; -1 and errno as the originals. Tests put a gamepad behind it.
class GamepadFiles {
 public:
  virtual ~GamepadFiles() = default;
  virtual int Open(const char* path) = 0;  // read, non-blocking, close-on-exec
  virtual int Close(int fd) = 0;
  virtual ssize_t Read(int fd, void* data, size_t size) = 0;
  virtual int Poll(int fd, int timeout_ms) = 0;  // 1 readable or gone, 0 timeout, -1 error
};
std::unique_ptr<GamepadFiles> MakeGamepadFiles();

struct GamepadOptions {
  std::string device = "/dev/input/js0";
  double dead_zone = 0.15;  // share of a stick's way around its middle that means nothing
  int dead_man = 4;         // button that must be held; 4 is the left shoulder of most pads
  // Axes of the sticks as Linux's xpad numbers them: left x, y, right x, y, cross x, y.
  std::array<int, 6> axes = {0, 1, 3, 4, 6, 7};
  int open = 0, close = 1;  // buttons of the gripper
};

extern const char kGamepadHelp[];

// A gamepad through Linux's joystick interface (linux/joystick.h). Nothing moves unless its
// dead man's button is held, and was pressed after the device was opened. Left stick: forwards,
// back, left, right. Right stick: up, down, yaw. Cross: roll, pitch. A pad that is unplugged is
// `gone`; so is one whose reading fails.
class Gamepad {
 public:
  Gamepad(GamepadOptions options, std::unique_ptr<GamepadFiles> files, const Clock* clock)
      : options_(std::move(options)), files_(std::move(files)), clock_(clock) {}
  ~Gamepad();

  // The error names device, cause and remedy.
  absl::Status Open();
  // Takes in what happens within `timeout_ms`; one thread. False: it is gone.
  bool Poll(int timeout_ms);
  // Polls in a thread of its own until the end.
  void StartThread();

  const SnapshotCell<JogInput>& input() const { return input_; }

 private:
  void Take(uint8_t type, uint8_t number, int16_t value);
  void Publish(bool gone);
  double Axis(int which) const;

  const GamepadOptions options_;
  const std::unique_ptr<GamepadFiles> files_;
  const Clock* const clock_;
  int fd_ = -1;
  std::array<double, 32> axes_{};  // -1 .. 1
  std::array<bool, 32> buttons_{};
  SnapshotCell<JogInput> input_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace robostress
