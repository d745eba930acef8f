#include "robot_client/piper/status_words.h"

#include <array>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress::piper {
namespace {

template <size_t N>
std::string Named(const std::array<const char*, N>& names, unsigned value) {
  return value < N ? names[value] : absl::StrCat("unknown (", value, ")");
}

template <size_t N>
std::string BitWords(const std::array<const char*, N>& names, unsigned bits) {
  std::vector<std::string> words;
  for (size_t i = 0; i < N; ++i) {
    if ((bits & (1u << i)) != 0 && names[i] != nullptr) words.emplace_back(names[i]);
  }
  return absl::StrJoin(words, ", ");
}

}  // namespace

std::string WordsOf(ControlMode mode) {
  static constexpr std::array<const char*, 8> kNames = {
      "standby", "commands over CAN", "teaching",        "Ethernet",
      "Wi-Fi",   "remote control",    "leader-follower", "offline trajectory"};
  return Named(kNames, static_cast<unsigned>(mode));
}

std::string WordsOf(MoveMode mode) {
  static constexpr std::array<const char*, 6> kNames = {
      "P (tool pose)", "J (joint targets)", "L (line)", "C (arc)", "M (torque)", "CPV"};
  return Named(kNames, static_cast<unsigned>(mode));
}

std::string WordsOf(StatusCode code) {
  static constexpr std::array<const char*, 16> kNames = {
      "normal",
      "emergency stop",
      "no solution for a tool pose",
      "singular pose",
      "target beyond a limit: the arm no longer responds",
      "a joint does not answer the controller",
      "a brake has not opened",
      "collision protection has stopped the arm",
      "too fast while it was taught",
      "abnormal joint",
      "other abnormality",
      "recording what it is taught",
      "playing what it was taught",
      "teaching paused",
      "controller too hot",
      "brake resistor too hot"};
  return Named(kNames, static_cast<unsigned>(code));
}

std::string TeachWords(uint8_t teach) {
  static constexpr std::array<const char*, 8> kNames = {
      "off",    "recording", "recording ended", "playing",
      "paused", "going on",  "ended",           "driving to the start"};
  return Named(kNames, teach);
}

std::string DriverFaultWords(uint8_t bits) {
  static constexpr std::array<const char*, 8> kNames = {
      "under-voltage",        "motor too hot", "over-current", "driver too hot",
      "collision protection", "driver error",  nullptr,        "stalled motor"};
  return BitWords(kNames, bits);
}

std::string GripperFaultWords(uint8_t errors) {
  static constexpr std::array<const char*, 6> kNames = {"under-voltage", "motor too hot",
                                                        "over-current",  "driver too hot",
                                                        "sensor error",  "driver error"};
  return BitWords(kNames, errors);
}

std::string ReportWords(uint16_t id) {
  const auto joint = [&](int first, const char* what) {
    return absl::StrCat(what, " J", id - first + 1);
  };
  if (id >= kJointSpeed && id < kJointSpeed + kJoints)
    return joint(kJointSpeed, "speed and current");
  if (id >= kDriver && id < kDriver + kJoints) return joint(kDriver, "driver");
  if (id >= kJointAngles && id < kJointAngles + 3) {
    const int first = 2 * (id - kJointAngles) + 1;
    return absl::StrCat("angles J", first, " J", first + 1);
  }
  if (id >= kEndPose && id < kEndPose + 3) return absl::StrCat("tool pose ", id - kEndPose + 1);
  switch (id) {
    case kArmStatus:
      return "status";
    case kGripper:
      return "gripper";
    case kJointLimit:
      return "answer: limits";
    case kWriteReply:
      return "a write was taken";
    case kEndVelocity:
      return "answer: tool limits";
    case kCollisionLevel:
      return "answer: collision levels";
    case kJointAcceleration:
      return "answer: accelerations";
    case kGripperRange:
      return "answer: gripper";
    case kFirmware:
      return "answer: firmware";
    default:
      return "";
  }
}

}  // namespace robostress::piper
