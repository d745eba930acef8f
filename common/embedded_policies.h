#pragma once

#include <algorithm>
#include <array>
#include <string_view>

namespace robostress {

// Policies whose weights come with the source, server/models/weights/NAME.safetensors: the embedded
// policy in pi0's architecture; the same trained on with plain behaviour cloning (the control),
// with domain randomisation and with RobustVLA's objective; one in pi0.5's architecture
// (server/training/README.md).
inline constexpr std::array<std::string_view, 5> kEmbeddedPolicies = {"nano", "nano-bc", "nano-dr",
                                                                      "nano-robust", "nano-pi05"};

inline bool IsEmbeddedPolicy(std::string_view name) {
  return std::find(kEmbeddedPolicies.begin(), kEmbeddedPolicies.end(), name) !=
         kEmbeddedPolicies.end();
}

}  // namespace robostress
