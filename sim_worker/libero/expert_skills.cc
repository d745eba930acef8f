#include "sim_worker/libero/expert_skills.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "common/so3.h"
#include "sim_worker/libero/expert_grasp.h"

namespace robostress::libero {

using Eigen::Quaterniond;
using Eigen::Vector3d;

namespace {

constexpr double kOpen = -1, kClose = 1;
constexpr double kFunnelStart = 0.015;   // [m] beside the target from which the way leads down
constexpr double kFunnelSlope = 3.0;     // height over distance
constexpr double kClearance = 0.06;      // [m] over a target while beside it
constexpr double kMargin = 0.025;        // [m] over what stands in the way
constexpr double kFingerRadius = 0.045;  // [m] of the open hand around the tool
constexpr double kAhead = 0.12;          // [m] of the way that must be free
constexpr double kTooLow = 0.01;         // [m] below the way: sideways motion slows down
constexpr double kOpenGap = 0.07;        // [m]

Quaterniond Turned(double yaw) {
  return Quaterniond(Eigen::AngleAxisd(yaw, Vector3d::UnitZ())) * Quaterniond(0, 1, 0, 0);
}

// Where to go from `from` so that `to` is reached from above and nothing in between is hit. Both
// belong to the tool or to what it carries; the result is what to add.
Vector3d Funnel(const ExpertView& view, const Vector3d& from, const Vector3d& to, double radius,
                int except, double near = kFunnelStart) {
  Vector3d error = to - from;
  const double beside = error.head<2>().norm();
  if (beside > near) {
    double height = to.z() + std::min(kClearance, (beside - near) * kFunnelSlope);
    if (beside > (near < kFunnelStart ? near : 0.03))
      height = std::max(height, view.TopAlong(from, to, radius, kAhead, except) + kMargin);
    error.z() = height - from.z();
  }
  error.head<2>() *= std::clamp(1 - (error.z() - kTooLow) / 0.02, 0.0, 1.0);
  return error;
}

class PickAndPlace : public ExpertSkill {
 public:
  PickAndPlace(const LiberoObject& object, std::function<Place(const ExpertView&)> place)
      : object_(object), place_(std::move(place)) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Place place = place_(view);
    const Vector3d origin = view.Body(object_.body), tool = view.Tool();
    const bool held = view.Holds(object_.body);
    const double beside = (origin - place.p).head<2>().norm();
    const double over = origin.z() - place.p.z();
    const double enough = place.over + (view.Stands(object_.body) ? 0.04 : 0.012);
    const bool near = (tool - origin).head<2>().norm() < 0.1 && !Away(view, tool);
    const bool there = beside < place.beside && over < enough && over > -0.03;
    // Let go: falling, leaning on a finger or lying there already.
    const bool gone = beside < place.beside + 0.02 && over < enough + 0.06 && over > -0.03;
    if (near && (held ? there : gone)) {
      const bool open = view.Gap() > kOpenGap;
      const Vector3d stuck = open ? view.TouchingFinger(object_.body) : Vector3d::Zero();
      Vector3d away(0, 0, open ? 0.04 : 0);
      if (stuck.norm() > 1e-6) away = 0.03 * stuck.normalized();  // it leans on this finger
      return {tool + away, DownTurned(view, view.Yaw()), kOpen};
    }
    return held ? Carry(view, place, origin) : Reach(view, place);
  }
  Aim Look(const ExpertView& view) const override {
    return {view.Body(object_.body), place_(view).p, view.Holds(object_.body)};
  }

 private:
  // The fingers stand over the object already.
  bool Away(const ExpertView& view, const Vector3d& tool) const {
    return tool.z() > view.ExtentOf(view.Geoms(object_.body)).high.z() + 0.05;
  }

  ToolGoal Carry(const ExpertView& view, const Place& place, const Vector3d& origin) const {
    if (place.way.has_value()) return CarryIn(view, place, origin);
    const Extent extent = view.ExtentOf(view.Geoms(object_.body));
    // What must pass: its underside, above its own origin's way.
    Vector3d from(origin.x(), origin.y(), extent.low.z());
    Vector3d to = place.p;
    to.z() += extent.low.z() - origin.z() + place.over;
    const Vector3d size = extent.high - extent.low;
    const double radius = std::max(size.x(), size.y()) / 2 + 0.015;
    const Vector3d move = Funnel(view, from, to, radius, object_.body, place.beside);
    return {view.Tool() + move, DownTurned(view, place.turn.value_or(view.Yaw())), kClose};
  }

  // To the beginning of the way from above, then along it.
  ToolGoal CarryIn(const ExpertView& view, const Place& place, const Vector3d& origin) const {
    const Vector3d along = place.way->normalized(), to_go = place.p - origin;
    const double left = to_go.dot(along);
    const Vector3d aside = to_go - left * along;
    ToolGoal goal{view.Tool(), DownTurned(view, view.Yaw()), kClose};
    const bool in_line = aside.head<2>().norm() < 0.012 && std::abs(aside.z()) < 0.012;
    if (in_line && left < place.way->norm() + 0.03) {
      goal.p += aside + std::min(left, 0.04) * along;
    } else {
      goal.p += Funnel(view, origin, place.p - *place.way, 0.08, object_.body);
    }
    return goal;
  }

  ToolGoal Reach(const ExpertView& view, const Place& place) const {
    const std::optional<Grasp> handle =
        place.way.has_value() ? HandleGrasp(view, object_) : std::nullopt;
    const Grasp grasp = handle.has_value()
                            ? *handle
                            : FindGrasp(view, object_, place.p + Vector3d(0, 0, place.over));
    const Vector3d tool = view.Tool();
    const Vector3d error = grasp.p - tool;
    const bool closing = view.Gap() < kOpenGap;
    const double slack = closing ? 1.8 : 1.0;
    const bool turned = std::abs(std::remainder(view.Yaw() - grasp.yaw, M_PI)) < 0.15 * slack;
    if (error.head<2>().norm() < 0.008 * slack && std::abs(error.z()) < 0.008 * slack && turned) {
      if (view.Gap() > 0.5 * grasp.width - 0.002)
        return {grasp.p, DownTurned(view, grasp.yaw), kClose};
      return {tool + Vector3d(0, 0, 0.04), DownTurned(view, grasp.yaw), kOpen};  // missed it
    }
    if (closing) return {tool, view.Hand(), kOpen};  // whatever they hold, before they move
    Vector3d move = Funnel(view, tool, grasp.p, kFingerRadius, object_.body);
    if (!turned && error.head<2>().norm() < kClearance && tool.z() < grasp.p.z() + kClearance)
      move = Vector3d(0, 0, error.z() + kClearance);
    return {tool + move, DownTurned(view, grasp.yaw), kOpen};
  }

  const LiberoObject& object_;
  const std::function<Place(const ExpertView&)> place_;
};

// A drawer's bar, and where it is at the lower (0) or upper (1) end of the drawer's travel.
Aim LookAtBar(const ExpertView& view, int joint, int bar, int end) {
  const double left = view.model().jnt_range[2 * joint + end] - view.Joint(joint);
  return {view.Geom(bar), view.Geom(bar) + left * view.JointAxis(joint)};
}

// A drawer at its bar, the hand lying almost flat against the front.
class PullDrawer : public ExpertSkill {
 public:
  PullDrawer(const mjModel& model, int joint) : joint_(joint), bar_(DrawerBar(model, joint)) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Vector3d out = -view.JointAxis(joint_), bar = view.Geom(bar_), tool = view.Tool();
    const Vector3d axis = Vector3d::UnitZ().cross(out).normalized();
    ToolGoal goal;
    goal.q = Quaterniond(Eigen::AngleAxisd(kTilt, axis)) * Turned(0);
    const Vector3d fingers = goal.q * Vector3d::UnitZ();
    const Vector3d error = bar - tool;
    const double before = error.dot(fingers);  // of the tool, along the fingers
    const double aside = (error - before * fingers).norm();
    const bool turned = RotationBetween(view.Hand(), goal.q).norm() < 0.2;
    if (turned && aside < 0.02 && std::abs(before) < 0.015) {
      const bool closed = view.Gap() < 0.035;
      goal.gripper = kClose;
      goal.p = closed ? Vector3d(bar + kLead * out) : bar;
      return goal;
    }
    if (turned && aside < 0.012 && before < kStandOff + 0.02 && view.Gap() > kOpenGap) {
      goal.p = bar;
      return goal;
    }
    goal.p = bar - kStandOff * fingers;
    // Around the drawer's front, not through it.
    if (before < kStandOff - 0.02 && aside > 0.03) goal.p = tool + 0.06 * out;
    return goal;
  }
  Aim Look(const ExpertView& view) const override { return LookAtBar(view, joint_, bar_, 0); }

 private:
  static constexpr double kTilt = 1.4;       // [rad]
  static constexpr double kStandOff = 0.08;  // [m]
  static constexpr double kLead = 0.05;      // [m] the tool's goal ahead of the bar

  const int joint_, bar_;
};

// Pushes a drawer's bar with closed fingers, the hand leaning back from the bars above.
class ShutDrawer : public ExpertSkill {
 public:
  ShutDrawer(const mjModel& model, int joint) : joint_(joint), bar_(DrawerBar(model, joint)) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Vector3d out = -view.JointAxis(joint_), bar = view.Geom(bar_), tool = view.Tool();
    ToolGoal goal;
    goal.q = Quaterniond(Eigen::AngleAxisd(kTilt, Vector3d::UnitZ().cross(out).normalized())) *
             Turned(0);
    goal.gripper = kClose;
    const Vector3d error = bar - tool;
    const double before = -error.dot(out);
    const double beside = std::abs(error.dot(Vector3d::UnitZ().cross(out)));
    if (before > -0.01 && before < kStandOff + 0.03 && beside < 0.03 &&
        std::abs(error.z()) < 0.02) {
      goal.p = bar - kLead * out;
      return goal;
    }
    goal.p = tool + Funnel(view, tool, bar + kStandOff * out, 0.04, -1);
    return goal;
  }
  Aim Look(const ExpertView& view) const override { return LookAtBar(view, joint_, bar_, 1); }

 private:
  static constexpr double kTilt = 0.85;      // [rad]
  static constexpr double kStandOff = 0.06;  // [m]
  static constexpr double kLead = 0.06;      // [m] the tool's goal behind the bar

  const int joint_, bar_;
};

class TurnKnob : public ExpertSkill {
 public:
  TurnKnob(const mjModel& model, int joint, bool on)
      : body_(model.jnt_bodyid[joint]), lead_(on ? kLead : -kLead) {}

  ToolGoal Decide(const ExpertView& view) const override {
    // The ridge lies along the body's y axis; it is held across.
    const Eigen::Quaterniond knob = view.BodyQuat(body_);
    const Vector3d along = knob * Vector3d::UnitY();
    const double yaw = std::remainder(std::atan2(along.y(), along.x()), M_PI);
    const Vector3d grasp = Ridge(view);
    const Vector3d tool = view.Tool(), error = grasp - tool;
    const bool at = error.head<2>().norm() < 0.012 && std::abs(error.z()) < 0.012;
    const bool closed = view.Gap() < 0.035;
    if (at && (closed || std::abs(std::remainder(view.Yaw() - yaw, M_PI)) < 0.15))
      return {grasp, DownTurned(view, yaw + (closed ? lead_ : 0)), kClose};
    return {tool + Funnel(view, tool, grasp, kFingerRadius, -1), DownTurned(view, yaw), kOpen};
  }
  Aim Look(const ExpertView& view) const override { return {Ridge(view), Ridge(view)}; }

 private:
  Vector3d Ridge(const ExpertView& view) const {
    return view.Body(body_) + view.BodyQuat(body_) * Vector3d(0.0014, 0.012, 0.042);
  }

  static constexpr double kLead = 0.5;  // [rad]
  const int body_;
  const double lead_;
};

class Push : public ExpertSkill {
 public:
  Push(const LiberoObject& object, std::function<Vector3d(const ExpertView&)> place)
      : object_(object), place_(std::move(place)) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Extent extent = view.ExtentOf(view.Geoms(object_.body));
    const Vector3d middle = extent.Centre(), place = place_(view), tool = view.Tool();
    Vector3d way = place - middle;
    way.z() = 0;
    const Vector3d direction = way.normalized();
    const double radius = (extent.high - extent.low).x() / 2;
    // From inside, against the rim: behind it there may be no room for the hand.
    Vector3d start = middle + 0.3 * radius * direction;
    start.z() = extent.low.z() + kHeight;
    const Vector3d rel = tool - middle;
    if (rel.head<2>().norm() < 0.9 * radius && tool.z() < start.z() + 0.01 && view.Gap() < 0.02) {
      const double ahead = rel.dot(direction);
      Vector3d goal = middle + (ahead + 0.03) * direction;
      goal.z() = start.z();
      return {goal, DownTurned(view, view.Yaw()), kClose};
    }
    return {tool + Funnel(view, tool, start, 0.03, object_.body), DownTurned(view, 0), kClose};
  }
  Aim Look(const ExpertView& view) const override {
    return {view.ExtentOf(view.Geoms(object_.body)).Centre(), place_(view)};
  }

 private:
  static constexpr double kHeight = 0.011;  // [m] of the tool over the table
  const LiberoObject& object_;
  const std::function<Vector3d(const ExpertView&)> place_;
};

// The leaf of a door, its last collision box; -1 if there is none.
int DoorLeaf(const mjModel& model, int joint) {
  const int body = model.jnt_bodyid[joint];
  int leaf = -1;
  for (int geom = model.body_geomadr[body];
       geom < model.body_geomadr[body] + model.body_geomnum[body]; ++geom) {
    if (model.geom_group[geom] == 0 && model.geom_type[geom] == mjGEOM_BOX) leaf = geom;
  }
  return leaf;
}

// The upright bar of a door: of its collision capsules the one along the hinge; -1 if there is
// none.
int DoorBar(const mjModel& model, int joint) {
  const int body = model.jnt_bodyid[joint];
  for (int geom = model.body_geomadr[body];
       geom < model.body_geomadr[body] + model.body_geomnum[body]; ++geom) {
    if (model.geom_group[geom] != 0 || model.geom_type[geom] != mjGEOM_CAPSULE) continue;
    double along[3];
    mju_rotVecQuat(along, std::array{0.0, 0.0, 1.0}.data(), model.geom_quat + 4 * geom);
    if (std::abs(mju_dot3(along, model.jnt_axis + 3 * joint)) > 0.99) return geom;
  }
  return -1;
}

// Holds the bar from above, a finger on either side of it along the leaf, and leads it around the
// hinge; the hand turns with the leaf, which leaves little room behind the bar.
class PullDoor : public ExpertSkill {
 public:
  PullDoor(const mjModel& model, int joint, int bar)
      : joint_(joint), bar_(bar), top_(model.geom_size[3 * bar + 1]) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Vector3d hinge = view.JointAnchor(joint_), tool = view.Tool();
    const Vector3d bar = view.Geom(bar_) + Vector3d(0, 0, top_ - kBelowTop);
    Vector3d arm = bar - hinge;
    arm.z() = 0;
    const double yaw = std::remainder(std::atan2(arm.y(), arm.x()) - M_PI / 2, M_PI);
    const Vector3d error = bar - tool;
    const bool closed = view.Gap() < 0.035;
    const double slack = closed ? 2 : 1;
    const bool at = error.head<2>().norm() < 0.01 * slack && std::abs(error.z()) < 0.012 * slack;
    const bool turned = std::abs(std::remainder(view.Yaw() - yaw, M_PI)) < 0.15 * slack;
    if (at && closed) {
      const Eigen::AngleAxisd ahead(-kLead, view.JointAxis(joint_));
      Vector3d goal = hinge + ahead * arm;
      goal.z() = bar.z();
      return {goal, DownTurned(view, yaw - kLead), kClose};
    }
    if (at && turned) return {bar, DownTurned(view, yaw), kClose};
    if (view.Gap() < kOpenGap) return {tool, view.Hand(), kOpen};
    return {tool + Funnel(view, tool, bar, kFingerRadius, -1), DownTurned(view, yaw), kOpen};
  }
  Aim Look(const ExpertView& view) const override {
    const Vector3d bar = view.Geom(bar_), hinge = view.JointAnchor(joint_);
    const double left = view.model().jnt_range[2 * joint_] - view.Joint(joint_);
    return {bar, hinge + Eigen::AngleAxisd(left, view.JointAxis(joint_)) * (bar - hinge)};
  }

 private:
  static constexpr double kBelowTop = 0.015;  // [m] of the bar's end
  static constexpr double kLead = 0.2;        // [rad]
  const int joint_, bar_;
  const double top_;
};

// Pushes the leaf's outer edge around the hinge with closed fingers.
class ShutDoor : public ExpertSkill {
 public:
  ShutDoor(int joint, int leaf) : joint_(joint), leaf_(leaf) {}

  ToolGoal Decide(const ExpertView& view) const override {
    const Vector3d hinge = view.JointAnchor(joint_), leaf = view.Geom(leaf_), tool = view.Tool();
    Vector3d arm = leaf - hinge;  // to the leaf's middle
    arm.z() = 0;
    const Vector3d along = arm.normalized();
    // Shutting is towards positive angles; the outside lies the other way.
    const Vector3d shutting = view.JointAxis(joint_).cross(along).normalized();
    Vector3d push = hinge + 1.5 * arm;
    push.z() = leaf.z() + kHeight;
    const Vector3d start = push - kBehind * shutting;
    const Vector3d rel = tool - push;
    const double before = -rel.dot(shutting), aside = std::abs(rel.dot(along));
    const double yaw = std::remainder(std::atan2(along.y(), along.x()), M_PI);
    if (before > 0 && before < kBehind + 0.03 && aside < 0.06 && std::abs(rel.z()) < 0.04)
      return {push + 0.05 * shutting, DownTurned(view, yaw), kClose};
    return {tool + Funnel(view, tool, start, 0.03, -1), DownTurned(view, yaw), kClose};
  }
  Aim Look(const ExpertView& view) const override {
    const Vector3d leaf = view.Geom(leaf_), hinge = view.JointAnchor(joint_);
    const double left = view.model().jnt_range[2 * joint_ + 1] - view.Joint(joint_);
    return {leaf, hinge + Eigen::AngleAxisd(left, view.JointAxis(joint_)) * (leaf - hinge)};
  }

 private:
  static constexpr double kBehind = 0.06, kHeight = 0.062;  // [m]
  const int joint_, leaf_;
};

}  // namespace

// The bar of a cabinet's drawer: of the drawer's collision geoms the one that stands out furthest.
// Drawers slide along the body's y axis and open towards -y.
int DrawerBar(const mjModel& model, int joint) {
  const int body = model.jnt_bodyid[joint];
  int bar = -1;
  for (int geom = model.body_geomadr[body];
       geom < model.body_geomadr[body] + model.body_geomnum[body]; ++geom) {
    if (model.geom_group[geom] != 0) continue;
    if (bar < 0 || model.geom_pos[3 * geom + 1] < model.geom_pos[3 * bar + 1]) bar = geom;
  }
  return bar;
}

Quaterniond DownTurned(const ExpertView& view, double yaw) {
  const Quaterniond one = Turned(yaw), other = Turned(yaw + M_PI), hand = view.Hand();
  return RotationBetween(hand, one).norm() <= RotationBetween(hand, other).norm() ? one : other;
}

std::unique_ptr<ExpertSkill> MakePickAndPlace(const LiberoObject& object,
                                              std::function<Place(const ExpertView&)> place) {
  return std::make_unique<PickAndPlace>(object, std::move(place));
}
std::unique_ptr<ExpertSkill> MakePullDrawer(const mjModel& model, int joint) {
  return std::make_unique<PullDrawer>(model, joint);
}
std::unique_ptr<ExpertSkill> MakeShutDrawer(const mjModel& model, int joint) {
  return std::make_unique<ShutDrawer>(model, joint);
}
std::unique_ptr<ExpertSkill> MakeTurnKnob(const mjModel& model, int joint, bool on) {
  return std::make_unique<TurnKnob>(model, joint, on);
}
std::unique_ptr<ExpertSkill> MakePush(const LiberoObject& object,
                                      std::function<Vector3d(const ExpertView&)> place) {
  return std::make_unique<Push>(object, std::move(place));
}
std::unique_ptr<ExpertSkill> MakePullDoor(const mjModel& model, int joint) {
  const int bar = DoorBar(model, joint);
  return bar < 0 ? nullptr : std::make_unique<PullDoor>(model, joint, bar);
}
std::unique_ptr<ExpertSkill> MakeShutDoor(const mjModel& model, int joint) {
  const int leaf = DoorLeaf(model, joint);
  return leaf < 0 ? nullptr : std::make_unique<ShutDoor>(joint, leaf);
}

}  // namespace robostress::libero
