#include "robot_client/bridge/driver_socket.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace robostress::bridge {
namespace {
constexpr int64_t kAsksAgain_ns = 20'000'000;
// A driver that stands still is noticed after this many bytes, and has no long queue of old
// commands to work off afterwards.
constexpr int kSendBuffer = 4096;
}  // namespace

absl::StatusOr<std::unique_ptr<DriverSocket>> DriverSocket::Connect(const std::string& address,
                                                                    double wait_s, Clock& clock) {
  absl::string_view path = address;
  sockaddr_un where{};
  where.sun_family = AF_UNIX;
  if (!absl::ConsumePrefix(&path, "unix:") || path.empty() ||
      path.size() >= sizeof where.sun_path) {
    return absl::InvalidArgumentError(
        absl::StrCat("--arm bridge:", address, " must be bridge:unix:PATH, with a path of at most ",
                     sizeof where.sun_path - 1, " characters"));
  }
  std::copy(path.begin(), path.end(), where.sun_path);
  const int64_t end_ns = clock.now_ns() + static_cast<int64_t>(wait_s * 1e9);
  while (true) {
    const int descriptor = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (descriptor < 0)
      return absl::ResourceExhaustedError(absl::StrCat("socket: ", std::strerror(errno)));
    if (connect(descriptor, reinterpret_cast<const sockaddr*>(&where), sizeof where) == 0)
      return std::make_unique<DriverSocket>(descriptor);
    const int error = errno;
    close(descriptor);
    const bool may_come = error == ENOENT || error == ECONNREFUSED || error == EAGAIN;
    if (!may_come || clock.now_ns() >= end_ns) {
      return absl::UnavailableError(absl::StrCat(
          "no driver at ", address, ": ", std::strerror(error),
          "; start it first, for one: deploy/robostress_bridge_lerobot.py --socket ", path));
    }
    clock.SleepUntil(std::min(clock.now_ns() + kAsksAgain_ns, end_ns));
  }
}

DriverSocket::DriverSocket(int descriptor) : descriptor_(descriptor) {
  setsockopt(descriptor_, SOL_SOCKET, SO_SNDBUF, &kSendBuffer, sizeof kSendBuffer);
}

DriverSocket::~DriverSocket() { Close(); }

void DriverSocket::Close() {
  if (descriptor_ >= 0) close(descriptor_);
  descriptor_ = -1;
}

DriverSocket::Result DriverSocket::Send(const uint8_t* data, size_t size) {
  if (closed()) return Result::kClosed;
  ssize_t sent = 0;
  do {
    sent = send(descriptor_, data, size, MSG_DONTWAIT | MSG_NOSIGNAL);
  } while (sent < 0 && errno == EINTR);
  if (sent == static_cast<ssize_t>(size)) return Result::kDone;
  if (sent < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return Result::kWouldWait;
  if (sent >= 0) Close();  // a part of a frame would shift all that follows
  return Result::kClosed;  // what the driver said before it hung up can still be received
}

DriverSocket::Result DriverSocket::Receive(uint8_t* data, size_t size, size_t& received) {
  if (closed()) return Result::kClosed;
  ssize_t count = 0;
  do {
    count = recv(descriptor_, data, size, MSG_DONTWAIT);
  } while (count < 0 && errno == EINTR);
  if (count > 0) {
    received = static_cast<size_t>(count);
    return Result::kDone;
  }
  if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return Result::kWouldWait;
  Close();
  return Result::kClosed;
}

}  // namespace robostress::bridge
