#include "sim_worker/libero/libero_expert.h"

#include <Eigen/Core>
#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "sim_worker/libero/expert_skills.h"
#include "sim_worker/libero/expert_view.h"
#include "sim_worker/libero/libero_sim_task.h"

namespace robostress::libero {
namespace {

using Eigen::Vector3d;

constexpr double kFullCommandAt =
    0.035;  // [m] error at which the translation command reaches kMaxCommand
constexpr double kMaxCommand = 0.9;
constexpr double kMinCommand = 0.2;    // outside the tolerance: joint friction swallows less
constexpr double kTolerance = 0.004;   // [m]
constexpr double kRotationGain = 2.0;  // command per scaled rotation error
constexpr double kMaxRotation = 0.5;
constexpr double kApart = 0.09;  // [m] between objects that share a place

// Proportional with a cap and, outside the tolerance, a floor.
Eigen::VectorXf CommandTowards(const ToolGoal& goal, const ExpertView& view) {
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

// A part of the task: what to do until it is done.
struct Step {
  std::function<bool(const ExpertView&)> done;
  std::unique_ptr<ExpertSkill> skill;
};

// The order in which atoms are reached, whatever the file's: what is opened or turned, then what is
// put somewhere, then what is shut.
int Rank(const BddlAtom& atom) {
  if (atom.predicate == "turnon" || atom.predicate == "turnoff" || atom.predicate == "open")
    return 0;
  return atom.predicate == "close" ? 2 : 1;
}

class Plan {
 public:
  static absl::StatusOr<std::shared_ptr<Plan>> Make(const LiberoSimTask& task) {
    auto plan = std::make_shared<Plan>(task);
    std::vector<size_t> order(task.scene().problem.goal.size());
    for (size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
      return Rank(task.scene().problem.goal[a]) < Rank(task.scene().problem.goal[b]);
    });
    for (const size_t atom : order) {
      if (!plan->AddAtom(atom)) {
        const BddlAtom& lacking = task.scene().problem.goal[atom];
        return absl::UnimplementedError(absl::StrCat("no scripted expert for '", task.instruction(),
                                                     "': none reaches (", lacking.predicate, " ",
                                                     absl::StrJoin(lacking.arguments, " "),
                                                     "). Use --policy replay or a policy server"));
      }
    }
    return plan;
  }

  explicit Plan(const LiberoSimTask& task) : task_(task), scene_(task.scene()), view_(task) {}

  ExpertDecision Decide() const {
    ExpertDecision decision;
    for (size_t i = 0; i < steps_.size(); ++i) {
      if (steps_[i].done(view_)) continue;
      decision.command = CommandTowards(steps_[i].skill->Decide(view_), view_);
      const Aim aim = steps_[i].skill->Look(view_);
      decision.target = aim.target - view_.Base();
      decision.destination = aim.destination - view_.Base();
      decision.holding = aim.holding;
      decision.progress = (i + (aim.holding ? 0.5 : 0.0)) / steps_.size();
      return decision;
    }
    ToolGoal rest;
    rest.p = view_.Tool();
    rest.q = view_.Hand();
    decision.command = CommandTowards(rest, view_);
    decision.target = decision.destination = rest.p - view_.Base();
    decision.progress = 1;
    return decision;
  }

 private:
  const LiberoObject* Object(const std::string& name) const {
    const auto found = scene_.objects.find(name);
    return found == scene_.objects.end() ? nullptr : &found->second;
  }
  const LiberoSite* SiteOf(const std::string& name) const {
    const auto found = scene_.sites.find(name);
    return found == scene_.sites.end() ? nullptr : &found->second;
  }
  bool Holds(size_t atom) const { return task_.goal().Evaluate(view_.data())[atom]; }

  bool IsDrawer(int joint) const {
    return scene_.model->jnt_type[joint] == mjJNT_SLIDE && DrawerBar(*scene_.model, joint) >= 0;
  }

  bool AddAtom(size_t index) {
    const BddlAtom& atom = scene_.problem.goal[index];
    std::unique_ptr<ExpertSkill> skill;
    if (atom.predicate == "on" || atom.predicate == "in") return AddPlacing(index, atom);
    if (atom.predicate == "open" || atom.predicate == "close") {
      skill = Articulated(atom);
    } else if (atom.predicate == "turnon" || atom.predicate == "turnoff") {
      const LiberoObject* stove = Object(atom.arguments[0]);
      if (stove != nullptr && stove->joints.size() == 1)
        skill = MakeTurnKnob(*scene_.model, stove->joints[0], atom.predicate == "turnon");
    }
    if (skill == nullptr) return false;
    steps_.push_back({[this, index](const ExpertView&) { return Holds(index); }, std::move(skill)});
    return true;
  }

  std::unique_ptr<ExpertSkill> Articulated(const BddlAtom& atom) const {
    const LiberoSite* site = SiteOf(atom.arguments[0]);
    const bool open = atom.predicate == "open";
    if (site != nullptr && site->joints.size() == 1) {
      const int joint = site->joints[0];
      if (!IsDrawer(joint)) return nullptr;
      return open ? MakePullDrawer(*scene_.model, joint) : MakeShutDrawer(*scene_.model, joint);
    }
    const LiberoObject* object = Object(atom.arguments[0]);
    if (object == nullptr || object->joints.size() != 1) return nullptr;
    return open ? MakePullDoor(*scene_.model, object->joints[0])
                : MakeShutDoor(*scene_.model, object->joints[0]);
  }

  bool AddPlacing(size_t index, const BddlAtom& atom) {
    const LiberoObject* object = Object(atom.arguments[0]);
    const LiberoObject* support = Object(atom.arguments[1]);
    const LiberoSite* site = SiteOf(atom.arguments[1]);
    if (object == nullptr || object->fixture || (support == nullptr && site == nullptr))
      return false;
    if (view_.Geoms(object->body).empty()) return false;
    const auto done = [this, index, object](const ExpertView& view) {
      return Holds(index) && !view.Holds(object->body);
    };
    if (absl::StrContains(object->category, "plate") && site != nullptr && site->parent.empty()) {
      const int id = site->site;
      steps_.push_back(
          {done, MakePush(*object, [id](const ExpertView& view) { return view.Site(id); })});
      return true;
    }
    if (site != nullptr && site->joints.size() == 1 && IsDrawer(site->joints[0])) {
      const int joint = site->joints[0];
      const int bar = DrawerBar(*scene_.model, joint);
      steps_.push_back({[this, index, joint, bar](const ExpertView& view) {
                          // Once the bar was let go, less is enough.
                          const bool at_it = (view.Tool() - view.Geom(bar)).norm() < 0.05;
                          return view.Joint(joint) < kDrawerOpen + (at_it ? 0 : 0.025) ||
                                 Holds(index);
                        },
                        MakePullDrawer(*scene_.model, joint)});
    }
    std::function<Place(const ExpertView&)> place;
    if (support != nullptr) {
      place = [this, object, support](const ExpertView& view) {
        return OnObject(view, *object, *support);
      };
    } else {
      const double shift = Shift(index);
      const bool inside = atom.predicate == "in";
      place = [this, object, site, shift, inside](const ExpertView& view) {
        return AtSite(view, *object, *site, shift, inside);
      };
    }
    steps_.push_back({done, MakePickAndPlace(*object, std::move(place))});
    return true;
  }

  // Objects that share a place stand beside each other along x.
  double Shift(size_t index) const {
    const std::string& place = scene_.problem.goal[index].arguments[1];
    const LiberoSite* site = SiteOf(place);
    int count = 0, rank = 0;
    for (size_t i = 0; i < scene_.problem.goal.size(); ++i) {
      const BddlAtom& atom = scene_.problem.goal[i];
      if (atom.predicate != "on" || atom.arguments.size() != 2 || atom.arguments[1] != place)
        continue;
      if (i < index) ++rank;
      ++count;
    }
    return site == nullptr || count < 2 ? 0 : kApart * (rank - (count - 1) / 2.0);
  }

  // From an object's underside up to its origin.
  static double Foot(const ExpertView& view, const LiberoObject& object) {
    return view.Body(object.body).z() - view.ExtentOf(view.Geoms(object.body)).low.z();
  }

  static Place OnObject(const ExpertView& view, const LiberoObject& object,
                        const LiberoObject& support) {
    Place place;
    place.p = view.Body(support.body) + Vector3d(0, 0, Foot(view, object) + 0.006);
    if (absl::StrContains(support.category, "bowl")) place.over = 0.04;
    return place;
  }

  Place AtSite(const ExpertView& view, const LiberoObject& object, const LiberoSite& site,
               double shift, bool inside) const {
    Place place;
    const Vector3d centre = view.Site(site.site);
    const Eigen::Matrix3d frame = view.SiteFrame(site.site);
    const Eigen::Map<const Vector3d> size(scene_.model->site_size + 3 * site.site);
    place.p = centre + Vector3d(shift, 0, Foot(view, object) + 0.005);
    if (absl::StrContains(site.name, "rack")) {
      // The slope of a rack: its site lies across, at the lower end.
      place.p = centre + 0.045 * (frame.transpose() * Vector3d::UnitZ()) + Vector3d(0, 0, 0.005);
      return place;
    }
    if (!inside) return place;
    const double half = (frame * size).cwiseAbs().z();
    place.p.z() -= half;
    if (absl::StrContains(site.parent, "basket")) {
      place.over = 0.125;
    } else if (absl::StrContains(site.parent, "caddy")) {
      // It must fit: its middle, not its origin, goes to the compartment's.
      const Extent extent = view.ExtentOf(view.Geoms(object.body));
      place.p.head<2>() += (view.Body(object.body) - extent.Centre()).head<2>();
      place.turn = M_PI / 2;
      place.over = 0.05;
      place.beside = 0.006;
    } else if (absl::StrContains(site.parent, "microwave")) {
      // In at its front, the body's -y, as far as its first part goes in and stays, when the hand
      // lets go and leaves.
      const Vector3d front = frame * Vector3d(0, -size.y(), 0);
      place.p = centre + kDepth * front + Vector3d(kDoorSide, 0, 0);
      place.p.z() = centre.z() - half + Foot(view, object) + 0.022;
      place.way = -0.2 * front.normalized();
      place.over = 0.02;
    } else {
      place.over = 0.02;
    }
    if (site.joints.size() == 1 && IsDrawer(site.joints[0])) {
      // The middle of what is not under the cabinet's top.
      const int joint = site.joints[0];
      const double under = view.Joint(joint) - scene_.model->jnt_range[2 * joint];
      place.p -= 0.5 * under * view.JointAxis(joint);
    }
    return place;
  }

  // [m] enough for a bowl's foot; wider, it would stand over what lies before the cabinet.
  static constexpr double kDrawerOpen = -0.08;

  static constexpr double kDoorSide = -0.03;  // [m] of a microwave's room from its middle
  static constexpr double kDepth = 0.82;      // of half its room, from the middle to the front

  const LiberoSimTask& task_;
  const LiberoScene& scene_;
  const ExpertView view_;
  std::vector<Step> steps_;
};

}  // namespace

absl::StatusOr<Expert> MakeLiberoExpert(const LiberoSimTask& task) {
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<Plan> plan, Plan::Make(task));
  return [plan] { return plan->Decide(); };
}

}  // namespace robostress::libero
