#pragma once

#include <algorithm>
#include <array>
#include <string_view>

namespace robostress {

// The one that learned LIBERO's forty tasks.
inline constexpr char kLiberoPolicy[] = "nano-libero";

// Policies whose weights come with the source, server/models/weights/NAME.safetensors
// (server/training/README.md). Those of the suites' Panda: the embedded policy in pi0's
// architecture; the same trained on with plain behaviour cloning (the control), with domain
// randomisation and with RobustVLA's objective; one in pi0.5's architecture; LIBERO's.
inline constexpr std::array<std::string_view, 6> kSuitePolicies = {
    "nano", "nano-bc", "nano-dr", "nano-robust", "nano-pi05", kLiberoPolicy};

// A Piper's: joint targets from two cameras, for the four tasks of the Piper study.
inline constexpr char kPiperPolicy[] = "nano-piper";

inline bool IsSuitePolicy(std::string_view name) {
  return std::find(kSuitePolicies.begin(), kSuitePolicies.end(), name) != kSuitePolicies.end();
}

inline bool IsEmbeddedPolicy(std::string_view name) {
  return IsSuitePolicy(name) || name == kPiperPolicy;
}

}  // namespace robostress
