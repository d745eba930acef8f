#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace robostress {

// Where an answer's actions stand in its bytes: [rows, cols] numbers of `item` bytes, row by row,
// little-endian. What a correction writes goes there and nowhere else.
struct ActionBlock {
  size_t offset = 0;  // of the first number [bytes]
  int rows = 0, cols = 0;
  size_t item = 4;             // 4: float32, 8: float64
  uint64_t prediction_id = 0;  // what our own server calls the answer; 0: another's
};

// In an answer of openpi's server or a relative of it: an array [H, A] or [1, H, A] under
// "actions", alone in a map, or bare. INVALID_ARGUMENT: no such array; UNIMPLEMENTED: its numbers
// are neither float32 nor float64.
absl::StatusOr<ActionBlock> FindActions(std::string_view answer);

// [rows, cols] as they stand there, finite or not.
Eigen::MatrixXd ReadActions(std::string_view answer, const ActionBlock& block);

// The value that one number gets; what it becomes in its type is returned.
double WriteAction(std::string& answer, const ActionBlock& block, int row, int col, double value);

}  // namespace robostress
