#include "adapter/panda_dynamics.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <array>

namespace robostress {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Jacobian = Eigen::Matrix<double, 3, 7>;

// The simulator's own are in sim_worker/panda_mjcf.cc; its test compares the two.
//
// One link: its frame in the parent's, turned by `quarter` quarter turns about x and then about its
// joint's axis z; its mass, and its inertia, the same about all axes.
struct Link {
  std::array<double, 3> offset;  // [m]
  int quarter;
  std::array<double, 3> centre;    // of mass [m]
  double mass, inertia, armature;  // [kg], [kg m^2]
};

constexpr std::array<Link, 7> kLinks = {{
    {{0, 0, 0.333}, 0, {0, 0, -0.07}, 3, 0.3, 5.0},
    {{0, 0, 0}, -1, {0, -0.1, 0}, 3, 0.3, 5.0 / 2},
    {{0, -0.316, 0}, 1, {0.04, 0, -0.05}, 2, 0.2, 5.0 / 3},
    {{0.0825, 0, 0}, 1, {-0.04, 0.05, 0}, 2, 0.2, 5.0 / 4},
    {{-0.0825, 0.384, 0}, -1, {0, 0, -0.15}, 2, 0.2, 5.0 / 5},
    {{0, 0, 0}, 1, {0.06, 0, 0}, 1.5, 0.1, 5.0 / 6},
    {{0.088, 0, 0}, 1, {0, 0, 0.08}, 0.5, 0.05, 5.0 / 7},
}};

// On the axis of link 7, `height` above its origin; inertia about the axes of the hand, which is
// turned by -45 degrees.
struct Piece {
  double height, mass;
  std::array<double, 3> inertia;
};

constexpr double kHand_m = 0.1065;
constexpr double kTool_m = kHand_m + 0.097;
constexpr std::array<Piece, 4> kHand = {{
    {kHand_m, 0.5, {0.05, 0.05, 0.05}},
    {kHand_m + 0.17, 0.3, {0.05, 0.09, 0.07}},             // gripper
    {kHand_m + 0.0524 + 0.05, 0.2, {0.02, 0.02, 0.01}},    // fingers
    {kHand_m + 0.0524 + 0.056, 0.02, {0.02, 0.02, 0.02}},  // their tips
}};

Eigen::Vector3d Vector(const std::array<double, 3>& values) {
  return Eigen::Map<const Eigen::Vector3d>(values.data());
}

// Frames and joint axes of the links that are turned by q.
struct Chain {
  std::array<Eigen::Matrix3d, 7> R;
  std::array<Eigen::Vector3d, 7> p;

  explicit Chain(const Eigen::VectorXd& q) {
    Eigen::Matrix3d at = Eigen::Matrix3d::Identity();
    Eigen::Vector3d from = Eigen::Vector3d::Zero();
    for (int i = 0; i < 7; ++i) {
      from += at * Vector(kLinks[i].offset);
      at *= (Eigen::AngleAxisd(kLinks[i].quarter * EIGEN_PI / 2, Eigen::Vector3d::UnitX()) *
             Eigen::AngleAxisd(q[i], Eigen::Vector3d::UnitZ()))
                .toRotationMatrix();
      R[i] = at;
      p[i] = from;
    }
  }

  // Of a point that moves with the links up to `last`.
  Jacobian Moves(const Eigen::Vector3d& point, int last) const {
    Jacobian moves = Jacobian::Zero();
    for (int i = 0; i <= last; ++i) moves.col(i) = R[i].col(2).cross(point - p[i]);
    return moves;
  }
  Eigen::Vector3d Tool() const { return p[6] + kTool_m * R[6].col(2); }
  Jacobian Turns(int last) const {
    Jacobian turns = Jacobian::Zero();
    for (int i = 0; i <= last; ++i) turns.col(i) = R[i].col(2);
    return turns;
  }
};

Eigen::Matrix<double, 7, 7> MassMatrix(const Chain& chain) {
  Eigen::Matrix<double, 7, 7> M = Eigen::Matrix<double, 7, 7>::Zero();
  const auto add = [&](int link, const Eigen::Vector3d& centre, double mass,
                       const Eigen::Matrix3d& inertia) {
    const Jacobian moves = chain.Moves(centre, link), turns = chain.Turns(link);
    M += mass * moves.transpose() * moves + turns.transpose() * inertia * turns;
  };
  for (int i = 0; i < 7; ++i) {
    const Link& link = kLinks[i];
    add(i, chain.p[i] + chain.R[i] * Vector(link.centre), link.mass,
        link.inertia * Eigen::Matrix3d::Identity());
    M(i, i) += link.armature;
  }
  const Eigen::Matrix3d hand =
      chain.R[6] * Eigen::AngleAxisd(-EIGEN_PI / 4, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  for (const Piece& piece : kHand) {
    add(6, chain.p[6] + piece.height * chain.R[6].col(2), piece.mass,
        hand * Vector(piece.inertia).asDiagonal() * hand.transpose());
  }
  return M;
}

Matrix6 CouplingOf(const Chain& chain) {
  Eigen::Matrix<double, 6, 7> J;
  J << chain.Moves(chain.Tool(), 6), chain.Turns(6);
  const Matrix6 A = J * MassMatrix(chain).llt().solve(J.transpose());
  Matrix6 C = Matrix6::Identity();
  C.topRightCorner<3, 3>() = A.topRightCorner<3, 3>() * A.bottomRightCorner<3, 3>().inverse();
  C.bottomLeftCorner<3, 3>() = A.bottomLeftCorner<3, 3>() * A.topLeftCorner<3, 3>().inverse();
  return C;
}

// The tool's acceleration where no joint accelerates, frame by frame.
Vector6 DriftOf(const Chain& chain, const Eigen::VectorXd& dq) {
  Eigen::Vector3d turning = Eigen::Vector3d::Zero(), linear = turning, angular = turning;
  Eigen::Vector3d from = Eigen::Vector3d::Zero();
  for (int i = 0; i <= 7; ++i) {
    const Eigen::Vector3d to = i < 7 ? chain.p[i] : chain.Tool();
    const Eigen::Vector3d way = to - from;
    linear += angular.cross(way) + turning.cross(turning.cross(way));
    from = to;
    if (i == 7) break;
    const Eigen::Vector3d own = chain.R[i].col(2) * dq[i];
    angular += turning.cross(own);
    turning += own;
  }
  return (Vector6() << linear, angular).finished();
}

}  // namespace

PandaDynamics PandaDynamics::At(const Eigen::VectorXd& q, const Eigen::VectorXd& dq) {
  static const Matrix6 kHome = CouplingOf(
      Chain((Eigen::VectorXd(7) << 0, -0.161037389, 0, -2.44459747, 0, 2.2267522, EIGEN_PI / 4)
                .finished()));
  PandaDynamics at;
  at.coupling = kHome;
  if (q.size() != 7) return at;
  const Chain chain(q);
  const Matrix6 own = CouplingOf(chain);
  // Written so that what is not a number is none. A hundred metres a radian is nearly singular.
  if (!(own.array().abs() <= 100).all()) return at;
  at.coupling = own;
  if (dq.size() == 7 && (dq.array().abs() <= kMaxVelocity).all()) at.drift = DriftOf(chain, dq);
  return at;
}

}  // namespace robostress
