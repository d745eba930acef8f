#include "sim_worker/suites/goals.h"

#include <cmath>

namespace robostress {
namespace {

constexpr double kRestTolerance = 0.012;  // of the underside above the surface [m]
constexpr double kUpright = 0.9;          // cosine of the largest tilt

bool InRegion(const Region& region, const Eigen::Vector3d& offset) {
  return std::abs(offset.x()) < region.half.x() && std::abs(offset.y()) < region.half.y();
}

}  // namespace

bool GoalHolds(const TaskModel& model, const PandaSim& sim, const Goal& goal) {
  const mjData& data = sim.data();
  switch (goal.kind) {
    case GoalKind::kPlace: {
      const Eigen::Vector3d offset =
          model.Position(data, goal.object) - model.RegionCenter(data, goal);
      return InRegion(model.RegionOf(goal), offset) && std::abs(offset.z()) < kRestTolerance &&
             model.Upright(data, goal.object) > kUpright &&
             sim.held_body() != model.BodyId(goal.object);
    }
    case GoalKind::kOpen:
      return model.JointPosition(data, goal.object + DrawerHandle().joint_suffix) >
             DrawerHandle().done;
    case GoalKind::kTurnOn:
      return model.JointPosition(data, goal.object + KnobHandle().joint_suffix) > KnobHandle().done;
    case GoalKind::kPush:
      return InRegion(model.RegionOf(goal),
                      model.Position(data, goal.object) - model.RegionCenter(data, goal));
  }
  return false;
}

int FirstOpenGoal(const TaskModel& model, const PandaSim& sim) {
  const auto& goals = model.task().goals;
  int i = 0;
  while (i < static_cast<int>(goals.size()) && GoalHolds(model, sim, goals[i])) ++i;
  return i;
}

bool TaskSucceeds(const TaskModel& model, const PandaSim& sim) {
  return FirstOpenGoal(model, sim) == static_cast<int>(model.task().goals.size());
}

}  // namespace robostress
