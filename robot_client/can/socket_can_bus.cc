#include "robot_client/can/socket_can_bus.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "robot_client/can/arrival.h"

namespace robostress {
namespace {

constexpr size_t kMaxFilters = 32;
// Every error class; Receive sorts them.
constexpr can_err_mask_t kErrors = CAN_ERR_MASK;

}  // namespace

SocketCanBus::SocketCanBus(SocketCanOptions options, const Clock& clock, SocketCalls& calls)
    : options_(std::move(options)), clock_(clock), calls_(calls) {}

SocketCanBus::~SocketCanBus() {
  if (socket_ >= 0) calls_.Close(socket_);
}

template <class T>
bool SocketCanBus::Set(int level, int option, const T& value) {
  return calls_.SetOption(socket_, level, option, &value, sizeof value) == 0;
}

const char* SocketCanBus::TryOpen() {
  socket_ = calls_.Socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
  if (socket_ < 0) return "opening a CAN socket (does the kernel have can_raw?)";
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = static_cast<int>(calls_.NameToIndex(options_.interface.c_str()));
  if (address.can_ifindex == 0)
    return "finding the interface (is the adapter plugged in? `ip -details link` lists them)";
  if (!Set(SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 0)) return "refusing own frames";
  if (!Set(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, kErrors)) return "asking for error frames";
  if (!Set(SOL_SOCKET, SO_TIMESTAMPNS, 1)) return "asking for arrival times";
  Set(SOL_SOCKET, SO_RXQ_OVFL, 1);      // counts; an old kernel does without
  Set(SOL_SOCKET, SO_RCVBUF, 4 << 20);  // as far as the system allows
  if (!options_.filters.empty()) {
    std::array<can_filter, kMaxFilters> filters{};
    const size_t count = std::min(options_.filters.size(), kMaxFilters);
    for (size_t i = 0; i < count; ++i) {
      // Extended and remote frames are outside the mask's match.
      filters[i] = {options_.filters[i].id, options_.filters[i].mask | CAN_EFF_FLAG | CAN_RTR_FLAG};
    }
    if (calls_.SetOption(socket_, SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                         static_cast<socklen_t>(count * sizeof(can_filter))) != 0)
      return "setting the filters";
  }
  if (calls_.Bind(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return "binding";
  return nullptr;
}

absl::Status SocketCanBus::Open() {
  if (socket_ >= 0) return absl::OkStatus();
  if (options_.filters.size() > kMaxFilters)
    return absl::InvalidArgumentError(
        absl::StrCat("bus '", description(), "': ", options_.filters.size(), " filters; at most ",
                     kMaxFilters, ": join them by their masks"));
  if (const char* failed = TryOpen(); failed != nullptr) {
    const absl::Status status = absl::ErrnoToStatus(
        errno,
        absl::StrCat("bus '", description(), "': ", failed, " failed; set it up with `ip link set ",
                     options_.interface, " up type can bitrate 1000000 restart-ms 100`"));
    if (socket_ >= 0) calls_.Close(socket_);
    socket_ = -1;
    return status;
  }
  health_ = {};
  health_.state = CanState::kActive;
  return absl::OkStatus();
}

void SocketCanBus::GoDown() {
  if (socket_ >= 0) calls_.Close(socket_);
  socket_ = -1;
  overflows_before_ = health_.overflows;
  health_.state = CanState::kDown;
  next_attempt_ns_ = clock_.now_ns() + options_.reopen_interval_ns;
}

void SocketCanBus::ReopenWhenDue() {
  if (health_.state != CanState::kDown || clock_.now_ns() < next_attempt_ns_) return;
  if (TryOpen() != nullptr) {
    GoDown();
    return;
  }
  ++health_.reopened;
  health_.state = CanState::kActive;
}

absl::Status SocketCanBus::Send(const CanFrame& frame) {
  ReopenWhenDue();
  if (socket_ < 0 || health_.state == CanState::kBusOff) {
    ++health_.send_failures;
    return absl::UnavailableError("");
  }
  can_frame wire{};
  wire.can_id = frame.id;
  wire.can_dlc = frame.size;
  std::memcpy(wire.data, frame.data.data(), frame.data.size());
  if (calls_.Send(socket_, &wire, sizeof wire, MSG_DONTWAIT) == sizeof wire) {
    ++health_.sent;
    return absl::OkStatus();
  }
  ++health_.send_failures;
  if (errno == ENOBUFS || errno == EAGAIN) return absl::ResourceExhaustedError("");
  if (errno == ENETDOWN || errno == ENXIO || errno == ENODEV) GoDown();
  return absl::UnavailableError("");
}

bool SocketCanBus::Receive(StampedFrame& frame) {
  ReopenWhenDue();
  while (socket_ >= 0) {
    can_frame wire{};
    iovec piece{&wire, sizeof wire};
    alignas(cmsghdr) char control[128];
    msghdr message{};
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    const ssize_t size = calls_.Receive(socket_, &message, MSG_DONTWAIT);
    if (size < 0) {
      if (errno == ENETDOWN || errno == ENXIO || errno == ENODEV) GoDown();
      return false;
    }
    const Arrival arrival = ReadArrival(message, clock_.now_ns());
    if (arrival.overflows) health_.overflows = overflows_before_ + *arrival.overflows;
    if (size != sizeof wire || wire.can_dlc > 8) {
      ++health_.refused;
    } else if (wire.can_id & CAN_ERR_FLAG) {
      TakeErrorFrame(wire.can_id & CAN_ERR_MASK, wire.data);
    } else if (wire.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG)) {
      ++health_.refused;
    } else {
      frame.frame.id = static_cast<uint16_t>(wire.can_id & CAN_SFF_MASK);
      frame.frame.size = wire.can_dlc;
      std::memcpy(frame.frame.data.data(), wire.data, frame.frame.data.size());
      std::fill(frame.frame.data.begin() + wire.can_dlc, frame.frame.data.end(), 0);
      frame.stamp_ns = arrival.stamp_ns;
      // A controller that receives is back on the bus.
      if (health_.state == CanState::kBusOff) health_.state = CanState::kActive;
      ++health_.received;
      return true;
    }
  }
  return false;
}

// Meaning of the bits: linux/can/error.h.
void SocketCanBus::TakeErrorFrame(uint32_t error_class, const uint8_t (&data)[8]) {
  ++health_.error_frames;
  if (error_class & CAN_ERR_BUSOFF) {
    health_.state = CanState::kBusOff;
  } else if (error_class & CAN_ERR_RESTARTED) {
    health_.state = CanState::kActive;
  } else if (error_class & CAN_ERR_CRTL) {
    if (data[1] & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) {
      health_.state = CanState::kPassive;
    } else if (data[1] & CAN_ERR_CRTL_ACTIVE) {
      health_.state = CanState::kActive;
    }
  }
}

}  // namespace robostress
