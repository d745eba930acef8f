#include "robot_client/bridge/protocol.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "nlohmann/json.hpp"

namespace robostress::bridge {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

StateFrame SomeState(int axes) {
  StateFrame state;
  state.stamp_ns = 123456789;
  state.sent_ns = 123456999;
  state.command = 77;
  state.command_ns = 123450000;
  state.flags = kPowered | kTaking;
  state.faults = kFaultCollision;
  state.axes = axes;
  for (int i = 0; i < axes; ++i) {
    state.position[i] = 1.5 * i;
    state.velocity[i] = -0.25 * i;
    state.effort[i] = 3 - i;
  }
  return state;
}

CommandFrame SomeCommand(int axes) {
  CommandFrame command;
  command.stamp_ns = -5;
  command.state = 1ull << 60;
  command.mode = CommandMode::kTarget;
  command.gripper_effort = 0.5;
  command.axes = axes;
  for (int i = 0; i < axes; ++i) command.position[i] = 0.125 * i;
  return command;
}

nlohmann::json SomeWelcome() {
  return {{"protocol", 1},
          {"driver", "d"},
          {"robot", "r"},
          {"clock", "monotonic"},
          {"stop", false},
          {"hold", true},
          {"torque_off", true},
          {"measures_effort", false},
          {"measures_velocity", false},
          {"simulated", true},
          {"on_silence", "hold"},
          {"watchdog_s", 0.25},
          {"state_hz", 100},
          {"axes", {"a", "b"}}};
}

// The bytes of the document, written by hand: whoever writes a driver reads the same.
TEST(BridgeProtocol, WritesTheDocumentedBytes) {
  std::array<uint8_t, kMostFrame> bytes{};
  CommandFrame command = SomeCommand(1);
  command.stamp_ns = 0x0102030405060708;
  command.state = 9;
  command.position[0] = 1;
  ASSERT_EQ(EncodeCommand(command, 0x11, bytes), 16u + 32 + 8);
  const std::vector<uint8_t> want = {
      'R', 'S', 'B', 'R', 1, 5, 40,   0,   0x11, 0, 0, 0, 0, 0, 0,    0,     // header
      8,   7,   6,   5,   4, 3, 2,    1,   9,    0, 0, 0, 0, 0, 0,    0,     // stamp, state
      1,   0,   0,   0,   0, 0, 0,    0,   0,    0, 0, 0, 0, 0, 0xe0, 0x3f,  // mode, effort
      0,   0,   0,   0,   0, 0, 0xf0, 0x3f};
  EXPECT_EQ(std::vector<uint8_t>(bytes.begin(), bytes.begin() + 56), want);
}

TEST(BridgeProtocol, FramesComeBackEqual) {
  std::array<uint8_t, kMostFrame> bytes{};
  for (int axes = 1; axes <= kMostAxes; ++axes) {
    const StateFrame state = SomeState(axes);
    const size_t size = EncodeState(state, 9, bytes);
    FrameHeader header;
    ASSERT_EQ(DecodeHeader(bytes.data(), size, header), Decoded::kFrame);
    EXPECT_EQ(header.kind, FrameKind::kState);
    EXPECT_EQ(header.sequence, 9u);
    StateFrame back;
    ASSERT_EQ(DecodeState(bytes.data() + kHeaderBytes, header.size, axes, back), Decoded::kFrame);
    EXPECT_EQ(back.position, state.position);
    EXPECT_EQ(back.velocity, state.velocity);
    EXPECT_EQ(back.effort, state.effort);
    EXPECT_EQ(back.faults, state.faults);
    EXPECT_EQ(back.command_ns, state.command_ns);
    const CommandFrame command = SomeCommand(axes);
    const size_t written = EncodeCommand(command, 10, bytes);
    ASSERT_EQ(DecodeHeader(bytes.data(), written, header), Decoded::kFrame);
    CommandFrame obeyed;
    ASSERT_EQ(DecodeCommand(bytes.data() + kHeaderBytes, header.size, axes, obeyed),
              Decoded::kFrame);
    EXPECT_EQ(obeyed.position, command.position);
    EXPECT_EQ(obeyed.state, command.state);
  }
}

TEST(BridgeProtocol, RefusesWhatIsNoFrame) {
  std::array<uint8_t, kMostFrame> bytes{};
  const size_t size = EncodeState(SomeState(6), 1, bytes);
  FrameHeader header;
  for (size_t part = 1; part < size; ++part)
    EXPECT_EQ(DecodeHeader(bytes.data(), part, header), Decoded::kMore) << part;
  const auto changed = [&](size_t at, uint8_t value) {
    auto copy = bytes;
    copy[at] = value;
    return DecodeHeader(copy.data(), size, header);
  };
  EXPECT_EQ(changed(0, 'X'), Decoded::kMagic);
  EXPECT_EQ(changed(4, 2), Decoded::kVersion);
  EXPECT_EQ(changed(5, 0), Decoded::kKind);
  EXPECT_EQ(changed(5, 7), Decoded::kKind);
  EXPECT_EQ(changed(7, 0x11), Decoded::kLength) << "more than a frame may have";
  StateFrame state;
  const uint8_t* payload = bytes.data() + kHeaderBytes;
  EXPECT_EQ(DecodeState(payload, size - kHeaderBytes, 5, state), Decoded::kLength);
  EXPECT_EQ(DecodeState(payload, size - kHeaderBytes - 8, 6, state), Decoded::kLength);
  for (const double wrong : {std::numeric_limits<double>::quiet_NaN(),
                             std::numeric_limits<double>::infinity(), 1.1 * kMostValue}) {
    for (size_t value = 0; value < 18; ++value) {
      auto copy = bytes;
      std::memcpy(copy.data() + kHeaderBytes + kStateBytes + 8 * value, &wrong, sizeof wrong);
      EXPECT_EQ(DecodeState(copy.data() + kHeaderBytes, size - kHeaderBytes, 6, state),
                Decoded::kNotFinite)
          << value;
    }
  }
}

// Whole frames with changed bytes, a million of them in a second: what is taken holds numbers only,
// and writes the same bytes again.
TEST(BridgeProtocol, WhatIsTakenOfChangedFramesIsWhole) {
  std::mt19937_64 random(7);
  int taken = 0;
  for (int round = 0; round < 100'000; ++round) {
    std::array<uint8_t, kMostFrame> bytes{};
    const int axes = 1 + static_cast<int>(random() % kMostAxes);
    const bool states = random() % 2 == 0;
    const size_t size = states ? EncodeState(SomeState(axes), 5, bytes)
                               : EncodeCommand(SomeCommand(axes), 5, bytes);
    for (int change = 0; change < static_cast<int>(random() % 4); ++change)
      bytes[random() % size] = static_cast<uint8_t>(random());
    FrameHeader header;
    if (DecodeHeader(bytes.data(), size, header) != Decoded::kFrame) continue;
    ASSERT_LE(kHeaderBytes + header.size, size);
    std::array<uint8_t, kMostFrame> again{};
    const uint8_t* payload = bytes.data() + kHeaderBytes;
    if (header.kind == FrameKind::kState) {
      StateFrame state;
      if (DecodeState(payload, header.size, axes, state) != Decoded::kFrame) continue;
      for (int i = 0; i < kMostAxes; ++i)
        ASSERT_LE(std::abs(state.position[i]) + std::abs(state.velocity[i]), 2 * kMostValue);
      EncodeState(state, header.sequence, again);
    } else if (header.kind == FrameKind::kCommand) {
      CommandFrame command;
      if (DecodeCommand(payload, header.size, axes, command) != Decoded::kFrame) continue;
      bytes[kHeaderBytes + 20] = bytes[kHeaderBytes + 21] = 0;  // reserved
      bytes[kHeaderBytes + 22] = bytes[kHeaderBytes + 23] = 0;
      EncodeCommand(command, header.sequence, again);
    } else {
      continue;
    }
    ++taken;
    ASSERT_EQ(bytes, again);
  }
  EXPECT_GT(taken, 30'000);
}

TEST(BridgeProtocol, ReadsAWelcomeAndNamesWhatIsWrongInIt) {
  const auto read = ParseWelcome(SomeWelcome().dump());
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->axes, (std::vector<std::string>{"a", "b"}));
  EXPECT_TRUE(read->hold && read->torque_off && read->monotonic && !read->stop);
  EXPECT_EQ(read->on_silence, OnSilence::kHold);
  for (const auto& [key, value] :
       std::vector<std::pair<std::string, nlohmann::json>>{{"stop", "yes"},
                                                           {"watchdog_s", -1},
                                                           {"watchdog_s", "soon"},
                                                           {"on_silence", "dance"},
                                                           {"clock", "sundial"},
                                                           {"axes", nlohmann::json::array()},
                                                           {"axes", {1, 2}},
                                                           {"driver", 5}}) {
    nlohmann::json wrong = SomeWelcome();
    wrong[key] = value;
    EXPECT_THAT(std::string(ParseWelcome(wrong.dump()).status().message()), HasSubstr(key));
    wrong.erase(key);
    EXPECT_FALSE(ParseWelcome(wrong.dump()).ok()) << key << " is missing";
  }
  for (const char* text : {"", "[]", "{", "null", "\"x\"", "{\"protocol\":1}"})
    EXPECT_FALSE(ParseWelcome(text).ok()) << text;
}

TEST(BridgeProtocol, ReadsInWhatADriverCounts) {
  nlohmann::json welcome = SomeWelcome();
  EXPECT_THAT(ParseWelcome(welcome.dump())->units, ElementsAre(SaidUnit(), SaidUnit()));
  welcome["units"] = {{"b", "degrees"}, {"a", {-100, 100}}, {"c", "furlongs"}};
  EXPECT_THAT(ParseWelcome(welcome.dump())->units,
              ElementsAre(SaidUnit{"", {-100, 100}}, SaidUnit{"degrees", {}}));
  for (const nlohmann::json& wrong : std::vector<nlohmann::json>{
           "furlongs", 5, {1}, {1, 2, 3}, {1, 1}, {2, 1}, {"a", "b"}, nullptr}) {
    welcome["units"] = {{"b", wrong}};
    EXPECT_THAT(std::string(ParseWelcome(welcome.dump()).status().message()), HasSubstr("units.b"))
        << wrong;
  }
  welcome["units"] = "degrees";
  EXPECT_FALSE(ParseWelcome(welcome.dump()).ok());
}

TEST(BridgeProtocol, ShowsADriversWordsWithoutControlCharacters) {
  nlohmann::json welcome = SomeWelcome();
  welcome["driver"] = "a\x1b[2Jb\n" + std::string(5000, 'x');
  const auto read = ParseWelcome(welcome.dump());
  ASSERT_TRUE(read.ok());
  EXPECT_EQ(read->driver.substr(0, 8), "a [2Jb x");
  EXPECT_LE(read->driver.size(), 200u);
  EXPECT_EQ(ParseRefusal("{\"reason\":\"no\\u0007\"}"), "no ");
  EXPECT_EQ(ParseRefusal("not json"), "not json");
}

}  // namespace
}  // namespace robostress::bridge
