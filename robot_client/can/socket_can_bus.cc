#include "robot_client/can/socket_can_bus.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/sock_diag.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "robot_client/can/arrival.h"

namespace robostress {
namespace {

constexpr size_t kMaxFilters = 32;
// Every error class; Receive sorts them.
constexpr can_err_mask_t kErrors = CAN_ERR_MASK;

constexpr char kBringUp[] =
    "bring it up: `sudo ./deploy/can0.sh $0`, or by hand `sudo ip link set $0 up type can bitrate "
    "1000000`";

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

// False where the kernel does not tell.
bool SocketCanBus::IsDown() {
  ifreq request{};
  options_.interface.copy(request.ifr_name, IFNAMSIZ - 1);
  return calls_.InterfaceCall(socket_, SIOCGIFFLAGS, &request) == 0 &&
         (request.ifr_flags & IFF_UP) == 0;
}

bool SocketCanBus::SetFilters() {
  if (options_.filters.empty()) return true;
  std::array<can_filter, kMaxFilters> filters{};
  const size_t count = std::min(options_.filters.size(), kMaxFilters);
  for (size_t i = 0; i < count; ++i) {
    // Extended and remote frames are outside the mask's match.
    filters[i] = {options_.filters[i].id, options_.filters[i].mask | CAN_EFF_FLAG | CAN_RTR_FLAG};
  }
  return calls_.SetOption(socket_, SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                          static_cast<socklen_t>(count * sizeof(can_filter))) == 0;
}

// The filters hold back own frames too.
bool SocketCanBus::ComesBack(const CanFrame& frame) const {
  return options_.filters.empty() ||
         std::any_of(options_.filters.begin(), options_.filters.end(),
                     [&](const CanFilter& f) { return (frame.id & f.mask) == (f.id & f.mask); });
}

std::optional<SocketCanBus::Failure> SocketCanBus::TryOpen() {
  socket_ = calls_.Socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
  if (socket_ < 0)
    return Failure{"the kernel opens no CAN socket", "load its module: `sudo modprobe can_raw`"};
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = static_cast<int>(calls_.NameToIndex(options_.interface.c_str()));
  if (address.can_ifindex == 0)
    return Failure{"there is no interface $0",
                   "plug the adapter in (`ip -details link show type can` lists what is there; "
                   "drivers: `sudo modprobe gs_usb`, or slcand for a serial adapter), then "
                   "`sudo ./deploy/can0.sh $0`"};
  if (!Set(SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 1)) return Failure{"asking for own frames", ""};
  if (!Set(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, kErrors)) return Failure{"asking for error frames", ""};
  if (!Set(SOL_SOCKET, SO_TIMESTAMPNS, 1)) return Failure{"asking for arrival times", ""};
  Set(SOL_SOCKET, SO_RXQ_OVFL, 1);      // counts; an old kernel does without
  Set(SOL_SOCKET, SO_RCVBUF, 4 << 20);  // as far as the system allows
  if (!SetFilters()) return Failure{"setting the filters", ""};
  if (calls_.Bind(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    if (errno == ENODEV)
      return Failure{"$0 is no CAN interface", "`ip -details link show type can` lists those"};
    return Failure{"binding to interface $0", kBringUp};
  }
  // Binding to an interface that is down succeeds, and the first Receive says so; whoever starts a
  // program should be told at once.
  if (IsDown()) {
    errno = ENETDOWN;
    return Failure{"interface $0 is down", kBringUp};
  }
  health_.state = CanState::kActive;
  transmit_.Clear();
  return std::nullopt;
}

absl::Status SocketCanBus::Open() {
  if (socket_ >= 0) return absl::OkStatus();
  if (options_.filters.size() > kMaxFilters)
    return absl::InvalidArgumentError(
        absl::StrCat("bus '", description(), "': ", options_.filters.size(), " filters; at most ",
                     kMaxFilters, ": join them by their masks"));
  health_ = {};
  if (const std::optional<Failure> failure = TryOpen(); failure) {
    const int error = errno;
    if (socket_ >= 0) calls_.Close(socket_);
    socket_ = -1;
    const auto filled = [&](const char* text) {
      return absl::StrReplaceAll(text, {{"$0", options_.interface}});
    };
    return absl::Status(
        absl::ErrnoToStatusCode(error),
        absl::StrCat("bus '", description(), "': ", filled(failure->what), " (",
                     std::strerror(error), ")", *failure->remedy == '\0' ? "" : "; ",
                     filled(failure->remedy)));
  }
  if (calls_.Carrier(options_.interface.c_str()) == 0) GoBusOff();
  if (restart_ == nullptr)
    restart_ = std::make_unique<InterfaceRestart>(options_.interface, calls_);
  return absl::OkStatus();
}

CanHealth SocketCanBus::health() const {
  CanHealth health = health_;
  health.transmit_wait_ns = transmit_.wait_ns(clock_.now_ns());
  return health;
}

void SocketCanBus::GoDown() {
  if (socket_ >= 0) calls_.Close(socket_);
  socket_ = -1;
  overflows_before_ = health_.overflows;
  health_.state = CanState::kDown;
  transmit_.Clear();
  next_attempt_ns_ = clock_.now_ns() + options_.reopen_interval_ns;
}

void SocketCanBus::ReopenWhenDue() {
  if (health_.state != CanState::kDown || clock_.now_ns() < next_attempt_ns_) return;
  if (TryOpen()) {
    GoDown();
    return;
  }
  ++health_.reopened;
}

// Bytes of our frames that the kernel has not handed to the device yet; 0 where it does not tell.
int64_t SocketCanBus::QueuedBytes() {
  std::array<uint32_t, SK_MEMINFO_VARS> memory{};
  socklen_t size = sizeof memory;
  if (calls_.GetOption(socket_, SOL_SOCKET, SO_MEMINFO, memory.data(), &size) != 0) return 0;
  return memory[SK_MEMINFO_WMEM_ALLOC];
}

// Whether a frame must not be added to those that wait. A frame now and then is tried all the same,
// as long as none is held by the kernel: the echoes of those before may have been lost.
bool SocketCanBus::Stalled() {
  if (!transmit_.waits()) return false;
  const int64_t queued = QueuedBytes(), now_ns = clock_.now_ns();
  transmit_.Look(queued > 0);
  if (transmit_.wait_ns(now_ns) <= options_.stall_ns) {
    next_probe_ns_ = now_ns + options_.probe_interval_ns;
    return false;
  }
  if (queued > 0 || now_ns < next_probe_ns_) return true;
  next_probe_ns_ = now_ns + options_.probe_interval_ns;
  transmit_.ForgetFrames();
  return false;
}

absl::Status SocketCanBus::Send(const CanFrame& frame) {
  ReopenWhenDue();
  if (socket_ < 0 || health_.state == CanState::kBusOff) {
    ++health_.send_failures;
    return absl::UnavailableError("");
  }
  if (Stalled()) {
    ++health_.send_failures;
    ++health_.stalled_sends;
    return absl::ResourceExhaustedError("");
  }
  can_frame wire{};
  wire.can_id = frame.id;
  wire.can_dlc = frame.size;
  std::memcpy(wire.data, frame.data.data(), frame.data.size());
  if (calls_.Send(socket_, &wire, sizeof wire, MSG_DONTWAIT) == sizeof wire) {
    ++health_.sent;
    transmit_.Sent(frame, ComesBack(frame), clock_.now_ns());
    return absl::OkStatus();
  }
  ++health_.send_failures;
  if (errno == ENOBUFS || errno == EAGAIN) return absl::ResourceExhaustedError("");
  if (errno == ENETDOWN || errno == ENXIO || errno == ENODEV) GoDown();
  return absl::UnavailableError("");
}

bool SocketCanBus::Receive(StampedFrame& frame) {
  ReopenWhenDue();
  TakeRestartResult();
  EndBusOffWhenDue();
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
      if (errno == ENETDOWN || errno == ENXIO || errno == ENODEV) {
        GoDown();
      } else if (transmit_.waits()) {
        transmit_.Look(QueuedBytes() > 0);
      }
      return false;
    }
    const Arrival arrival = ReadArrival(message, clock_.now_ns());
    if (arrival.overflows) health_.overflows = overflows_before_ + *arrival.overflows;
    if (size != sizeof wire ||
        wire.can_dlc > 8) {  // NOLINT(bugprone-branch-clone): before its bits
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
      if (message.msg_flags & MSG_CONFIRM) {  // our own, which the device has sent
        ++health_.own_echoes;
        transmit_.Echoed(frame.frame);
        continue;
      }
      frame.stamp_ns = arrival.stamp_ns;
      // A controller that receives is back on the bus.
      if (health_.state == CanState::kBusOff) LeaveBusOff();
      ++health_.received;
      return true;
    }
  }
  return false;
}

void SocketCanBus::GoBusOff() {
  if (health_.state == CanState::kBusOff) return;
  ++health_.bus_offs;
  health_.state = CanState::kBusOff;
  health_.restart = CanRestart::kNone;
  restart_due_ns_ = clock_.now_ns() + options_.bus_off_wait_ns;
}

void SocketCanBus::LeaveBusOff() {
  health_.state = CanState::kActive;
  transmit_.Clear();  // the controller forgot what it had not sent
}

void SocketCanBus::TakeRestartResult() {
  if (!restart_asked_ || restart_->under_way()) return;
  restart_asked_ = false;
  health_.restart = restart_->result();
}

void SocketCanBus::EndBusOffWhenDue() {
  if (health_.state != CanState::kBusOff || restart_asked_ || clock_.now_ns() < restart_due_ns_)
    return;
  restart_due_ns_ = clock_.now_ns() + options_.bus_off_wait_ns;
  restart_asked_ = true;
  restart_->Ask();
}

// Meaning of the bits: linux/can/error.h.
void SocketCanBus::TakeErrorFrame(uint32_t error_class, const uint8_t (&data)[8]) {
  ++health_.error_frames;
  if (error_class & CAN_ERR_BUSOFF) {
    GoBusOff();
  } else if (error_class & CAN_ERR_RESTARTED) {
    LeaveBusOff();
  } else if (error_class & CAN_ERR_CRTL) {
    if (data[1] & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) {
      health_.state = CanState::kPassive;
    } else if (data[1] & CAN_ERR_CRTL_ACTIVE) {
      health_.state = CanState::kActive;
    }
  }
}

}  // namespace robostress
