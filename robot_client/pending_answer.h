#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "robot_client/control/control_loop.h"

namespace robostress {

// An order that was given and goes on: its answer for the person once there is one, and what is
// said when there is none in time.
struct PendingAnswer {
  std::string what;
  int64_t until_ns = 0;
  std::function<std::optional<absl::StatusOr<std::string>>()> answer;
  absl::Status late;
};

inline constexpr double kDecides_s = 1;  // within which the loop decides a request

// Why the loop did not do `what`, with what to type next.
absl::Status Refused(const ControlLoop& loop, const std::string& what);

// `answer` if `done` holds once the loop has decided what it is asked for next; its refusal else.
// Made before the loop is asked.
PendingAnswer AwaitDecision(const ControlLoop* loop, const Clock& clock, std::string what,
                            double seconds, std::function<bool()> done, std::string answer);

}  // namespace robostress
