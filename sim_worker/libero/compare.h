#pragma once

#include <string>
#include <vector>

#include "common/safetensors.h"

namespace robostress::libero {

// One tensor of two files.
struct TensorDifference {
  enum class Kind { kEqualShape, kShapes, kOnlyInA, kOnlyInB };
  std::string key;
  Kind kind = Kind::kEqualShape;
  std::vector<int64_t> shape_a, shape_b;
  double largest = 0;  // max |a - b|; NaN against a number counts as infinite
  int64_t at = 0;      // flat index of the largest
  double value_a = 0, value_b = 0;
};

// Every key of either file, in alphabetical order, values compared as doubles.
absl::StatusOr<std::vector<TensorDifference>> CompareTensors(const SafetensorsFile& a,
                                                             const SafetensorsFile& b);

// A table with a line per key: largest difference, where, and both values.
std::string ComparisonTable(const std::vector<TensorDifference>& differences);

}  // namespace robostress::libero
