#include "robot_client/can/socket_can_bus.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/sock_diag.h>
#include <sys/ioctl.h>

#include <cerrno>
#include <cstring>
#include <deque>
#include <string>
#include <vector>

namespace robostress {
namespace {

using ::testing::HasSubstr;

CanFrame JointFrame() { return {0x2A5, 8, {0, 0, 0x30, 0x39, 0xFF, 0xFF, 0xE5, 0x7B}}; }

// Answers the system calls of one CAN socket.
class FakeSockets : public SocketCalls {
 public:
  int Socket(int domain, int, int protocol) override {
    EXPECT_EQ(domain, PF_CAN);
    EXPECT_EQ(protocol, CAN_RAW);
    if (no_socket) return Fail(EAFNOSUPPORT);
    ++open_sockets;
    return 7;
  }
  unsigned NameToIndex(const char* interface) override {
    name = interface;
    if (gone) errno = ENODEV;
    return gone ? 0 : 3;
  }
  int SetOption(int, int level, int option, const void* value, socklen_t size) override {
    if (level == SOL_CAN_RAW && option == CAN_RAW_FILTER) {
      filters.resize(size / sizeof(can_filter));
      std::memcpy(filters.data(), value, size);
    }
    if (level == SOL_CAN_RAW && option == CAN_RAW_RECV_OWN_MSGS)
      std::memcpy(&own_messages, value, sizeof own_messages);
    if (level == SOL_CAN_RAW && option == CAN_RAW_ERR_FILTER)
      std::memcpy(&error_mask, value, sizeof error_mask);
    return 0;
  }
  int GetOption(int, int level, int option, void* value, socklen_t*) override {
    EXPECT_EQ(level, SOL_SOCKET);
    EXPECT_EQ(option, SO_MEMINFO);
    static_cast<uint32_t*>(value)[SK_MEMINFO_WMEM_ALLOC] = queued_bytes;
    return 0;
  }
  int InterfaceCall(int, unsigned long request, ifreq* interface) override {
    EXPECT_STREQ(interface->ifr_name, "can0");
    if (request == SIOCGIFFLAGS) {
      interface->ifr_flags = flags;
      return 0;
    }
    EXPECT_EQ(request, static_cast<unsigned long>(SIOCSIFFLAGS));
    if (set_flags_error != 0) return Fail(set_flags_error);
    flags_set.push_back(interface->ifr_flags);
    return 0;
  }
  int Carrier(const char*) override { return carrier; }
  int Bind(int, const sockaddr* address, socklen_t) override {
    if (bind_error != 0) return Fail(bind_error);
    bound_index = reinterpret_cast<const sockaddr_can*>(address)->can_ifindex;
    return 0;
  }
  ssize_t Send(int, const void* data, size_t size, int) override {
    if (send_error != 0) return Fail(send_error);
    can_frame frame;
    std::memcpy(&frame, data, sizeof frame);
    sent.push_back(frame);
    return static_cast<ssize_t>(size);
  }
  ssize_t Receive(int, msghdr* message, int) override {
    message->msg_controllen = 0;
    if (receive_error != 0) return Fail(receive_error);
    if (arriving.empty()) return Fail(EAGAIN);
    std::memcpy(message->msg_iov->iov_base, &arriving.front(), sizeof(can_frame));
    // The kernel marks what this very socket has sent.
    message->msg_flags = own_arriving.front() ? MSG_CONFIRM | MSG_DONTROUTE : 0;
    arriving.pop_front();
    own_arriving.pop_front();
    return short_read ? 3 : static_cast<ssize_t>(sizeof(can_frame));
  }
  int Close(int) override {
    --open_sockets;
    return 0;
  }
  static int Fail(int error) {
    errno = error;
    return -1;
  }
  void Arrive(uint32_t id, std::vector<uint8_t> data = std::vector<uint8_t>(8)) {
    can_frame frame{};
    frame.can_id = id;
    frame.can_dlc = static_cast<uint8_t>(data.size());
    std::memcpy(frame.data, data.data(), data.size());
    arriving.push_back(frame);
    own_arriving.push_back(false);
  }
  // The device has sent the frame with this number; its echo comes back.
  void Echo(size_t number) {
    arriving.push_back(sent.at(number));
    own_arriving.push_back(true);
  }

  bool no_socket = false, gone = false, short_read = false;
  int send_error = 0, receive_error = 0, open_sockets = 0, bound_index = 0, own_messages = -1;
  can_err_mask_t error_mask = 0;
  std::string name;
  std::vector<can_filter> filters;
  std::vector<can_frame> sent;
  std::deque<can_frame> arriving;
  std::deque<bool> own_arriving;
  uint32_t queued_bytes = 0;  // of this socket's frames, held by the kernel
  short flags = IFF_UP | IFF_RUNNING;
  std::vector<short> flags_set;  // by InterfaceRestart's thread
  int set_flags_error = 0, bind_error = 0, carrier = 1;
};

class SocketCan : public ::testing::Test {
 protected:
  ManualClock clock_;
  FakeSockets sockets_;
  SocketCanOptions options_;
};

TEST_F(SocketCan, OpensWithFiltersErrorFramesAndOwnFrames) {
  options_.filters = {{0x2A0, 0x7F0}, {0x251, 0x7FF}};
  {
    SocketCanBus bus(options_, clock_, sockets_);
    ASSERT_TRUE(bus.Open().ok());
    EXPECT_EQ(sockets_.name, "can0");
    EXPECT_EQ(sockets_.bound_index, 3);
    EXPECT_EQ(sockets_.own_messages, 1);
    EXPECT_TRUE(sockets_.error_mask & CAN_ERR_BUSOFF);
    ASSERT_EQ(sockets_.filters.size(), 2u);
    EXPECT_EQ(sockets_.filters[0].can_id, 0x2A0u);
    // An extended frame with the same low bits does not pass.
    EXPECT_EQ(sockets_.filters[0].can_mask, 0x7F0u | CAN_EFF_FLAG | CAN_RTR_FLAG);
    EXPECT_EQ(bus.health().state, CanState::kActive);
  }
  EXPECT_EQ(sockets_.open_sockets, 0);
}

TEST_F(SocketCan, SaysWhatKeepsItFromOpeningAndWhatToType) {
  SocketCanBus bus(options_, clock_, sockets_);
  const auto said = [&] {
    const absl::Status status = bus.Open();
    EXPECT_FALSE(status.ok());
    EXPECT_EQ(sockets_.open_sockets, 0);
    return std::string(status.message());
  };
  sockets_.gone = true;
  EXPECT_EQ(said(),
            "bus 'can:can0': there is no interface can0 (No such device); plug the adapter in "
            "(`ip -details link show type can` lists what is there; drivers: `sudo modprobe "
            "gs_usb`, or slcand for a serial adapter), then `sudo ./deploy/can0.sh can0`");
  sockets_.gone = false;
  sockets_.flags = 0;
  EXPECT_EQ(said(),
            "bus 'can:can0': interface can0 is down (Network is down); bring it up: `sudo "
            "./deploy/can0.sh can0`, or by hand `sudo ip link set can0 up type can bitrate "
            "1000000`");
  sockets_.flags = IFF_UP | IFF_RUNNING;
  sockets_.bind_error = ENODEV;
  EXPECT_THAT(said(), HasSubstr("can0 is no CAN interface"));
  sockets_.bind_error = 0;
  sockets_.no_socket = true;
  EXPECT_THAT(said(), HasSubstr("modprobe can_raw"));
  sockets_.no_socket = false;
  EXPECT_TRUE(bus.Open().ok());
}

TEST_F(SocketCan, SendsAndReceivesDataFramesOnly) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  ASSERT_TRUE(bus.Send(JointFrame()).ok());
  ASSERT_EQ(sockets_.sent.size(), 1u);
  EXPECT_EQ(sockets_.sent[0].can_id, 0x2A5u);
  EXPECT_EQ(sockets_.sent[0].can_dlc, 8);
  EXPECT_EQ(sockets_.sent[0].data[3], 0x39);
  sockets_.Arrive(0x123 | CAN_EFF_FLAG);
  sockets_.Arrive(0x123 | CAN_RTR_FLAG);
  sockets_.Arrive(0x2A1, {1, 2, 3});
  StampedFrame received;
  ASSERT_TRUE(bus.Receive(received));
  EXPECT_EQ(received.frame, (CanFrame{0x2A1, 3, {1, 2, 3}}));
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().refused, 2u);
  sockets_.short_read = true;
  sockets_.Arrive(0x2A1);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().refused, 3u);
}

TEST_F(SocketCan, FollowsTheControllersErrorState) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_CRTL, {0, CAN_ERR_CRTL_TX_PASSIVE, 0, 0, 0, 0, 0, 0});
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().state, CanState::kPassive);
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_BUSOFF);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().state, CanState::kBusOff);
  EXPECT_EQ(bus.Send(JointFrame()).code(), absl::StatusCode::kUnavailable);
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_RESTARTED);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().state, CanState::kActive);
  EXPECT_TRUE(bus.Send(JointFrame()).ok());
  EXPECT_EQ(bus.health().error_frames, 3u);
}

TEST_F(SocketCan, ReportsAFullTransmitQueueAndStaysOpen) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  sockets_.send_error = ENOBUFS;
  EXPECT_EQ(bus.Send(JointFrame()).code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(bus.health().state, CanState::kActive);
  sockets_.send_error = 0;
  EXPECT_TRUE(bus.Send(JointFrame()).ok());
  EXPECT_EQ(bus.health().send_failures, 1u);
}

// A tick's commands at 30 Hz; how many of the five the bus took.
int SendTick(CanBus& bus) {
  int taken = 0;
  for (uint16_t id : {0x151, 0x155, 0x156, 0x157, 0x159}) taken += bus.Send({id, 8, {}}).ok();
  return taken;
}
constexpr int64_t kTick_ns = 33'333'333;

TEST_F(SocketCan, RefusesCommandsFromTheSecondTickOfAStalledAdapterOn) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  // An adapter that sends: the echoes are there before the next tick.
  for (size_t tick = 0; tick < 10; ++tick) {
    EXPECT_EQ(SendTick(bus), 5);
    for (size_t i = 0; i < 5; ++i) sockets_.Echo(5 * tick + i);
    clock_.Advance(kTick_ns);
    EXPECT_FALSE(bus.Receive(received));  // echoes are not handed out
  }
  EXPECT_EQ(bus.health().own_echoes, 50u);
  EXPECT_EQ(bus.health().transmit_wait_ns, 0);
  // It stalls. The queue takes one tick's frames; later only a frame for trial now and then.
  EXPECT_EQ(SendTick(bus), 5);
  int taken = 0;
  for (int tick = 1; tick <= 15; ++tick) {
    clock_.Advance(kTick_ns);
    EXPECT_FALSE(bus.Receive(received));
    const int now = SendTick(bus);
    EXPECT_LE(now, 1);
    taken += now;
  }
  EXPECT_LE(taken, 5);
  EXPECT_GT(bus.health().transmit_wait_ns, 450'000'000);
  EXPECT_THAT(BusAdvice(bus.description(), bus.health()),
              HasSubstr("can0 has sent nothing for 0.5 s"));
  // It goes on: what waited is sent, the next tick is taken.
  for (size_t i = 50; i < sockets_.sent.size(); ++i) sockets_.Echo(i);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(SendTick(bus), 5);
}

TEST_F(SocketCan, SeesAStallOfADeviceWithoutEchoInTheKernelsQueue) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  for (size_t tick = 0; tick < 4; ++tick) {
    const size_t before = sockets_.sent.size();
    EXPECT_EQ(SendTick(bus), tick < 2 ? 5 : 0) << tick;
    // The kernel echoes for the device, at once.
    for (size_t i = before; i < sockets_.sent.size(); ++i) sockets_.Echo(i);
    sockets_.queued_bytes = tick < 1 ? 0 : 2304;
    clock_.Advance(kTick_ns);
    EXPECT_FALSE(bus.Receive(received));
  }
  sockets_.queued_bytes = 0;
  EXPECT_EQ(SendTick(bus), 5);
}

TEST_F(SocketCan, ForgetsEchoesThatWereLost) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  EXPECT_EQ(SendTick(bus), 5);
  sockets_.Echo(4);  // the echo of the last frame tells that those before it were sent
  clock_.Advance(kTick_ns);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(SendTick(bus), 5);
  // All five are lost: the frame for trial is heard of, and the bus is trusted again.
  clock_.Advance(4 * kTick_ns);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(SendTick(bus), 1);
  sockets_.Echo(sockets_.sent.size() - 1);
  sockets_.Echo(sockets_.sent.size() - 2);  // late, of a frame that counts as sent
  clock_.Advance(kTick_ns);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(SendTick(bus), 5);
}

TEST_F(SocketCan, ExpectsNoEchoThatItsFiltersHoldBack) {
  options_.filters = {{0x2A0, 0x7F0}};
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  for (int tick = 0; tick < 5; ++tick) {
    EXPECT_EQ(SendTick(bus), 5);
    clock_.Advance(kTick_ns);
  }
}

TEST_F(SocketCan, TakesCommandsAsSoonAsItIsReopenedThoughTheCarrierComesLate) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  sockets_.receive_error = ENETDOWN;
  EXPECT_FALSE(bus.Receive(received));
  sockets_.receive_error = 0;
  sockets_.carrier = 0;
  clock_.Advance(options_.reopen_interval_ns);
  EXPECT_TRUE(bus.Send(JointFrame()).ok());
}

class BusOff : public SocketCan {
 protected:
  void Run(SocketCanBus& bus, double seconds) {
    StampedFrame received;
    for (int i = 0; i < static_cast<int>(1000 * seconds); ++i) {
      clock_.Advance(1'000'000);
      EXPECT_FALSE(bus.Receive(received));
    }
  }
  // The restart has a thread of its own.
  void WaitForResult(SocketCanBus& bus) {
    StampedFrame received;
    MonotonicClock real;
    for (int i = 0; i < 2000 && bus.health().restart == CanRestart::kNone; ++i) {
      real.SleepUntil(real.now_ns() + 1'000'000);
      EXPECT_FALSE(bus.Receive(received));
    }
  }
};

TEST_F(BusOff, TakesTheInterfaceDownAndUpWhenTheDeviceDoesNotRestart) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_BUSOFF);
  Run(bus, 0.499);
  EXPECT_EQ(bus.health().restart, CanRestart::kNone);
  EXPECT_THAT(BusAdvice(bus.description(), bus.health()), HasSubstr("can0 is bus-off"));
  Run(bus, 0.003);
  WaitForResult(bus);
  EXPECT_EQ(bus.health().restart, CanRestart::kDone);
  EXPECT_THAT(sockets_.flags_set,
              testing::ElementsAre(short{IFF_RUNNING}, static_cast<short>(IFF_UP | IFF_RUNNING)));
  EXPECT_EQ(bus.health().bus_offs, 1u);
  EXPECT_EQ(sockets_.open_sockets, 1);
}

TEST_F(BusOff, NamesTheCommandWhereItHasNoRights) {
  sockets_.set_flags_error = EPERM;
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_BUSOFF);
  Run(bus, 0.502);
  WaitForResult(bus);
  EXPECT_EQ(bus.health().restart, CanRestart::kNoRights);
  EXPECT_THAT(BusAdvice(bus.description(), bus.health()),
              HasSubstr("type `sudo ip link set can0 down && sudo ip link set can0 up`"));
  EXPECT_EQ(bus.Send(JointFrame()).code(), absl::StatusCode::kUnavailable);
}

TEST_F(BusOff, LeavesADeviceAloneThatRestartsByItself) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_BUSOFF);
  Run(bus, 0.1);
  sockets_.Arrive(CAN_ERR_FLAG | CAN_ERR_RESTARTED);
  Run(bus, 2);
  EXPECT_EQ(bus.health().restart, CanRestart::kNone);
  EXPECT_EQ(bus.health().state, CanState::kActive);
  EXPECT_EQ(BusAdvice(bus.description(), bus.health()), "");
}

TEST_F(BusOff, IsSeenWhenTheInterfaceIsOpened) {
  sockets_.carrier = 0;
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  EXPECT_EQ(bus.health().state, CanState::kBusOff);
  sockets_.Arrive(0x2A1);
  StampedFrame received;
  EXPECT_TRUE(bus.Receive(received));
  EXPECT_EQ(bus.health().state, CanState::kActive);
}

TEST_F(SocketCan, ReopensAnInterfaceThatWentDownNotMoreOftenThanAllowed) {
  SocketCanBus bus(options_, clock_, sockets_);
  ASSERT_TRUE(bus.Open().ok());
  StampedFrame received;
  sockets_.receive_error = ENETDOWN;
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(bus.health().state, CanState::kDown);
  EXPECT_EQ(sockets_.open_sockets, 0);
  sockets_.receive_error = 0;
  sockets_.gone = true;
  clock_.Advance(options_.reopen_interval_ns - 1);
  EXPECT_FALSE(bus.Receive(received));
  EXPECT_EQ(sockets_.open_sockets, 0);  // not tried yet
  clock_.Advance(1);
  EXPECT_EQ(bus.Send(JointFrame()).code(), absl::StatusCode::kUnavailable);  // tried, still gone
  EXPECT_EQ(sockets_.open_sockets, 0);
  sockets_.gone = false;
  clock_.Advance(options_.reopen_interval_ns);
  EXPECT_TRUE(bus.Send(JointFrame()).ok());
  EXPECT_EQ(bus.health().reopened, 1u);
  EXPECT_EQ(sockets_.open_sockets, 1);
}

}  // namespace
}  // namespace robostress
