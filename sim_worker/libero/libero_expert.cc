#include "sim_worker/libero/libero_expert.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/rollout/expert_policy.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/panda_model.h"

namespace robostress::libero {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kFullCommandAt =
    0.035;  // [m] error at which the translation command reaches kMaxCommand
constexpr double kMaxCommand = 0.9;
constexpr double kMinCommand = 0.2;    // outside the tolerance: joint friction swallows less
constexpr double kTolerance = 0.004;   // [m]
constexpr double kRotationGain = 2.0;  // command per scaled rotation error
constexpr double kMaxRotation = 0.5;
constexpr double kOpen = -1, kClose = 1;
constexpr int kCloseSteps = 12;  // the fingers need 8 control steps for their stroke
constexpr int kOpenSteps = 8;

// The hand's orientation that points straight down with the fingers opening along the world's y
// axis.
const Quaterniond kDown(0, 1, 0, 0);

// What a skill wants of the tool in one control step.
struct ToolGoal {
  Vector3d p = Vector3d::Zero();  // of the grip site, world [m]
  Quaterniond q = kDown;          // of the hand body, world
  double gripper = kOpen;
};

// The true state, as a skill reads it.
class View {
 public:
  explicit View(const LiberoSimTask& task)
      : task_(const_cast<LiberoSimTask&>(task)),
        model_(task_.sim().model()),
        data_(std::as_const(task_.sim()).data()),
        panda_(PandaModel::Find(model_).value()) {}

  Vector3d Tool() const {
    return Eigen::Map<const Vector3d>(data_.site_xpos + 3 * panda_.grip_site);
  }
  Quaterniond Hand() const {
    const double* q = data_.xquat + 4 * panda_.hand_body;
    return Quaterniond(q[0], q[1], q[2], q[3]);
  }
  double Gap() const {
    return data_.qpos[panda_.finger_qpos[0]] - data_.qpos[panda_.finger_qpos[1]];
  }
  Vector3d Base() const { return Body(panda_.base_body); }
  Vector3d Body(int body) const { return Eigen::Map<const Vector3d>(data_.xpos + 3 * body); }
  Vector3d Site(int site) const { return Eigen::Map<const Vector3d>(data_.site_xpos + 3 * site); }
  Vector3d Geom(int geom) const { return Eigen::Map<const Vector3d>(data_.geom_xpos + 3 * geom); }
  double Joint(int joint) const { return data_.qpos[model_.jnt_qposadr[joint]]; }
  bool Near(const ToolGoal& goal, double tolerance, double angle = 0.15) const {
    return (goal.p - Tool()).norm() < tolerance && RotationBetween(Hand(), goal.q).norm() < angle;
  }
  const mjModel& model() const { return model_; }
  const mjData& data() const { return data_; }

 private:
  LiberoSimTask& task_;
  const mjModel& model_;
  const mjData& data_;
  PandaModel panda_;
};

// Proportional with a cap and, outside the tolerance, a floor.
Eigen::VectorXf CommandTowards(const ToolGoal& goal, const View& view) {
  const Vector3d error = goal.p - view.Tool();
  const double distance = error.norm();
  double size = std::min(kMaxCommand, distance / kFullCommandAt);
  size = distance > kTolerance ? std::max(size, kMinCommand) : kMinCommand * distance / kTolerance;
  const Vector3d rotation = RotationBetween(view.Hand(), goal.q) / 0.5 * kRotationGain;
  Eigen::VectorXf command(7);
  for (int i = 0; i < 3; ++i) {
    command[i] = static_cast<float>(distance > 1e-9 ? error[i] / distance * size : 0);
    command[3 + i] = static_cast<float>(std::clamp(rotation[i], -kMaxRotation, kMaxRotation));
  }
  command[6] = static_cast<float>(goal.gripper);
  return command;
}

class Skill {
 public:
  virtual ~Skill() = default;
  virtual void Start() = 0;
  virtual ToolGoal Decide(const View& view) = 0;
};

// How to hold a category: tool position at the grasp relative to the object's origin, world axes.
struct GraspSpec {
  std::string_view category;
  Vector3d offset;  // [m]
  double width;     // [m] between the pads when held; less means empty
};

// Picks up an object from above and puts it on or into the place of the goal.
class PickAndPlace : public Skill {
 public:
  // `place`: where the object's origin shall end, from the state.
  PickAndPlace(int body, const GraspSpec& grasp, std::function<Vector3d(const View&)> place)
      : body_(body), grasp_(grasp), place_(std::move(place)) {}

  void Start() override {
    side_ = 0;
    Enter(Phase::kReach);
  }

  ToolGoal Decide(const View& view) override {
    ++steps_;
    const Vector3d object = view.Body(body_);
    const Vector3d tool = view.Tool();
    const Vector3d place = place_(view);
    if (side_ == 0) side_ = CloserSide(view.Base(), object, place);
    const Vector3d grasp = object + Offset(side_);
    double beside = 0;  // horizontal distance to where the phase leads
    ToolGoal goal;
    goal.p = grasp;
    switch (phase_) {
      case Phase::kReach:
        beside = (grasp - tool).head<2>().norm();
        goal.p.z() += kClearance;
        if (beside < 0.008 && std::abs(goal.p.z() - tool.z()) < 0.03) Enter(Phase::kDescend);
        return goal;
      case Phase::kDescend:
        if (view.Near(goal, 0.007) || steps_ > 60) Enter(Phase::kGrasp);
        return goal;
      case Phase::kGrasp:
        goal.gripper = kClose;
        if (steps_ >= kCloseSteps) {
          held_ = tool - object;
          start_z_ = object.z();
          Enter(Phase::kLift);
        }
        return goal;
      case Phase::kLift:
        goal.gripper = kClose;
        goal.p =
            Vector3d(tool.x(), tool.y(), std::max(start_z_, place.z()) + kCarryHeight + held_.z());
        if (goal.p.z() - tool.z() < 0.02) {
          if (Lost(object, tool)) {
            Retry();
          } else {
            Enter(Phase::kCarry);
          }
        }
        if (steps_ > 60) Retry();
        return goal;
      case Phase::kCarry:
        // Lower the closer it is: high and far away lies beyond the arm's reach.
        goal.gripper = kClose;
        beside = (place - object).head<2>().norm();
        goal.p = place + (tool - object);
        goal.p.z() += std::clamp(0.03 + 0.7 * beside, 0.0, kCarryHeight);
        if (Lost(object, tool)) {
          Retry();
        } else if (beside < 0.01) {
          Enter(Phase::kLower);
        }
        return goal;
      case Phase::kLower:
        goal.gripper = kClose;
        goal.p = place + (tool - object);
        if (Lost(object, tool)) {
          Retry();
        } else if (object.z() - place.z() < 0.006 || steps_ > 40) {
          Enter(Phase::kRelease);
        }
        return goal;
      case Phase::kRelease:
        goal.p = tool;
        if (steps_ >= kOpenSteps) Enter(Phase::kRetreat);
        return goal;
      case Phase::kRetreat:
        goal.p = Vector3d(tool.x(), tool.y(), grasp.z() + kClearance);
        if (steps_ > 40) Retry();  // the goal still does not hold: try again
        return goal;
    }
    return goal;
  }

 private:
  enum class Phase { kReach, kDescend, kGrasp, kLift, kCarry, kLower, kRelease, kRetreat };
  static constexpr double kClearance = 0.10;    // [m] of the tool above the grasp
  static constexpr double kCarryHeight = 0.06;  // [m] of a carried object above its place

  void Enter(Phase phase) {
    phase_ = phase;
    steps_ = 0;
  }
  Vector3d Offset(double side) const { return grasp_.offset.cwiseProduct(Vector3d(1, side, 1)); }
  // The side at which the tool stays closer to the base: the far end of the table is at the arm's
  // reach.
  double CloserSide(const Vector3d& base, const Vector3d& object, const Vector3d& place) const {
    auto reach = [&](double side) {
      return std::max((object + Offset(side) - base).head<2>().norm(),
                      (place + Offset(side) - base).head<2>().norm());
    };
    return reach(-1) < reach(1) ? -1 : 1;
  }
  // From the start, at the other side of the object: the first one may be blocked.
  void Retry() {
    side_ = -side_;
    Enter(Phase::kReach);
  }
  // The object does not move with the tool any more.
  bool Lost(const Vector3d& object, const Vector3d& tool) const {
    return (tool - object - held_).norm() > 0.04;
  }

  const int body_;
  const GraspSpec grasp_;
  const std::function<Vector3d(const View&)> place_;
  Phase phase_ = Phase::kReach;
  int steps_ = 0;    // in this phase
  double side_ = 0;  // +-1: of the object along y, where it is held; 0: not chosen yet
  Vector3d held_ = Vector3d::Zero();
  double start_z_ = 0;
};

// Takes a drawer's handle bar from the front, the hand tilted so that it clears the handle above
// and the table below, and pulls along the drawer's axis.
class PullDrawer : public Skill {
 public:
  PullDrawer(int joint, int handle_geom) : joint_(joint), handle_(handle_geom) {}

  void Start() override { Enter(Phase::kReach); }

  ToolGoal Decide(const View& view) override {
    ++steps_;
    // The direction in which the drawer opens: its joint's axis towards negative coordinates.
    const Vector3d out = -Eigen::Map<const Vector3d>(view.data().xaxis + 3 * joint_).normalized();
    const Vector3d bar = view.Geom(handle_);
    // From straight down, turned by kTilt so that the fingers point against `out`.
    const Vector3d axis = Vector3d::UnitZ().cross(out).normalized();
    ToolGoal goal;
    goal.q = Quaterniond(Eigen::AngleAxisd(kTilt, axis)) * kDown;
    const Vector3d fingers = goal.q * Vector3d::UnitZ();
    switch (phase_) {
      case Phase::kReach:
        goal.p = bar - kStandOff * fingers;
        if (view.Near(goal, 0.012, 0.12)) Enter(Phase::kApproach);
        return goal;
      case Phase::kApproach:
        goal.p = bar;
        if (view.Near(goal, 0.008) || steps_ > 50) Enter(Phase::kGrasp);
        return goal;
      case Phase::kGrasp:
        goal.p = bar;
        goal.gripper = kClose;
        if (steps_ >= kCloseSteps) Enter(Phase::kPull);
        return goal;
      case Phase::kPull:
        goal.p = bar + kLead * out;
        goal.gripper = kClose;
        if ((view.Tool() - bar).norm() > 0.04 || steps_ > 150) Enter(Phase::kBackOff);
        return goal;
      case Phase::kBackOff:
        goal.p = bar - kStandOff * fingers;
        if (steps_ > 30) Enter(Phase::kReach);
        return goal;
    }
    return goal;
  }

 private:
  enum class Phase { kReach, kApproach, kGrasp, kPull, kBackOff };
  static constexpr double kTilt = 1.4;       // [rad]
  static constexpr double kStandOff = 0.08;  // [m]
  static constexpr double kLead = 0.05;      // [m] the tool's goal ahead of the handle

  void Enter(Phase phase) {
    phase_ = phase;
    steps_ = 0;
  }

  const int joint_, handle_;
  Phase phase_ = Phase::kReach;
  int steps_ = 0;
};

// Grasps that were tried on the stored initial states; a bowl is held by its rim.
const GraspSpec* FindGrasp(const std::string& category) {
  static const GraspSpec kGrasps[] = {
      {"akita_black_bowl", Vector3d(0, 0.049, 0.043), 0.001},
  };
  for (const GraspSpec& grasp : kGrasps) {
    if (grasp.category == category) return &grasp;
  }
  return nullptr;
}

// The bar of a cabinet's drawer: of the drawer's collision geoms the one that stands out furthest.
int FindHandle(const mjModel& model, int body) {
  int handle = -1;
  for (int geom = model.body_geomadr[body];
       geom < model.body_geomadr[body] + model.body_geomnum[body]; ++geom) {
    if (model.geom_group[geom] != 0) continue;
    // Drawers slide along the body's y axis and open towards -y.
    if (handle < 0 || model.geom_pos[3 * geom + 1] < model.geom_pos[3 * handle + 1]) handle = geom;
  }
  return handle;
}

std::unique_ptr<Skill> MakeSkill(const LiberoScene& scene, const BddlAtom& atom) {
  const auto object = scene.objects.find(atom.arguments[0]);
  if (atom.predicate == "open") {
    const auto site = scene.sites.find(atom.arguments[0]);
    if (site == scene.sites.end() || site->second.joints.size() != 1) return nullptr;
    const auto cabinet = scene.objects.find(site->second.parent);
    if (cabinet == scene.objects.end() || !absl::StrContains(cabinet->second.category, "cabinet"))
      return nullptr;
    const int joint = site->second.joints[0];
    return std::make_unique<PullDrawer>(joint,
                                        FindHandle(*scene.model, scene.model->jnt_bodyid[joint]));
  }
  if (atom.predicate != "on" || object == scene.objects.end()) return nullptr;
  const GraspSpec* grasp = FindGrasp(object->second.category);
  if (grasp == nullptr) return nullptr;
  const auto support = scene.objects.find(atom.arguments[1]);
  const auto site = scene.sites.find(atom.arguments[1]);
  if (support != scene.objects.end()) {
    const int body = support->second.body;
    return std::make_unique<PickAndPlace>(object->second.body, *grasp, [body](const View& view) {
      return Vector3d(view.Body(body) + Vector3d(0, 0, 0.004));
    });
  }
  if (site != scene.sites.end()) {
    const int id = site->second.site;
    return std::make_unique<PickAndPlace>(object->second.body, *grasp, [id](const View& view) {
      return Vector3d(view.Site(id) + Vector3d(0, 0, 0.004));
    });
  }
  return nullptr;
}

}  // namespace

absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeLiberoExpert(const LiberoSimTask& task) {
  const std::vector<BddlAtom>& goal = task.scene().problem.goal;
  std::unique_ptr<Skill> skill = goal.size() == 1 ? MakeSkill(task.scene(), goal[0]) : nullptr;
  if (skill == nullptr) {
    return absl::UnimplementedError(
        absl::StrCat("no scripted expert for '", task.instruction(),
                     "'; there is one for goals that put a bowl on something or open a "
                     "drawer of a cabinet. Use --policy replay or a policy server"));
  }
  const std::shared_ptr<Skill> shared = std::move(skill);
  shared->Start();
  const auto decide = [&task, shared]() -> Eigen::VectorXf {
    const View view(task);
    return CommandTowards(shared->Decide(view), view);
  };
  return std::make_unique<ExpertPolicy>(decide, [shared] { shared->Start(); });
}

}  // namespace robostress::libero
