#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/panda_model.h"

namespace robostress::libero {

// A box along the world's axes [m].
struct Extent {
  Eigen::Vector3d low, high;
  Eigen::Vector3d Centre() const { return (low + high) / 2; }
};

// The true state of a task, as its scripted expert reads it. Positions are of the world [m].
class ExpertView {
 public:
  // `task` must outlive it.
  explicit ExpertView(const LiberoSimTask& task);

  Eigen::Vector3d Tool() const;  // the grip site
  Eigen::Quaterniond Hand() const;
  double Yaw() const;  // of the hand about z against straight down, -pi/2 .. pi/2 [rad]
  double Gap() const;  // between the fingers [m]
  Eigen::Vector3d Base() const;
  Eigen::Vector3d Body(int body) const;
  Eigen::Quaterniond BodyQuat(int body) const;
  Eigen::Vector3d Site(int site) const;
  Eigen::Matrix3d SiteFrame(int site) const;
  Eigen::Vector3d Geom(int geom) const;
  double Joint(int joint) const;
  Eigen::Vector3d JointAxis(int joint) const;
  Eigen::Vector3d JointAnchor(int joint) const;
  // Both fingers touch the object with this root body.
  bool Holds(int body) const;
  // The finger that touches it, from the tool [m, horizontal]; zero if none or both do.
  Eigen::Vector3d TouchingFinger(int body) const;
  // It touches something that is no part of the robot.
  bool Stands(int body) const;

  // Collision geoms of a body and of all below it.
  std::vector<int> Geoms(int body) const;
  Extent ExtentOf(int geom) const;
  Extent ExtentOf(const std::vector<int>& geoms) const;
  // Half the geom's size along a direction [m].
  double Support(int geom, const Eigen::Vector3d& direction) const;
  // The top of whatever stands less than `radius` beside the way from `from` towards `to`, within
  // `ahead` of it [m]; collision geoms alone, without the robot's and those of `except`. Minus
  // infinity where nothing does.
  double TopAlong(const Eigen::Vector3d& from, const Eigen::Vector3d& to, double radius,
                  double ahead, int except) const;
  // Whether an upright box around `centre` with these half sizes would stand in something.
  bool Blocked(const Eigen::Vector3d& centre, const Eigen::Vector3d& half, int except) const;

  const LiberoSimTask& task() const { return task_; }
  const mjModel& model() const { return model_; }
  const mjData& data() const { return data_; }

 private:
  std::array<bool, 2> Touches(int body) const;
  bool IsObstacle(int geom, int except) const;
  // By separating axes: exact for boxes, whatever way they are turned.
  bool Overlaps(int geom, const Eigen::Vector3d& centre, const Eigen::Vector3d& half) const;

  const LiberoSimTask& task_;
  const mjModel& model_;
  const mjData& data_;
  PandaModel panda_;
  std::array<int, 2> fingers_;  // bodies
  std::vector<int> obstacles_;  // collision geoms but those of the robot, floors, tables
};

}  // namespace robostress::libero
