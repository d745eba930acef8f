#pragma once

#include <Eigen/Core>
#include <string>

#include "absl/status/statusor.h"
#include "server/policies/openpi/norm_stats.h"

namespace robostress::openpi {

// x -> y, per dimension:
//   kZScore    y = (x - mean) / (std + e)                      x = y (std + e') + mean
//   kQuantile  y = 2 (x - q01) / (q99 - q01 + e) - 1           x = (y + 1) / 2 (q99 - q01 + e) +
//   q01 kNone      y = x
enum class NormKind { kNone, kZScore, kQuantile };
const char* NormKindName(NormKind kind);  // "none", "z_score", "quantile"

// Whose epsilon.
//   kOpenpi   e = e' = 1e-6, always added
//   kLerobot  z-score: e = 1e-8, e' = 0; quantile: e = 1e-8 where q99 = q01, else 0
enum class NormConvention { kOpenpi, kLerobot };
const char* NormConventionName(NormConvention convention);  // "openpi", "lerobot"

// The normalisation of states or actions, in double precision. Entries beyond the statistics are
// padding: mean 0 and std 1 under z-score, unchanged under quantiles. Immutable.
class Normaliser {
 public:
  // `what` names file and field in errors. Refuses statistics with fewer than `dims` entries,
  // entries that are not finite, std < 0, q99 < q01, and quantiles where none were recorded.
  static absl::StatusOr<Normaliser> Create(const std::string& what, const FieldStats& stats,
                                           NormKind kind, NormConvention convention, int64_t dims);
  static Normaliser Identity() { return Normaliser(); }

  NormKind kind() const { return kind_; }
  // Rows are samples [n, d], of any d.
  Eigen::MatrixXd Normalise(const Eigen::MatrixXd& x) const;
  Eigen::MatrixXd Unnormalise(const Eigen::MatrixXd& y) const;

 private:
  NormKind kind_ = NormKind::kNone;
  // y = (x - offset) / forward [* 2 - 1], x = y [+ 1, / 2] * backward + offset.
  Eigen::ArrayXd offset_, forward_, backward_;
  double padding_forward_ = 1, padding_backward_ = 1;
};

}  // namespace robostress::openpi
