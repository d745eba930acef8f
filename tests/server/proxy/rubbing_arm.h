#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

namespace robostress {

// An arm of the test's own: a mass of 1 on each axis under the controller kp (goal - x) - kd v,
// goal = x + command, with Coulomb friction against motion and against its begin.
class RubbingArm {
 public:
  explicit RubbingArm(double friction) : friction_(friction) {}
  void Step(const Eigen::Vector3d& command) {
    const Eigen::Vector3d goal = x_ + command.cwiseMax(-1).cwiseMin(1);
    constexpr double kStep = 0.05 / 250, kKp = 150;
    const double kd = 2 * std::sqrt(kKp);
    for (int i = 0; i < 250; ++i) {
      for (int j = 0; j < 3; ++j) {
        const double push = kKp * (goal[j] - x_[j]) - kd * v_[j];
        if (v_[j] == 0 && std::abs(push) <= friction_) continue;
        const double against =
            v_[j] != 0 ? std::copysign(friction_, v_[j]) : std::copysign(friction_, push);
        const double next = v_[j] + kStep * (push - against);
        v_[j] = next * v_[j] < 0 ? 0 : next;
        x_[j] += kStep * v_[j];
      }
    }
  }
  // LIBERO's state of 8 numbers.
  std::vector<double> state() const {
    return {0.05 * x_[0], 0.05 * x_[1], 0.05 * x_[2], 0, 0, 0, 0.02, -0.02};
  }
  const Eigen::Vector3d& x() const { return x_; }  // [command units]
  void Place(const Eigen::Vector3d& x) {
    x_ = x;
    v_.setZero();
  }

 private:
  const double friction_;
  Eigen::Vector3d x_ = Eigen::Vector3d::Zero(), v_ = Eigen::Vector3d::Zero();
};

}  // namespace robostress
