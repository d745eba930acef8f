#include "sim_worker/libero/compare.h"

#include <cmath>
#include <limits>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

double Distance(double a, double b) {
  if (a == b || (std::isnan(a) && std::isnan(b))) return 0;
  const double distance = std::abs(a - b);
  return std::isnan(distance) ? std::numeric_limits<double>::infinity() : distance;
}

// "[3, 2]" of a flat index.
std::string Position(int64_t at, const std::vector<int64_t>& shape) {
  std::vector<int64_t> position(shape.size());
  for (size_t i = shape.size(); i-- > 0;) {
    position[i] = at % shape[i];
    at /= shape[i];
  }
  return absl::StrCat("[", absl::StrJoin(position, ", "), "]");
}

std::string ShapeText(const std::vector<int64_t>& shape) {
  return absl::StrCat("[", absl::StrJoin(shape, ", "), "]");
}

}  // namespace

absl::StatusOr<std::vector<TensorDifference>> CompareTensors(const SafetensorsFile& a,
                                                             const SafetensorsFile& b) {
  std::set<std::string> keys;
  for (const auto& [key, view] : a.tensors()) keys.insert(key);
  for (const auto& [key, view] : b.tensors()) keys.insert(key);
  std::vector<TensorDifference> differences;
  for (const std::string& key : keys) {
    TensorDifference& d = differences.emplace_back();
    d.key = key;
    const auto in_a = a.tensors().find(key), in_b = b.tensors().find(key);
    if (in_a != a.tensors().end()) d.shape_a = in_a->second.shape;
    if (in_b != b.tensors().end()) d.shape_b = in_b->second.shape;
    using Kind = TensorDifference::Kind;
    if (in_b == b.tensors().end()) {
      d.kind = Kind::kOnlyInA;
    } else if (in_a == a.tensors().end()) {
      d.kind = Kind::kOnlyInB;
    } else if (d.shape_a != d.shape_b) {
      d.kind = Kind::kShapes;
    }
    if (d.kind != Kind::kEqualShape) continue;
    RS_ASSIGN_OR_RETURN(const std::vector<double> x, a.ReadDoubles(key));
    RS_ASSIGN_OR_RETURN(const std::vector<double> y, b.ReadDoubles(key));
    for (size_t i = 0; i < x.size(); ++i) {
      const double distance = Distance(x[i], y[i]);
      if (i > 0 && distance <= d.largest) continue;
      d.largest = distance;
      d.at = static_cast<int64_t>(i);
      d.value_a = x[i];
      d.value_b = y[i];
    }
  }
  return differences;
}

std::string ComparisonTable(const std::vector<TensorDifference>& differences) {
  using Kind = TensorDifference::Kind;
  std::string table =
      absl::StrFormat("%-26s %-14s %-10s %s\n", "key", "shape", "largest", "at: A, B");
  for (const TensorDifference& d : differences) {
    switch (d.kind) {
      case Kind::kOnlyInA:
      case Kind::kOnlyInB:
        absl::StrAppendFormat(&table, "%-26s %-14s only in %s\n", d.key,
                              ShapeText(d.kind == Kind::kOnlyInA ? d.shape_a : d.shape_b),
                              d.kind == Kind::kOnlyInA ? "A" : "B");
        break;
      case Kind::kShapes:
        absl::StrAppendFormat(&table, "%-26s shapes differ: %s, %s\n", d.key, ShapeText(d.shape_a),
                              ShapeText(d.shape_b));
        break;
      case Kind::kEqualShape:
        absl::StrAppendFormat(&table, "%-26s %-14s %-10.3g", d.key, ShapeText(d.shape_a),
                              d.largest);
        if (d.largest > 0) {
          absl::StrAppendFormat(&table, " %s: %.17g, %.17g", Position(d.at, d.shape_a), d.value_a,
                                d.value_b);
        }
        table += "\n";
    }
  }
  return table;
}

}  // namespace robostress::libero
