#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/wire/openpi_value.h"

// Numbers and texts out of a decoded message. Each looks at how much a value holds before it
// converts or copies any of it: what is allocated follows from what is expected, not from what
// came.
namespace robostress {

// How many numbers an array of any shape, a list or a scalar holds.
size_t OpenpiCount(const OpenpiValue& value);
// Those numbers, at most `most`. INVALID_ARGUMENT names `field`, and the entry that is not finite
// or no number.
absl::StatusOr<std::vector<double>> OpenpiNumbers(const std::string& field,
                                                  const OpenpiValue& value, size_t most);

// What a side of a matrix may measure.
struct OpenpiSide {
  OpenpiSide(int exactly) : least(exactly), most(exactly) {}  // NOLINT: a number is a side
  OpenpiSide(int least, int most) : least(least), most(most) {}
  int least, most;
};
// An array of two dimensions.
absl::StatusOr<Eigen::MatrixXd> OpenpiMatrix(const std::string& field, const OpenpiValue& value,
                                             OpenpiSide rows, OpenpiSide cols);
// Integer within [low, high].
absl::StatusOr<int64_t> OpenpiInteger(const std::string& field, const OpenpiValue& value,
                                      int64_t low, int64_t high);

// A text (or bytes) of at most `most` bytes of UTF-8.
absl::StatusOr<std::string> OpenpiText(const std::string& field, const OpenpiValue& value,
                                       size_t most);

}  // namespace robostress
