#include "robot_client/teach/gamepad.h"

#include <fcntl.h>
#include <linux/joystick.h>
#include <poll.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr int kPoll_ms = 20;

class SystemFiles : public GamepadFiles {
 public:
  int Open(const char* path) override { return open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC); }
  int Close(int fd) override { return close(fd); }
  ssize_t Read(int fd, void* data, size_t size) override { return read(fd, data, size); }
  int Poll(int fd, int timeout_ms) override {
    pollfd wait{fd, POLLIN, 0};
    return poll(&wait, 1, timeout_ms);
  }
};

}  // namespace

const char kGamepadHelp[] =
    "Gamepad, while the arm follows it: hold the left shoulder button, or nothing moves\n"
    "  left stick forwards, back, left, right; right stick up, down, yaw; cross roll, pitch\n"
    "  A opens, B closes the gripper\n";

std::unique_ptr<GamepadFiles> MakeGamepadFiles() { return std::make_unique<SystemFiles>(); }

Gamepad::~Gamepad() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  if (fd_ >= 0) files_->Close(fd_);
}

absl::Status Gamepad::Open() {
  fd_ = files_->Open(options_.device.c_str());
  if (fd_ >= 0) return absl::OkStatus();
  return absl::NotFoundError(absl::StrCat(
      "gamepad ", options_.device, ": ", std::strerror(errno),
      "; plug it in, or name its file as in --by gamepad:/dev/input/js1 (ls /dev/input/js*); you "
      "must be allowed to read it (group input)"));
}

// Nothing in the middle, and from there on the whole range.
double Gamepad::Axis(int which) const {
  const double value = axes_[options_.axes[which]], size = std::abs(value);
  if (size <= options_.dead_zone) return 0;
  return std::copysign((size - options_.dead_zone) / (1 - options_.dead_zone), value);
}

void Gamepad::Publish(bool gone) {
  JogInput input;
  input.gone = gone;
  input.stamp_ns = clock_->now_ns();
  if (!gone && buttons_[options_.dead_man]) {
    input.tool[0] = -Axis(1);
    input.tool[1] = -Axis(0);
    input.tool[2] = -Axis(3);
    input.tool[3] = Axis(4);
    input.tool[4] = -Axis(5);
    input.tool[5] = -Axis(2);
    input.gripper = (buttons_[options_.open] ? 1 : 0) - (buttons_[options_.close] ? 1 : 0);
  }
  input_.Store(input);
}

// The driver tells the state at opening with JS_EVENT_INIT: a button that was held then counts as
// released until it is pressed anew.
void Gamepad::Take(uint8_t type, uint8_t number, int16_t value) {
  if ((type & ~JS_EVENT_INIT) == JS_EVENT_AXIS && number < axes_.size())
    axes_[number] = std::clamp(value / 32767.0, -1.0, 1.0);
  if (type == JS_EVENT_BUTTON && number < buttons_.size()) buttons_[number] = value != 0;
}

bool Gamepad::Poll(int timeout_ms) {
  if (fd_ < 0) return false;
  bool there = files_->Poll(fd_, timeout_ms) >= 0 || errno == EINTR;
  while (there) {
    js_event event;
    const ssize_t count = files_->Read(fd_, &event, sizeof event);
    if (count == static_cast<ssize_t>(sizeof event)) {
      Take(event.type, event.number, event.value);
      continue;
    }
    there = count < 0 && (errno == EAGAIN || errno == EINTR);
    break;
  }
  Publish(!there);
  if (!there) {
    files_->Close(fd_);
    fd_ = -1;
  }
  return there;
}

void Gamepad::StartThread() {
  thread_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "gamepad");
    while (!stop_.load(std::memory_order_acquire) && Poll(kPoll_ms)) {
    }
  });
}

}  // namespace robostress
