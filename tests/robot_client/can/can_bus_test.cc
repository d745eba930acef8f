#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <unistd.h>

#include <charconv>
#include <string>
#include <string_view>
#include <vector>

#include "robot_client/can/bus_address.h"
#include "robot_client/can/in_process_bus.h"
#include "robot_client/can/udp_can_bus.h"
#include "robot_client/can/udp_codec.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

CanFrame JointFrame() { return {0x2A5, 8, {0, 0, 0x30, 0x39, 0xFF, 0xFF, 0xE5, 0x7B}}; }

std::string FromHex(std::string_view hex) {
  std::string bytes(hex.size() / 2, '\0');
  for (size_t i = 0; i < bytes.size(); ++i) {
    uint8_t byte = 0;
    std::from_chars(hex.data() + 2 * i, hex.data() + 2 * i + 2, byte, 16);
    bytes[i] = static_cast<char>(byte);
  }
  return bytes;
}

absl::Span<const uint8_t> Bytes(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

// Printed by can.interfaces.udp_multicast.utils.pack_message of python-can 4.1.0 with
// msgpack 1.0.3.
const std::string& PythonDatagram() {
  static const auto& datagram =
      *new std::string(FromHex("8ba974696d657374616d70cb3ff8000000000000ae6172626974"
                               "726174696f6e5f6964cd02a5ae69735f657874656e"
                               "6465645f6964c2af69735f72656d6f74655f6672616d65c2ae69"
                               "735f6572726f725f6672616d65c2a76368616e6e65"
                               "6cc0a3646c6308a464617461c40800003039ffffe57ba569735f"
                               "6664c2ae626974726174655f737769746368c2b565"
                               "72726f725f73746174655f696e64696361746f72c2"));
  return datagram;
}
// The same library, with the channel that the vendor's SDK fills in.
const std::string& PythonDatagramWithChannel() {
  static const auto& datagram = *new std::string(
      FromHex("8ba974696d657374616d70cb3ff8000000000000ae6172626974726174696f6e5f696"
              "4cd0155ae69735f657874656e"
              "6465645f6964c2af69735f72656d6f74655f6672616d65c2ae69735f6572726f725f6"
              "672616d65c2a76368616e6e65"
              "6cac3233392e37342e3136332e32a3646c6308a464617461c4080001020304050607a"
              "569735f6664c2ae6269747261"
              "74655f737769746368c2b56572726f725f73746174655f696e64696361746f72c2"));
  return datagram;
}
std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos);
  return text.replace(at, from.size(), to);
}

TEST(UdpCodec, WritesWhatPythonCanWrites) {
  uint8_t datagram[kUdpCanFrameBytes];
  const size_t size = EncodeUdpCan(JointFrame(), 1.5, datagram);
  EXPECT_EQ(std::string(reinterpret_cast<char*>(datagram), size), PythonDatagram());
}

TEST(UdpCodec, ReadsWhatPythonCanWrites) {
  CanFrame frame;
  ASSERT_TRUE(DecodeUdpCan(Bytes(PythonDatagram()), frame));
  EXPECT_EQ(frame, JointFrame());
  ASSERT_TRUE(DecodeUdpCan(Bytes(PythonDatagramWithChannel()), frame));
  EXPECT_EQ(frame, (CanFrame{0x155, 8, {0, 1, 2, 3, 4, 5, 6, 7}}));
}

TEST(UdpCodec, ReadsBackEveryIdentifierAndLength) {
  for (int id = 0; id <= kMaxCanId; id += 7) {
    for (uint8_t length = 0; length <= 8; ++length) {
      CanFrame frame{static_cast<uint16_t>(id), length, {}}, back;
      for (int i = 0; i < length; ++i) frame.data[i] = static_cast<uint8_t>(id + 31 * i);
      uint8_t datagram[kUdpCanFrameBytes];
      const size_t size = EncodeUdpCan(frame, 0, datagram);
      ASSERT_LE(size, kUdpCanFrameBytes);
      ASSERT_TRUE(DecodeUdpCan({datagram, size}, back));
      ASSERT_EQ(back, frame);
    }
  }
}

TEST(UdpCodec, RefusesEveryTruncationAndBytesLeftOver) {
  CanFrame frame;
  const std::string& whole = PythonDatagram();
  for (size_t size = 0; size < whole.size(); ++size)
    EXPECT_FALSE(DecodeUdpCan(Bytes(whole.substr(0, size)), frame)) << size;
  EXPECT_FALSE(DecodeUdpCan(Bytes(whole + '\xC0'), frame));
}

TEST(UdpCodec, RefusesWhatIsNoClassicDataFrame) {
  const std::string& good = PythonDatagram();
  const std::string kTrue(1, '\xC3'), kFalse(1, '\xC2');
  CanFrame frame;
  for (const std::string name : {"is_extended_id", "is_remote_frame", "is_error_frame", "is_fd",
                                 "bitrate_switch", "error_state_indicator"}) {
    EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(good, name + kFalse, name + kTrue)), frame)) << name;
  }
  // python-can's default for a missing is_extended_id is an extended frame.
  std::string missing = Replaced(good, "\xAEis_extended_id" + kFalse, "");
  missing[0] = '\x8A';
  EXPECT_FALSE(DecodeUdpCan(Bytes(missing), frame));
}

TEST(UdpCodec, RefusesUnknownAndRepeatedKeysAndWrongLengths) {
  const std::string& good = PythonDatagram();
  CanFrame frame;
  EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(good, "bitrate_switch", "bitrate_swatch")), frame));
  EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(good, "is_remote_frame", "is_remote_fram\xC2")), frame));
  std::string twice = good + "\xA5is_fd\xC2";
  twice[0] = '\x8C';
  EXPECT_FALSE(DecodeUdpCan(Bytes(twice), frame));
  EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(good, "dlc\x08", "dlc\x07")), frame));
  const std::string nine_bytes =
      Replaced(good, std::string("data\xC4\x08", 6), std::string("data\xC4\x09x", 7));
  EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(nine_bytes, "dlc\x08", "dlc\x09")), frame));
  EXPECT_FALSE(DecodeUdpCan(Bytes(Replaced(good, "\xCD\x02\xA5", "\xCD\x08\xA5")), frame));
  EXPECT_FALSE(DecodeUdpCan(Bytes(std::string(5000, '\x8B')), frame));
}

TEST(UdpCodec, TakesKeysInAnyOrderAndLeavesOutDefaults) {
  const std::string datagram = std::string(
                                   "\x84\xA4"
                                   "data\xC4\x02\x01\x02\xAE"
                                   "arbitration_id\xD1\x01\x51",
                                   28) +
                               std::string(
                                   "\xAEis_extended_id\xC2\xA3"
                                   "dlc\xD0\x02",
                                   22);
  CanFrame frame;
  ASSERT_TRUE(DecodeUdpCan(Bytes(datagram), frame));
  EXPECT_EQ(frame, (CanFrame{0x151, 2, {1, 2}}));
}

class UdpBus : public ::testing::Test {
 protected:
  // A port of its own, so that tests may run side by side.
  UdpBus() { options_.port = 20000 + getpid() % 40000; }
  bool WaitFor(CanBus& bus, StampedFrame& frame) {
    for (int i = 0; i < 200; ++i) {
      if (bus.Receive(frame)) return true;
      clock_.SleepUntil(clock_.now_ns() + 1'000'000);
    }
    return false;
  }
  void SendRaw(const std::string& datagram) {
    const int raw = socket(AF_INET, SOCK_DGRAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(options_.port));
    inet_pton(AF_INET, options_.group.c_str(), &address.sin_addr);
    in_addr loopback{};
    loopback.s_addr = htonl(INADDR_LOOPBACK);
    setsockopt(raw, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
    EXPECT_GE(sendto(raw, datagram.data(), datagram.size(), 0,
                     reinterpret_cast<sockaddr*>(&address), sizeof address),
              0);
    close(raw);
  }

  MonotonicClock clock_;
  UdpCanOptions options_;
};

TEST_F(UdpBus, CarriesFramesBetweenTwoNodesAndDropsOwnEchoes) {
  UdpCanBus one(options_, clock_), two(options_, clock_);
  ASSERT_TRUE(one.Open().ok()) << one.Open();
  ASSERT_TRUE(two.Open().ok());
  const int64_t before_ns = clock_.now_ns();
  ASSERT_TRUE(one.Send(JointFrame()).ok());
  StampedFrame received;
  ASSERT_TRUE(WaitFor(two, received));
  EXPECT_EQ(received.frame, JointFrame());
  EXPECT_GE(received.stamp_ns, before_ns - 2'000'000);
  EXPECT_LE(received.stamp_ns, clock_.now_ns());
  EXPECT_FALSE(one.Receive(received));
  EXPECT_EQ(one.health().own_echoes, 1u);
  EXPECT_EQ(two.health().received, 1u);
}

TEST_F(UdpBus, CountsAndDropsJunk) {
  UdpCanBus bus(options_, clock_);
  ASSERT_TRUE(bus.Open().ok());
  SendRaw("junk");
  SendRaw(std::string(6000, '\x8B'));
  SendRaw(PythonDatagram());
  StampedFrame received;
  ASSERT_TRUE(WaitFor(bus, received));
  EXPECT_EQ(received.frame, JointFrame());
  EXPECT_EQ(bus.health().refused, 2u);
}

TEST_F(UdpBus, DoesNotHearAnotherGroupOnItsPort) {
  UdpCanOptions other = options_;
  other.group = "239.74.163.9";
  UdpCanBus one(options_, clock_), two(other, clock_);
  ASSERT_TRUE(one.Open().ok());
  ASSERT_TRUE(two.Open().ok());
  ASSERT_TRUE(two.Send(JointFrame()).ok());
  clock_.SleepUntil(clock_.now_ns() + 50'000'000);
  StampedFrame received;
  EXPECT_FALSE(one.Receive(received));
}

TEST_F(UdpBus, NamesAnInterfaceThatIsNotThere) {
  options_.interface = "nosuchif0";
  UdpCanBus bus(options_, clock_);
  const absl::Status status = bus.Open();
  EXPECT_THAT(std::string(status.message()), HasSubstr("nosuchif0"));
  EXPECT_EQ(bus.Send(JointFrame()).code(), absl::StatusCode::kUnavailable);
}

TEST(BusAddress, SaysWhatIsWrongWithAnAddress) {
  MonotonicClock clock;
  for (const auto& [address, said] : std::vector<std::pair<std::string, std::string>>{
           {"can0", "expected can:INTERFACE"},
           {"can:", "no interface name"},
           {"can:averyverylonginterface", "no interface name"},
           {"udp:10.0.0.1:43113", "multicast group"},
           {"udp:239.74.163.2", "GROUP:PORT"},
           {"udp:239.74.163.2:70000", "1 to 65535"},
           {"udp:239.74.163.2:43113%", "no interface after"}}) {
    const auto bus = MakeCanBus(address, clock);
    ASSERT_FALSE(bus.ok()) << address;
    EXPECT_THAT(std::string(bus.status().message()), HasSubstr(said));
  }
  EXPECT_EQ((*MakeCanBus("udp:239.74.163.2:43113%eth1", clock))->description(),
            "udp:239.74.163.2:43113%eth1");
  EXPECT_EQ((*MakeCanBus("can:can0", clock))->description(), "can:can0");
}

TEST(InProcessBus, DeliversToEveryOtherNodeInOrderWithTheClocksTime) {
  ManualClock clock(1000);
  InProcessBus bus(clock);
  const auto one = bus.Attach(), two = bus.Attach(), three = bus.Attach();
  EXPECT_EQ(one->Send(JointFrame()).code(), absl::StatusCode::kUnavailable);  // not open
  for (CanBus* node : {one.get(), two.get(), three.get()}) ASSERT_TRUE(node->Open().ok());
  ASSERT_TRUE(one->Send({1, 8, {}}).ok());
  clock.Advance(5);
  ASSERT_TRUE(one->Send({2, 8, {}}).ok());
  StampedFrame received;
  EXPECT_FALSE(one->Receive(received));
  for (CanBus* node : {two.get(), three.get()}) {
    ASSERT_TRUE(node->Receive(received));
    EXPECT_EQ(received.frame.id, 1);
    EXPECT_EQ(received.stamp_ns, 1000);
    ASSERT_TRUE(node->Receive(received));
    EXPECT_EQ(received.frame.id, 2);
    EXPECT_EQ(received.stamp_ns, 1005);
    EXPECT_FALSE(node->Receive(received));
  }
}

TEST(InProcessBus, LosesTheOldestFramesOfANodeThatDoesNotRead) {
  ManualClock clock;
  InProcessBus bus(clock);
  const auto one = bus.Attach(), two = bus.Attach();
  ASSERT_TRUE(one->Open().ok() && two->Open().ok());
  for (size_t i = 0; i < InProcessBus::kQueue + 3; ++i)
    ASSERT_TRUE(one->Send({static_cast<uint16_t>(i % 1000), 8, {}}).ok());
  StampedFrame received;
  ASSERT_TRUE(two->Receive(received));
  EXPECT_EQ(received.frame.id, 3);
  EXPECT_EQ(two->health().overflows, 3u);
}

}  // namespace
}  // namespace robostress
