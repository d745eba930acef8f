#include "common/models/urdf_model.h"

#include <algorithm>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/models/urdf_inertia.h"
#include "common/models/urdf_parts.h"
#include "common/models/xacro.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using tinyxml2::XMLElement;
using urdf::Joint;
using urdf::Link;
using urdf::Pose;

constexpr size_t kMostLinks = 1000;
constexpr size_t kMostNames = 12;       // in a message
constexpr double kTinyMass = 1e-9;      // [kg]
constexpr double kTinyInertia = 1e-12;  // [kg m^2], above MuJoCo's least
constexpr const char* kPayloadLinks[] = {"payload", "tip",          "tool",   "tool0",
                                         "tcp",     "end_effector", "ee_link"};
const std::vector<std::string> kTypes = {"revolute", "continuous", "prismatic",
                                         "fixed",    "floating",   "planar"};

std::string Names(std::vector<std::string> names) {
  const size_t count = names.size();
  if (count > kMostNames) names.resize(kMostNames);
  return absl::StrCat(absl::StrJoin(names, ", "),
                      count > kMostNames ? absl::StrCat(" and ", count - kMostNames, " more") : "");
}

class UrdfReader {
 public:
  UrdfReader(const XmlFile& file, const std::vector<std::string>& moving)
      : file_(file), moving_(moving.begin(), moving.end()) {}

  absl::StatusOr<UrdfModel> Read() {
    for (const XMLElement* e = file_.root().FirstChildElement("link"); e != nullptr;
         e = e->NextSiblingElement("link"))
      RS_RETURN_IF_ERROR(ReadLink(*e));
    if (links_.empty()) return file_.Error(file_.root(), "<robot> has no <link>");
    for (const XMLElement* e = file_.root().FirstChildElement("joint"); e != nullptr;
         e = e->NextSiblingElement("joint"))
      RS_RETURN_IF_ERROR(ReadJoint(*e));
    RS_RETURN_IF_ERROR(CheckMoving());
    RS_RETURN_IF_ERROR(SortTree());
    DescribeWhole();
    RS_RETURN_IF_ERROR(GiveMass());
    return Result();
  }

 private:
  // The only child of that name; null where there is none.
  absl::StatusOr<const XMLElement*> Only(const XMLElement& parent, const char* name) const {
    const XMLElement* child = parent.FirstChildElement(name);
    if (child != nullptr && child->NextSiblingElement(name) != nullptr)
      return file_.Error(
          *child->NextSiblingElement(name),
          absl::StrCat("a second <", name, "> in one <", parent.Name(), ">; take one out"));
    return child;
  }
  absl::StatusOr<std::string> NewName(const XMLElement& e, std::map<std::string, int>& taken,
                                      size_t index) const {
    const std::string name = AttributeOf(e, "name");
    if (name.empty()) return file_.Error(e, absl::StrCat("<", e.Name(), "> has no name"));
    if (!taken.emplace(name, static_cast<int>(index)).second)
      return file_.Error(e,
                         absl::StrCat("<", e.Name(), "> '", name, "' is there twice; rename one"));
    return name;
  }
  absl::StatusOr<Pose> ReadPose(const XMLElement& parent) const {
    Pose pose;
    RS_ASSIGN_OR_RETURN(const XMLElement* e, Only(parent, "origin"));
    if (e == nullptr) return pose;
    RS_ASSIGN_OR_RETURN(pose.xyz, file_.Numbers(*e, "xyz", pose.xyz));
    RS_ASSIGN_OR_RETURN(pose.rpy, file_.Numbers(*e, "rpy", pose.rpy));
    return pose;
  }
  // 0 where the element or its attribute is missing; refused below 0.
  absl::StatusOr<double> Positive(const XMLElement* e, const char* attribute) const {
    if (e == nullptr) return 0;
    RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, file_.Numbers(*e, attribute, {0}));
    if (numbers[0] < 0)
      return file_.Error(*e, absl::StrCat("<", e->Name(), "> ", attribute, " is ", numbers[0],
                                          ", must be at least 0"));
    return numbers[0];
  }

  absl::Status ReadLink(const XMLElement& e) {
    if (links_.size() >= kMostLinks)
      return file_.Error(e, absl::StrCat("more than ", kMostLinks,
                                         " links; take out what the arm does not carry"));
    Link link;
    link.element = &e;
    RS_ASSIGN_OR_RETURN(link.name, NewName(e, link_of_, links_.size()));
    for (const char* kind : {"visual", "collision"})
      for (const XMLElement* shape = e.FirstChildElement(kind); shape != nullptr;
           shape = shape->NextSiblingElement(kind))
        ++shapes_;
    RS_ASSIGN_OR_RETURN(const XMLElement* inertial, Only(e, "inertial"));
    if (inertial != nullptr) RS_RETURN_IF_ERROR(ReadInertial(*inertial, link));
    links_.push_back(std::move(link));
    return absl::OkStatus();
  }

  absl::Status ReadInertial(const XMLElement& e, Link& link) {
    RS_ASSIGN_OR_RETURN(const XMLElement* mass, Only(e, "mass"));
    RS_ASSIGN_OR_RETURN(const XMLElement* inertia, Only(e, "inertia"));
    if (mass == nullptr || mass->Attribute("value") == nullptr)
      return file_.Error(e, absl::StrCat("link '", link.name,
                                         "': <inertial> has no <mass value>; add it, or take the "
                                         "<inertial> out"));
    RS_ASSIGN_OR_RETURN(link.mass, Positive(mass, "value"));
    RS_ASSIGN_OR_RETURN(link.com, ReadPose(e));
    if (inertia == nullptr) return absl::OkStatus();
    constexpr struct {
      const char* name;
      int row, column;
    } kEntries[] = {{"ixx", 0, 0}, {"iyy", 1, 1}, {"izz", 2, 2},
                    {"ixy", 0, 1}, {"ixz", 0, 2}, {"iyz", 1, 2}};
    for (const auto& entry : kEntries) {
      RS_ASSIGN_OR_RETURN(const std::vector<double> number,
                          file_.Numbers(*inertia, entry.name, {0}));
      link.inertia(entry.row, entry.column) = link.inertia(entry.column, entry.row) = number[0];
    }
    const auto repair = RepairInertia(link.inertia, link.mass);
    if (!repair.ok())
      return file_.Error(
          *inertia, absl::StrCat("link '", link.name, "': <inertia>: ", repair.status().message()));
    if (repair->changed)
      facts_.push_back({link.name, "inertia",
                        absl::StrFormat("principal moments %.4g %.4g %.4g -> %.4g %.4g %.4g kg m^2",
                                        repair->before[0], repair->before[1], repair->before[2],
                                        repair->after[0], repair->after[1], repair->after[2]),
                        FactSource::kRepaired,
                        "the smaller two of a body add up to the largest at least"});
    link.inertia = repair->inertia;
    return absl::OkStatus();
  }

  absl::StatusOr<int> LinkOf(const XMLElement& joint, const std::string& name,
                             const char* side) const {
    RS_ASSIGN_OR_RETURN(const XMLElement* e, Only(joint, side));
    const std::string link = e == nullptr ? "" : AttributeOf(*e, "link");
    const auto found = link_of_.find(link);
    if (found != link_of_.end()) return found->second;
    return file_.Error(e == nullptr ? joint : *e,
                       absl::StrCat("joint '", name, "': <", side, " link> is '", link,
                                    "', must be one of the links: ", Names(LinkNames())));
  }

  absl::Status ReadJoint(const XMLElement& e) {
    Joint joint;
    joint.element = &e;
    RS_ASSIGN_OR_RETURN(joint.name, NewName(e, joint_of_, joints_.size()));
    joint.type = AttributeOf(e, "type");
    if (std::find(kTypes.begin(), kTypes.end(), joint.type) == kTypes.end())
      return file_.Error(e, absl::StrCat("joint '", joint.name, "': type is '", joint.type,
                                         "', must be one of ", absl::StrJoin(kTypes, ", ")));
    RS_ASSIGN_OR_RETURN(joint.parent, LinkOf(e, joint.name, "parent"));
    RS_ASSIGN_OR_RETURN(joint.child, LinkOf(e, joint.name, "child"));
    RS_ASSIGN_OR_RETURN(joint.origin, ReadPose(e));
    RS_ASSIGN_OR_RETURN(const XMLElement* mimic, Only(e, "mimic"));
    if (mimic != nullptr) joint.mimic = AttributeOf(*mimic, "joint");
    joint.moves = moving_.count(joint.name) > 0;
    if (joint.moves) RS_RETURN_IF_ERROR(ReadMotion(e, joint));
    const int index = static_cast<int>(joints_.size());
    Link& child = links_[static_cast<size_t>(joint.child)];
    if (child.parent >= 0)
      return file_.Error(
          e, absl::StrCat("link '", child.name, "' is the child of joint '",
                          joints_[static_cast<size_t>(child.parent)].name, "' and of '", joint.name,
                          "'; a closed chain cannot be calibrated, open it"));
    child.parent = index;
    links_[static_cast<size_t>(joint.parent)].children.push_back(index);
    joints_.push_back(std::move(joint));
    return absl::OkStatus();
  }

  // Axis, stops, losses and limit of a joint that moves.
  absl::Status ReadMotion(const XMLElement& e, Joint& joint) {
    if (joint.type != "revolute" && joint.type != "continuous" && joint.type != "prismatic")
      return file_.Error(e, absl::StrCat("joint '", joint.name, "' of the rig is ", joint.type,
                                         "; must be revolute, continuous or prismatic"));
    RS_ASSIGN_OR_RETURN(const XMLElement* axis, Only(e, "axis"));
    if (axis != nullptr) {
      RS_ASSIGN_OR_RETURN(joint.axis, file_.Numbers(*axis, "xyz", joint.axis));
    }
    if (Eigen::Map<const Eigen::Vector3d>(joint.axis.data()).norm() < 1e-6)
      return file_.Error(axis == nullptr ? e : *axis,
                         absl::StrCat("joint '", joint.name,
                                      "': <axis xyz> has no direction; of a hinge about z it is "
                                      "0 0 1"));
    RS_ASSIGN_OR_RETURN(const XMLElement* dynamics, Only(e, "dynamics"));
    RS_ASSIGN_OR_RETURN(joint.damping, Positive(dynamics, "damping"));
    RS_ASSIGN_OR_RETURN(joint.friction, Positive(dynamics, "friction"));
    RS_ASSIGN_OR_RETURN(const XMLElement* limit, Only(e, "limit"));
    if (limit == nullptr) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(joint.effort, Positive(limit, "effort"));
    if (joint.effort >= urdf::kUnknownLimit) joint.effort = 0;
    RS_ASSIGN_OR_RETURN(const std::vector<double> lower, file_.Numbers(*limit, "lower", {0}));
    RS_ASSIGN_OR_RETURN(const std::vector<double> upper, file_.Numbers(*limit, "upper", {0}));
    joint.lower = lower[0], joint.upper = upper[0];
    joint.limited = joint.type != "continuous" && joint.lower < joint.upper;
    return absl::OkStatus();
  }

  absl::Status CheckMoving() const {
    for (const std::string& name : moving_)
      if (joint_of_.find(name) == joint_of_.end())
        return absl::NotFoundError(absl::StrCat(file_.name(), ": has no joint '", name,
                                                "'; it has ", Names(MovableNames())));
    return absl::OkStatus();
  }

  // One link carries all others.
  absl::Status SortTree() {
    std::vector<std::string> bases;
    for (size_t i = 0; i < links_.size(); ++i)
      if (links_[i].parent < 0) {
        base_ = static_cast<int>(i);
        bases.push_back(links_[i].name);
      }
    if (bases.size() > 1)
      return file_.Error(file_.root(),
                         absl::StrCat("links ", Names(bases),
                                      " have no parent; one link is the base, tie the others to it "
                                      "by <joint type=\"fixed\">"));
    if (!bases.empty()) order_.push_back(base_);
    for (size_t i = 0; i < order_.size(); ++i)
      for (const int joint : links_[static_cast<size_t>(order_[i])].children)
        order_.push_back(joints_[static_cast<size_t>(joint)].child);
    if (order_.size() == links_.size()) return absl::OkStatus();
    std::vector<std::string> round;
    for (size_t i = 0; i < links_.size(); ++i)
      if (std::find(order_.begin(), order_.end(), static_cast<int>(i)) == order_.end())
        round.push_back(links_[i].name);
    return file_.Error(file_.root(),
                       absl::StrCat("links ", Names(round),
                                    " carry each other in a circle; no base carries them"));
  }

  void DescribeWhole() {
    std::vector<ModelFact> whole = {
        {"model", "format",
         absl::StrCat("URDF, ", links_.size(), " links, ", moving_.size(), " of ",
                      MovableNames().size(), " joints move"),
         FactSource::kRead, ""},
        {"model", "base",
         absl::StrCat("link '", links_[static_cast<size_t>(base_)].name, "', fixed to the world"),
         FactSource::kAssumed, ""}};
    for (const char* name : kPayloadLinks)
      if (payload_link_.empty() && link_of_.count(name) > 0) payload_link_ = name;
    whole.push_back({"model", "place of a payload",
                     payload_link_.empty() ? "centre of mass of the last link"
                                           : absl::StrCat("link '", payload_link_, "'"),
                     payload_link_.empty() ? FactSource::kAssumed : FactSource::kRead,
                     payload_link_.empty() ? "a fixed link named tool0 sets it" : ""});
    if (shapes_ > 0)
      whole.push_back({"model", "visual and collision shapes", absl::StrCat(shapes_),
                       FactSource::kLeftOut, ""});
    std::set<std::string> others;
    for (const XMLElement* e = file_.root().FirstChildElement(); e != nullptr;
         e = e->NextSiblingElement())
      for (const char* kind : {"transmission", "gazebo", "ros2_control", "sensor"})
        if (absl::string_view(e->Name()) == kind) others.insert(kind);
    if (!others.empty())
      whole.push_back({"model", "elements", absl::StrJoin(others, ", "), FactSource::kLeftOut, ""});
    facts_.insert(facts_.begin(), whole.begin(), whole.end());
    std::vector<std::string> held;
    for (const Joint& joint : joints_) {
      const std::string mimic =
          joint.mimic.empty() ? "" : absl::StrCat(" (mimic of ", joint.mimic, ")");
      if (!joint.moves && joint.type != "fixed") held.push_back(joint.name + mimic);
      if (joint.moves && !mimic.empty())
        facts_.push_back({joint.name, "mimic", "of " + joint.mimic, FactSource::kLeftOut,
                          "it moves as its own logs say"});
    }
    if (!held.empty()) facts_.push_back(HeldFact(held));
  }

  double MassOn(int link, bool across_moving) const {
    double mass = 0;
    std::vector<int> open = {link};
    while (!open.empty()) {
      const Link& here = links_[static_cast<size_t>(open.back())];
      open.pop_back();
      mass += here.mass;
      for (const int joint : here.children)
        if (across_moving || !joints_[static_cast<size_t>(joint)].moves)
          open.push_back(joints_[static_cast<size_t>(joint)].child);
    }
    return mass;
  }

  // MuJoCo wants mass and inertia of every link that moves.
  absl::Status GiveMass() {
    std::vector<int> massless;
    for (const Joint& joint : joints_) {
      if (!joint.moves) continue;
      Link& link = links_[static_cast<size_t>(joint.child)];
      if (MassOn(joint.child, true) == 0)
        return file_.Error(
            *link.element,
            absl::StrCat("joint '", joint.name, "' moves link '", link.name,
                         "', and nothing on it has a mass, so that no torque is defined; give it "
                         "<inertial> with <mass> and <inertia>, or take the joint out of the rig"));
      if (MassOn(joint.child, false) == 0) {
        massless.push_back(joint.child);
        facts_.push_back({link.name, "mass", absl::StrFormat("%g kg", kTinyMass),
                          FactSource::kAssumed, "it has no <inertial>"});
      }
    }
    for (const int index : massless) links_[static_cast<size_t>(index)].mass = kTinyMass;
    for (const Joint& joint : joints_) {
      Link& link = links_[static_cast<size_t>(joint.child)];
      if (joint.moves && link.mass > 0 &&
          RepairInertia(link.inertia, link.mass)->after[0] < kTinyInertia)
        link.inertia += kTinyInertia * Eigen::Matrix3d::Identity();
    }
    return absl::OkStatus();
  }

  std::vector<std::string> LinkNames() const {
    std::vector<std::string> names;
    for (const Link& link : links_) names.push_back(link.name);
    return names;
  }
  std::vector<std::string> MovableNames() const {
    std::vector<std::string> names;
    for (const Joint& joint : joints_)
      if (joint.type != "fixed") names.push_back(joint.name);
    return names;
  }

  UrdfModel Result() const {
    UrdfModel model;
    model.xml = urdf::Print(links_, joints_);
    for (const Joint& joint : joints_)
      if (joint.moves && joint.effort > 0) model.effort[joint.name] = joint.effort;
    model.payload_link = payload_link_;
    model.facts = facts_;
    model.links = links_;
    model.joints = joints_;
    model.order = order_;
    return model;
  }

  const XmlFile& file_;
  const std::set<std::string> moving_;
  std::vector<Link> links_;
  std::vector<Joint> joints_;
  std::map<std::string, int> link_of_, joint_of_;
  std::vector<int> order_;  // of links, parents first
  int base_ = -1;
  int shapes_ = 0;
  std::string payload_link_;
  std::vector<ModelFact> facts_;
};

}  // namespace

absl::StatusOr<UrdfModel> ReadUrdf(const XmlFile& file, const std::vector<std::string>& moving) {
  RS_RETURN_IF_ERROR(RefuseXacro(file));
  return UrdfReader(file, moving).Read();
}

}  // namespace robostress
