#pragma once

#include <compare>
#include <optional>
#include <string>
#include <string_view>

#include "robot_client/piper/kinematics.h"

namespace robostress::piper {

// "S-V1.8-4": major 1, minor 8, patch 4.
struct Firmware {
  int major = 0, minor = 0, patch = 0;
  auto operator<=>(const Firmware&) const = default;  // NOLINT(modernize-use-nullptr): its own zero
};

// The version in the text of the firmware answers; nothing when there is none, or when it may be
// cut off (no digit after the dash).
std::optional<Firmware> ParseFirmware(std::string_view text);
std::string FirmwareName(const Firmware& firmware);

// First version with protocol V2 (SDK 0.6.1, README).
inline constexpr Firmware kOldestFirmware = {1, 5, 2};
inline Zero ZeroOf(const Firmware& firmware) {
  return firmware >= Firmware{1, 6, 3} ? Zero::kSince_1_6_3 : Zero::kBefore_1_6_3;
}
// Torque over reported current times TorquePerAmpere(joint): 4 at joints 1 to 3 of firmware up to
// S-V1.8-2 (SDK 0.6.1, Q&A 3.2), else 1.
double CurrentScale(const Firmware& firmware, int joint);

}  // namespace robostress::piper
