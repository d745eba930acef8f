#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>

#include "common/types.h"

namespace robostress {

// What became of one camera's newest picture when a prediction was asked for.
enum class FrameUse : uint8_t { kShown, kMissing, kStale, kFuture };
inline const char* FrameUseName(FrameUse use) {
  constexpr const char* kNames[] = {"shown", "missing", "stale", "future"};
  return kNames[static_cast<int>(use)];
}

// One camera's picture of one prediction; a row of frames.csv.
struct FrameRecord {
  uint64_t request = 0;        // of the control loop: 1, 2, 3 ...
  uint64_t prediction_id = 0;  // as in TickRecord; 0 where there was no prediction
  int32_t episode = 0, chunk = 0;
  std::array<char, 32> camera{};  // its name, cut, with a zero at its end
  FrameUse use = FrameUse::kMissing;
  uint64_t sequence = 0;    // of the picture; 0 before the first, as the next
  int64_t stamp_ns = 0;     // of the picture
  int64_t observed_ns = 0;  // when it was taken for the prediction; the age is the difference
  // As it was sent, in the policy's size; null where pictures are not kept or none was shown.
  std::shared_ptr<const Image> picture;
};

// What stands for a camera in the name of a picture's file: every byte but letters, digits, '-',
// '_' and '.' is '_'.
inline std::string CameraInFileNames(std::string name) {
  for (char& c : name) {
    const bool kept = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                      c == '-' || c == '_' || c == '.';
    if (!kept) c = '_';
  }
  return name;
}

}  // namespace robostress
