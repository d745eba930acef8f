#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>

#include "absl/types/span.h"
#include "common/joint_errors/effects/joint_effect.h"

// Friction law `stick`: dry friction of coupled joints, set-valued at rest.
namespace robostress {

// The dry torques f [Nm], -forward_j <= f_j <= backward_j (both >= 0), that bring the velocities
// after the sub-step to rest where they can: v = v_free + A f, with f_j at the limit against v_j
// where v_j stays non-zero. v_free [n]: velocity after the sub-step without dry friction [rad/s]; A
// [n x n, row-major, symmetric positive definite]: velocity per torque, h M^-1. Projected
// Gauss-Seidel from zero, at most kStickSweeps sweeps. Allocates nothing.
inline constexpr int kStickSweeps = 50;
void StickTorques(absl::Span<const double> v_free, absl::Span<const double> A,
                  absl::Span<const double> forward, absl::Span<const double> backward,
                  absl::Span<double> f);

// What dry friction and the joints' added inertia leave of `torque` [Nm] over a sub-step of h [s].
// M [n x n]: mass matrix of the joints [kg m^2]. net [Nm]: `torque` with all others that act on the
// joints. dq [rad/s]: at the start. inertia, dry: what the joints of a chain gain. rest [Nm]: dry
// friction of every joint beside. Added inertia becomes the torque that accelerates it. n is that
// of the types, and fixed sizes allocate nothing; Inverse: in which M^-1 is solved for, whose order
// decides the last bit.
template <class Inverse, class Mass, class Vector>
Vector WithDryFriction(Mass M, const Vector& torque, const Vector& net, const Vector& dq,
                       absl::Span<const double> inertia, absl::Span<const DryFriction> dry,
                       double rest, double h) {
  using RowMajor =
      Eigen::Matrix<double, Mass::RowsAtCompileTime, Mass::ColsAtCompileTime, Eigen::RowMajor>;
  const Eigen::Index n = torque.size();
  const Eigen::Map<const Vector> added(inertia.data(), n);
  M.diagonal() += added;
  const Inverse M_inverse = Eigen::LLT<Mass>(M).solve(Mass::Identity(n, n));
  const RowMajor velocity_per_torque = h * M_inverse;
  const Vector v_free = dq + velocity_per_torque * net;
  Vector forward = torque, backward = torque, friction = torque;  // of that size
  for (Eigen::Index i = 0; i < n; ++i) {
    forward[i] = std::max(0.0, dry[i].forward) + rest;
    backward[i] = std::max(0.0, dry[i].backward) + rest;
  }
  const auto size = static_cast<size_t>(n);
  StickTorques({v_free.data(), size}, {velocity_per_torque.data(), size * size},
               {forward.data(), size}, {backward.data(), size}, {friction.data(), size});
  const Vector acceleration = M_inverse * (net + friction);
  return torque + (friction - added.cwiseProduct(acceleration));
}

// One joint alone, exactly: its velocity after a time under a constant torque and dry friction,
// which turns with the motion, and the way gone. Where StickTorques holds a joint for the rest of a
// sub-step, this goes on after the stop. per_torque [1 / (kg m^2)].
struct DryStroke {
  double dq = 0, way = 0;  // [rad/s], [rad]
};

inline DryStroke AdvanceDry(double dq, double torque, const DryFriction& dry, double per_torque,
                            double time) {
  const double forward = std::max(0.0, dry.forward), backward = std::max(0.0, dry.backward);
  double way = 0;
  if (dq != 0) {
    const double a = per_torque * (dq > 0 ? torque - forward : torque + backward);
    const double next = dq + a * time;
    if (next * dq >= 0) return {next, 0.5 * time * (dq + next)};
    way = -0.5 * dq * dq / a;
    time += dq / a;  // what is left after the stop
  }
  const double free = torque > forward ? torque - forward : std::min(0.0, torque + backward);
  return {per_torque * free * time, way + 0.5 * per_torque * free * time * time};
}

}  // namespace robostress
