#pragma once

#include <Eigen/Core>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_value.h"

// What comes back for an observation, from openpi's server and its relatives.
namespace robostress {

struct OpenpiAnswer {
  Eigen::MatrixXf actions;  // [horizon, action_dim]
  double infer_ms = 0;      // policy_timing's, else server_timing's; 0: the server says nothing
};

// The actions in an answer: an array of numbers [H, A], [1, H, A], or [A] for a single row, under
// "actions" or "action", alone in a map under any other key, or without a map. `rows`, `cols`: what
// they may measure. Errors: OpenpiRefusal's; otherwise INVALID_ARGUMENT says what came, what was
// expected, and which number is not finite.
absl::StatusOr<OpenpiAnswer> ReadOpenpiAnswer(const OpenpiValue& answer, OpenpiSide rows,
                                              OpenpiSide cols);

// INTERNAL with the message of a map {type: "error", message}, as vLLM-Omni answers; else OK.
absl::Status OpenpiRefusal(const OpenpiValue& answer);

// Where an answer has its actions, by the same rule; null: nowhere. It may be anything.
const OpenpiValue* OpenpiActionsIn(const OpenpiValue& answer);

// A text frame: the server's end of the conversation. INTERNAL with the last line of its text,
// which is what a Python traceback says.
absl::Status OpenpiErrorText(const std::string& text);

}  // namespace robostress
