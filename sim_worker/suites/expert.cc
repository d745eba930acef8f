#include "sim_worker/suites/expert.h"

#include <algorithm>
#include <cmath>

#include "common/so3.h"
#include "sim_worker/suites/goals.h"

namespace robostress {
namespace {

using Eigen::Vector3d;

constexpr double kMaxCommand = 0.8;       // norm of the translation command
constexpr double kMinCommand = 0.25;      // ditto, outside the tolerance: below, friction eats it
constexpr double kTolerance = 0.004;      // [m]
constexpr double kFullCommandAt = 0.035;  // error at which the command would be 1 [m]
constexpr double kRotationGain = 2.0;     // command per scaled rotation error
constexpr double kMaxRotation = 0.4;
constexpr double kFunnelStart =
    0.012;  // horizontal error under which the tool comes all the way down [m]
constexpr double kFunnelSlope = 2.5;      // height over horizontal error
constexpr double kReachClearance = 0.06;  // over the target while the tool is beside it [m]
constexpr double kCarryClearance = 0.07;  // of a carried object's underside [m]
constexpr double kTooLow = 0.015;  // below the funnel by this much, sideways motion slows down [m]
constexpr double kOpenGap = 0.06;  // a gripper this wide counts as open [m]
constexpr double kGapMargin = 0.006;   // [m]
constexpr double kPushOffset = 0.108;  // tool behind the plate's centre before a push [m]
constexpr double kPushHeight = 0.018;  // [m]
constexpr double kOpenCommand = -1, kCloseCommand = 1;

Vector3d ShapeCommand(const Vector3d& error) {
  const double n = error.norm();
  if (n < 1e-9) return Vector3d::Zero();
  double size = std::min(kMaxCommand, n / kFullCommandAt);
  size = n > kTolerance ? std::max(size, kMinCommand) : kMinCommand * n / kTolerance;
  return error / n * size;
}

// The state that one decision reads, and the ways to build it.
class Decider {
 public:
  Decider(const TaskModel& model, const PandaSim& sim)
      : model_(model),
        sim_(sim),
        data_(sim.data()),
        state_(sim.Measure()),
        tool_(state_.tool.p_base_tool),
        gap_(state_.gripper) {
    decision_.target = decision_.destination = tool_;
  }

  ExpertDecision Decide() {
    const auto& goals = model_.task().goals;
    const int open_goal = FirstOpenGoal(model_, sim_);
    const int n = static_cast<int>(goals.size());
    if (open_goal == n) {
      Command(Vector3d::Zero(), kOpenCommand);
      decision_.progress = 1;
      return decision_;
    }
    const Goal& goal = goals[open_goal];
    switch (goal.kind) {
      case GoalKind::kPlace:
        Place(goal);
        break;
      case GoalKind::kOpen:
        PullDrawer(goal);
        break;
      case GoalKind::kTurnOn:
        TurnKnob(goal);
        break;
      case GoalKind::kPush:
        Push(goal);
        break;
    }
    decision_.progress = (open_goal + std::clamp(phase_, 0.0, 0.99)) / n;
    return decision_;
  }

 private:
  // Sends a translation [normalised]; the rotation always returns the tool to straight down.
  void Command(const Vector3d& translation, double gripper) {
    static const Eigen::Quaterniond kDown(0, 1, 0, 0);  // diag(1, -1, -1)
    const Vector3d rotation = RotationBetween(state_.tool.q_base_tool, kDown) / 0.5 * kRotationGain;
    decision_.command.resize(7);
    for (int i = 0; i < 3; ++i) {
      decision_.command[i] = static_cast<float>(translation[i]);
      decision_.command[3 + i] =
          static_cast<float>(std::clamp(rotation[i], -kMaxRotation, kMaxRotation));
    }
    decision_.command[6] = static_cast<float>(gripper);
  }

  // Goes to a point from above: the lower it is, the less it may be beside it. `from` is what shall
  // arrive.
  void Funnel(const Vector3d& from, const Vector3d& to, double clearance, double lift,
              double gripper) {
    Vector3d error = to - from;
    const double beside = error.head<2>().norm();
    error.z() += lift + std::min(clearance, std::max(0.0, beside - kFunnelStart) * kFunnelSlope);
    const double sideways = std::clamp(1 - (error.z() - kTooLow) / 0.03, 0.0, 1.0);
    error.head<2>() *= sideways;
    Command(ShapeCommand(error), gripper);
  }

  bool Near(const Vector3d& target, double x, double y, double z) const {
    const Vector3d e = (target - tool_).cwiseAbs();
    return e.x() < x && e.y() < y && e.z() < z;
  }

  // Opens, comes down around `target` and closes. The caller handles a closed gripper that holds
  // something.
  void Grasp(const Vector3d& target, double width) {
    const bool closing = gap_ < kOpenGap;
    const bool empty = gap_ < width - kGapMargin;
    const double slack = closing ? 1.7 : 1.0;
    if (!empty && Near(target, 0.012 * slack, 0.010 * slack, 0.012 * slack)) {
      Command(ShapeCommand(target - tool_), kCloseCommand);
      phase_ = 0.45;
      return;
    }
    Funnel(tool_, target, kReachClearance, closing ? kReachClearance : 0, kOpenCommand);
    phase_ = 0.4 * std::exp(-(target - tool_).norm() / 0.15);
  }

  void Place(const Goal& goal) {
    const Vector3d object = model_.Position(data_, goal.object);
    const ShapeInfo& shape = ShapeOf(model_.FindProp(goal.object).kind);
    const Region& region = model_.RegionOf(goal);
    Vector3d destination = model_.RegionCenter(data_, goal);
    destination.head<2>() += goal.offset;
    decision_.target = object;
    decision_.destination = destination;
    const Vector3d offset = object - destination;
    const double beside = offset.head<2>().norm();
    decision_.holding =
        sim_.held_body() == model_.BodyId(goal.object) && gap_ < shape.grasp_width + kGapMargin;
    if (decision_.holding) {
      const bool arrived = beside < 0.016 && offset.z() < region.release_height + 0.012;
      const Vector3d to = destination + Vector3d(0, 0, region.release_height);
      const double clearance = std::max(kCarryClearance, 0.09 - destination.z());
      Funnel(object, to, clearance, 0, arrived ? kOpenCommand : kCloseCommand);
      phase_ = 0.5 + 0.45 * std::exp(-beside / 0.15);
      return;
    }
    if (beside < 0.03 && offset.z() > -0.01 && offset.z() < region.release_height + 0.03) {
      Command(Vector3d::Zero(), kOpenCommand);  // let go, still falling or still touched
      phase_ = 0.97;
      return;
    }
    Vector3d grasp = object;
    grasp.z() += shape.grasp_z;
    Grasp(grasp, shape.grasp_width);
  }

  // Holds the handle and leads it in `direction`; true once it is held.
  void Lead(const Vector3d& handle, const Handle& shape, const Vector3d& direction,
            double fraction) {
    decision_.target = handle;
    decision_.destination = handle + direction;
    decision_.holding = gap_ < shape.width + kGapMargin && gap_ > shape.width - 0.01 &&
                        Near(handle, 0.02, 0.025, 0.03);
    if (!decision_.holding) {
      Grasp(handle, shape.width);
      return;
    }
    Command(ShapeCommand(handle + direction - tool_), kCloseCommand);
    phase_ = 0.5 + 0.5 * fraction;
  }

  void PullDrawer(const Goal& goal) {
    const Handle& shape = DrawerHandle();
    const double q = model_.JointPosition(data_, goal.object + shape.joint_suffix);
    Lead(model_.HandleCenter(data_, goal.object, shape), shape, Vector3d(0, -0.03, 0),
         q / shape.done);
  }

  void TurnKnob(const Goal& goal) {
    const Handle& shape = KnobHandle();
    const double q = model_.JointPosition(data_, goal.object + shape.joint_suffix);
    const Vector3d handle = model_.HandleCenter(data_, goal.object, shape);
    const Vector3d arm = handle - model_.Position(data_, goal.object + shape.body_suffix);
    const Vector3d tangent = Vector3d(arm.y(), -arm.x(), 0).normalized();
    Lead(handle, shape, 0.025 * tangent, q / shape.done);
  }

  // Closed fingers behind the plate, then towards the destination along -y.
  void Push(const Goal& goal) {
    const Vector3d plate = model_.Position(data_, goal.object);
    const Vector3d destination = model_.RegionCenter(data_, goal);
    decision_.target = plate;
    decision_.destination = destination;
    const Vector3d start = plate + Vector3d(0, kPushOffset, kPushHeight);
    const Vector3d rel = tool_ - start;
    const bool behind =
        std::abs(rel.x()) < 0.02 && rel.y() > -0.06 && rel.y() < 0.015 && rel.z() < 0.012;
    const double left = std::abs(plate.y() - destination.y());
    if (behind && gap_ < 0.02) {
      Command(ShapeCommand(Vector3d(-rel.x(), -0.025, -rel.z())), kCloseCommand);
      phase_ = 0.5 + 0.45 * std::exp(-left / 0.1);
      return;
    }
    Funnel(tool_, start, kReachClearance, 0, kCloseCommand);
    phase_ = 0.4 * std::exp(-rel.norm() / 0.15);
  }

  const TaskModel& model_;
  const PandaSim& sim_;
  const mjData& data_;
  RobotState state_;
  Vector3d tool_;
  double gap_;
  double phase_ = 0;  // of the current goal, 0 .. 1
  ExpertDecision decision_;
};

}  // namespace

ExpertDecision DecideExpert(const TaskModel& model, const PandaSim& sim) {
  return Decider(model, sim).Decide();
}

}  // namespace robostress
