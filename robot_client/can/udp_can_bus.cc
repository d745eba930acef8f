#include "robot_client/can/udp_can_bus.h"

#include <arpa/inet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/status_macros.h"
#include "robot_client/can/arrival.h"

namespace robostress {
namespace {

sockaddr_in Address(const UdpCanOptions& options) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(options.port));
  inet_pton(AF_INET, options.group.c_str(), &address.sin_addr);
  return address;
}

template <class T>
bool Set(int socket, int level, int option, const T& value) {
  return setsockopt(socket, level, option, &value, sizeof value) == 0;
}

ip_mreqn Membership(const UdpCanOptions& options, int interface_index) {
  ip_mreqn membership{};
  membership.imr_multiaddr = Address(options).sin_addr;
  membership.imr_ifindex = interface_index;
  return membership;
}

}  // namespace

absl::StatusOr<UdpCanOptions> ParseUdpCanOptions(const std::string& text) {
  UdpCanOptions options;
  const std::vector<std::string> halves = absl::StrSplit(text, absl::MaxSplits('%', 1));
  const std::vector<std::string> address = absl::StrSplit(halves[0], ':');
  in_addr group{};
  if (address.size() != 2 || inet_pton(AF_INET, address[0].c_str(), &group) != 1 ||
      !IN_MULTICAST(ntohl(group.s_addr)))
    return absl::InvalidArgumentError(
        absl::StrCat("bus 'udp:", text, "': '", halves[0],
                     "' is no GROUP:PORT with an IPv4 multicast group (224.0.0.0 to "
                     "239.255.255.255); python-can's default is 239.74.163.2:43113"));
  if (!absl::SimpleAtoi(address[1], &options.port) || options.port < 1 || options.port > 65535)
    return absl::InvalidArgumentError(absl::StrCat("bus 'udp:", text, "': port '", address[1],
                                                   "' is not a number from 1 to 65535"));
  options.group = address[0];
  if (halves.size() == 2) {
    if (halves[1].empty())
      return absl::InvalidArgumentError(
          absl::StrCat("bus 'udp:", text, "': no interface after '%'; leave '%' out for lo"));
    options.interface = halves[1];
  }
  return options;
}

UdpCanBus::UdpCanBus(UdpCanOptions options, const Clock& clock)
    : options_(std::move(options)), clock_(clock) {}

UdpCanBus::~UdpCanBus() { Close(); }

std::string UdpCanBus::description() const {
  return absl::StrCat("udp:", options_.group, ":", options_.port,
                      options_.interface == "lo" ? "" : absl::StrCat("%", options_.interface));
}

absl::Status UdpCanBus::Failure(const std::string& what, const std::string& remedy) const {
  return absl::ErrnoToStatus(
      errno, absl::StrCat("bus '", description(), "': ", what, " failed; ", remedy));
}

void UdpCanBus::Close() {
  if (receiver_ >= 0) close(receiver_);
  if (sender_ >= 0) close(sender_);
  receiver_ = sender_ = -1;
  health_.state = CanState::kClosed;
}

absl::Status UdpCanBus::OpenReceiver(int interface_index) {
  receiver_ = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (receiver_ < 0) return Failure("opening a UDP socket", "is IPv4 enabled?");
  const sockaddr_in address = Address(options_);
  // Several programs share the port. The group's address is bound, not any: other groups on this
  // port stay out.
  if (!Set(receiver_, SOL_SOCKET, SO_REUSEADDR, 1) ||
      !Set(receiver_, SOL_SOCKET, SO_REUSEPORT, 1) ||
      !Set(receiver_, SOL_SOCKET, SO_TIMESTAMPNS, 1) ||
      bind(receiver_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return Failure("binding", "another program holds the port for itself");
  Set(receiver_, SOL_SOCKET, SO_RCVBUF, 4 << 20);  // as far as the system allows
  Set(receiver_, SOL_SOCKET, SO_RXQ_OVFL, 1);      // counts; an old kernel does without
  if (!Set(receiver_, IPPROTO_IP, IP_ADD_MEMBERSHIP, Membership(options_, interface_index)))
    return Failure("joining the group", "does the interface know IPv4?");
  return absl::OkStatus();
}

absl::Status UdpCanBus::OpenSender(int interface_index) {
  sender_ = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (sender_ < 0) return Failure("opening a UDP socket", "is IPv4 enabled?");
  const sockaddr_in address = Address(options_);
  if (!Set(sender_, IPPROTO_IP, IP_MULTICAST_IF, Membership(options_, interface_index)) ||
      !Set(sender_, IPPROTO_IP, IP_MULTICAST_TTL, 1) ||
      connect(sender_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return Failure("connecting to the group", "is the interface up?");
  socklen_t length = sizeof own_;
  if (getsockname(sender_, reinterpret_cast<sockaddr*>(&own_), &length) != 0)
    return Failure("reading the own address", "is the interface up?");
  return absl::OkStatus();
}

absl::Status UdpCanBus::Open() {
  if (receiver_ >= 0) return absl::OkStatus();
  const unsigned index = if_nametoindex(options_.interface.c_str());
  if (index == 0)
    return Failure(absl::StrCat("finding interface '", options_.interface, "'"),
                   "`ip link` lists what there is");
  absl::Status opened = OpenReceiver(static_cast<int>(index));
  if (opened.ok()) opened = OpenSender(static_cast<int>(index));
  if (!opened.ok()) {
    Close();
    return opened;
  }
  health_ = {};
  health_.state = CanState::kActive;
  return absl::OkStatus();
}

absl::Status UdpCanBus::Send(const CanFrame& frame) {
  if (sender_ < 0) return absl::UnavailableError("");
  uint8_t datagram[kUdpCanFrameBytes];
  const size_t size = EncodeUdpCan(frame, 1e-9 * static_cast<double>(clock_.now_ns()), datagram);
  if (send(sender_, datagram, size, MSG_DONTWAIT) == static_cast<ssize_t>(size)) {
    ++health_.sent;
    health_.state = CanState::kActive;
    return absl::OkStatus();
  }
  ++health_.send_failures;
  if (errno == EAGAIN || errno == ENOBUFS) return absl::ResourceExhaustedError("");
  health_.state = CanState::kDown;
  return absl::UnavailableError("");
}

bool UdpCanBus::Receive(StampedFrame& frame) {
  while (receiver_ >= 0) {
    sockaddr_in from{};
    iovec piece{buffer_.data(), buffer_.size()};
    alignas(cmsghdr) char control[128];
    msghdr message{};
    message.msg_name = &from;
    message.msg_namelen = sizeof from;
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(receiver_, &message, MSG_DONTWAIT);
    if (size < 0) return false;
    const Arrival arrival = ReadArrival(message, clock_.now_ns());
    if (arrival.overflows) health_.overflows = *arrival.overflows;
    if (from.sin_port == own_.sin_port && from.sin_addr.s_addr == own_.sin_addr.s_addr) {
      ++health_.own_echoes;
      continue;
    }
    if (!DecodeUdpCan({buffer_.data(), static_cast<size_t>(size)}, frame.frame)) {
      ++health_.refused;
      continue;
    }
    frame.stamp_ns = arrival.stamp_ns;
    ++health_.received;
    return true;
  }
  return false;
}

}  // namespace robostress
