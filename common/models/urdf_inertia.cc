#include "common/models/urdf_inertia.h"

#include "absl/strings/str_format.h"

namespace robostress {
namespace {

constexpr double kRounding = 1e-6;  // of the largest moment: files hold six digits
constexpr double kMargin = 1e-9;    // MuJoCo computes the moments again, and asks once more
constexpr double kNothing = 1e-15;  // [kg m^2]: a milligram 30 um away
constexpr double kLight = 0.001;    // [kg]: an exporter's frame, whose inertia nobody measured

}  // namespace

absl::StatusOr<InertiaRepair> RepairInertia(const Eigen::Matrix3d& given, double mass) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(given);
  InertiaRepair repair;
  repair.inertia = given;
  repair.before = solver.eigenvalues();
  repair.after = repair.before;
  const double size = repair.before.cwiseAbs().maxCoeff();
  if (size < kNothing) {
    repair.inertia.setZero();
    return repair;
  }
  if (repair.before[0] < -kRounding * size && mass >= kLight)
    return absl::InvalidArgumentError(absl::StrFormat(
        "a principal moment is %.4g kg m^2, must be at least 0; are products of inertia (ixy, ixz, "
        "iyz) mixed up, or is it about another point than the centre of mass?",
        repair.before[0]));
  Eigen::Vector3d& moments = repair.after;
  moments = moments.cwiseMax(0.0);
  const double missing = moments[2] - moments[0] - moments[1];
  if (missing <= -kMargin * size && repair.before[0] >= 0) return repair;
  if (const double lift = (missing + kMargin * size) / 3; lift > 0)
    moments += lift * Eigen::Vector3d(1, 1, -1);
  repair.changed = (moments - repair.before).cwiseAbs().maxCoeff() > kRounding * size;
  repair.inertia = solver.eigenvectors() * moments.asDiagonal() * solver.eigenvectors().transpose();
  return repair;
}

}  // namespace robostress
