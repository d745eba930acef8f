#include "calibration/search/subplex.h"

#include <nlopt.h>

#include <algorithm>
#include <cmath>
#include <memory>

namespace robostress::calibration {
namespace {

constexpr double kTolerance = 1e-4;  // of the error, relative

using Error = std::function<double(const Eigen::VectorXd&)>;

double Call(unsigned count, const double* x, double*, void* error) {
  const double value =
      (*static_cast<const Error*>(error))(Eigen::Map<const Eigen::VectorXd>(x, count));
  return std::isfinite(value) ? value : HUGE_VAL;
}

}  // namespace

SubplexMinimum Subplex(const Error& error, const std::vector<FreeParameter>& free,
                       Eigen::VectorXd start, int max_evaluations) {
  const auto count = static_cast<unsigned>(free.size());
  const std::unique_ptr<nlopt_opt_s, decltype(&nlopt_destroy)> search(
      nlopt_create(NLOPT_LN_SBPLX, count), &nlopt_destroy);
  std::vector<double> lower, upper;
  for (unsigned i = 0; i < count; ++i) {
    lower.push_back(free[i].lower);
    upper.push_back(free[i].upper);
    start[i] = std::clamp(start[i], lower.back(), upper.back());
  }
  nlopt_set_lower_bounds(search.get(), lower.data());
  nlopt_set_upper_bounds(search.get(), upper.data());
  nlopt_set_min_objective(search.get(), &Call, const_cast<Error*>(&error));
  nlopt_set_maxeval(search.get(), max_evaluations);
  nlopt_set_ftol_rel(search.get(), kTolerance);
  SubplexMinimum minimum{std::move(start), HUGE_VAL};
  // Also where it ends early it leaves the best that it saw.
  nlopt_optimize(search.get(), minimum.x.data(), &minimum.value);
  return minimum;
}

}  // namespace robostress::calibration
