#include "server/policies/openpi/normalisation.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

constexpr double kOpenpiEpsilon = 1e-6, kLerobotEpsilon = 1e-8;

constexpr char kRemedy[] =
    "Give the norm stats of the data that the checkpoint was trained on, or name another set with "
    "asset_id";

// Lengths of the two statistics that `kind` reads, their values, and what they may not be.
std::vector<std::string> Problems(const char* low_name, const std::vector<double>& low,
                                  const char* high_name, const std::vector<double>& high,
                                  NormKind kind, int64_t dims) {
  std::vector<std::string> problems;
  if (low.empty() || high.empty()) {
    problems.push_back(absl::StrCat(low_name, " or ", high_name, " is not recorded, normalisation ",
                                    NormKindName(kind), " needs both"));
    return problems;
  }
  for (const auto& [name, values] : {std::pair(low_name, &low), std::pair(high_name, &high)}) {
    if (static_cast<int64_t>(values->size()) < dims) {
      problems.push_back(
          absl::StrCat(name, " has ", values->size(), " numbers, must have at least ", dims));
    }
    for (size_t i = 0; i < values->size(); ++i) {
      if (!std::isfinite((*values)[i]))
        problems.push_back(absl::StrCat(name, "[", i, "] is ", (*values)[i], ", must be finite"));
    }
  }
  for (size_t i = 0; i < std::min(low.size(), high.size()); ++i) {
    if (kind == NormKind::kZScore && high[i] < 0)
      problems.push_back(absl::StrCat(high_name, "[", i, "] is ", high[i], ", must be 0 or above"));
    if (kind == NormKind::kQuantile && high[i] < low[i])
      problems.push_back(absl::StrCat(high_name, "[", i, "] is ", high[i], ", below ", low_name,
                                      "[", i, "] = ", low[i]));
  }
  return problems;
}

Eigen::ArrayXd Row(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::ArrayXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

}  // namespace

const char* NormKindName(NormKind kind) {
  switch (kind) {
    case NormKind::kNone:
      return "none";
    case NormKind::kZScore:
      return "z_score";
    case NormKind::kQuantile:
      return "quantile";
  }
  return "?";
}

const char* NormConventionName(NormConvention convention) {
  return convention == NormConvention::kOpenpi ? "openpi" : "lerobot";
}

absl::StatusOr<Normaliser> Normaliser::Create(const std::string& what, const FieldStats& stats,
                                              NormKind kind, NormConvention convention,
                                              int64_t dims) {
  Normaliser result;
  result.kind_ = kind;
  if (kind == NormKind::kNone) return result;
  const bool openpi = convention == NormConvention::kOpenpi;
  const bool z_score = kind == NormKind::kZScore;
  const auto problems = z_score ? Problems("mean", stats.mean, "std", stats.std, kind, dims)
                                : Problems("q01", stats.q01, "q99", stats.q99, kind, dims);
  if (absl::Status status = ProblemList(what, "these statistics do not fit", problems, kRemedy);
      !status.ok()) {
    return status;
  }
  if (z_score) {
    const double epsilon = openpi ? kOpenpiEpsilon : kLerobotEpsilon;
    result.offset_ = Row(stats.mean);
    result.forward_ = Row(stats.std) + epsilon;
    result.backward_ = openpi ? result.forward_ : Row(stats.std);
    result.padding_forward_ = 1 + epsilon;
    result.padding_backward_ = openpi ? 1 + epsilon : 1;
  } else {
    const Eigen::ArrayXd range = Row(stats.q99) - Row(stats.q01);
    result.offset_ = Row(stats.q01);
    result.forward_ = range + kOpenpiEpsilon;
    if (!openpi) result.forward_ = (range == 0).select(kLerobotEpsilon, range);
    result.backward_ = result.forward_;
  }
  return result;
}

Eigen::MatrixXd Normaliser::Normalise(const Eigen::MatrixXd& x) const {
  Eigen::MatrixXd y = x / padding_forward_;
  const Eigen::Index known = std::min<Eigen::Index>(x.cols(), offset_.size());
  for (Eigen::Index j = 0; j < known; ++j) {
    y.col(j) = (x.col(j).array() - offset_[j]) / forward_[j];
    if (kind_ == NormKind::kQuantile) y.col(j) = y.col(j).array() * 2 - 1;
  }
  return y;
}

Eigen::MatrixXd Normaliser::Unnormalise(const Eigen::MatrixXd& y) const {
  Eigen::MatrixXd x = y * padding_backward_;
  const Eigen::Index known = std::min<Eigen::Index>(y.cols(), offset_.size());
  for (Eigen::Index j = 0; j < known; ++j) {
    if (kind_ == NormKind::kQuantile) {
      x.col(j) = (y.col(j).array() + 1) / 2 * backward_[j] + offset_[j];
    } else {
      x.col(j) = y.col(j).array() * backward_[j] + offset_[j];
    }
  }
  return x;
}

}  // namespace robostress::openpi
