#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace robostress {

// How the joints of an arm that takes position targets answer them; one value each, or one for all.
struct JointResponseOptions {
  std::vector<double> delay_s;    // d, from a target to the motion that it makes [s]; empty: none
  std::vector<double> stiffness;  // k [1/s^2]
  std::vector<double> damping;    // b [1/s]
  std::vector<double> drag;       // c [1/rad]

  bool on() const { return !delay_s.empty(); }
  // INVALID_ARGUMENT names key, value and range.
  absl::Status Check(int joints) const;

  template <class V>
  void Visit(V& v) {
    v.Field("delay_s", delay_s, "from a target to the motion that it makes [s]; empty: no model");
    v.Field("stiffness", stiffness, "acceleration per distance to the target [1/s^2]");
    v.Field("damping", damping, "deceleration per speed [1/s]");
    v.Field("drag", drag, "deceleration per squared speed [1/rad]");
  }
};

// The motion that the targets sent to a healthy arm make, joint by joint:
//
//   v' = k (u(t - d) - q) - b v - c |v| v,   q' = v
//
// symbol  name       unit
// u       target     rad
// q, v    joint      rad, rad/s
//
// Drag is what a planner does that brakes at a constant rate: in steady motion the joint is behind
// by d v + (b v + c v^2) / k, and braking from v takes v^2 / 2a. Steps of at most 1 ms,
// semi-implicit Euler, drag implicit. Identified by `robostress identify --run`.
//
// Runs in the control loop: allocates nothing. One thread.
class JointResponse {
 public:
  static constexpr int kMaxJoints = 8;
  static constexpr double kMaxDelay_s = 0.3;
  using Joints = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;  // [rad]

  // Options that hold for kMaxJoints or the number of joints that it is given.
  explicit JointResponse(const JointResponseOptions& options) : options_(options) {}

  // At rest at `q`, where it was sent.
  void Reset(const Joints& q);
  void Clear() { q_.resize(0); }  // as before the first Reset
  // `target` held for `dt_s`.
  void Advance(const Joints& target, double dt_s);
  const Joints& position() const { return q_; }  // empty before Reset

 private:
  // Two seconds of a loop at 30 Hz; what is older than the longest delay is not needed.
  static constexpr int kHistory = 64;
  struct Sent {
    double begin_s = 0;
    Joints target;
  };
  static double Of(const std::vector<double>& values, Eigen::Index joint) {
    return values.size() == 1 ? values[0] : values[static_cast<size_t>(joint)];
  }

  JointResponseOptions options_;
  Joints q_, v_;
  double now_s_ = 0;
  std::array<Sent, kHistory> sent_;
  int newest_ = 0, count_ = 0;
};

}  // namespace robostress
