#include "robot_client/bridge/arm_chain.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/models/urdf_model.h"
#include "common/models/urdf_shapes.h"
#include "common/status_macros.h"

namespace robostress::bridge {
namespace {

constexpr size_t kMostCorners = 8192;  // the control thread looks at each of them
constexpr int kMostStrips = 4;         // of a box
constexpr double kFrameMass = 0.001;   // [kg] that a frame is given by those who must give it some
constexpr double kBeyondEnd = 0.1;     // [rad] of a limit beyond the model's: two sheets may differ
constexpr double kLongest = 5;         // [m] of a shape, and from a frame to the next

// Where a link of the file is: on which of the chain's links, -1: the base, and where on it.
struct Place {
  int owner = -1;
  Eigen::Isometry3d T_owner_link = Eigen::Isometry3d::Identity();
};

class ChainReader {
 public:
  ChainReader(const XmlFile& file, const UrdfModel& model, const ModelOptions& options)
      : file_(file), model_(model), options_(options) {}

  absl::StatusOr<ArmChain> Read(const std::vector<std::string>& joints, const ArmLimits& limits) {
    chain_.file = file_.name();
    chain_.links.resize(joints.size());
    masses_.resize(joints.size());
    places_.resize(model_.links.size());
    RS_RETURN_IF_ERROR(PlaceLinks(joints, limits));
    RS_ASSIGN_OR_RETURN(UrdfShapes shapes, ReadUrdfShapes(file_, model_, options_.packages));
    chain_.meshes = shapes.meshes;
    chain_.missing_meshes = std::move(shapes.missing);
    for (size_t i = 0; i < model_.links.size(); ++i) {
      if (places_[i].owner >= 0) AddMass(model_.links[i], places_[i]);
      AddShape(model_.links[i], shapes.links[i], places_[i]);
    }
    for (ChainLink& link : chain_.links) SumUp(link);
    RS_RETURN_IF_ERROR(FindTool());
    AddBones();
    size_t corners = 0;
    for (const LinkPart& part : chain_.body) corners += part.shape.corners.size();
    if (corners > kMostCorners)
      return absl::InvalidArgumentError(
          absl::StrCat(file_.name(), ": the links' shapes have ", corners, " corners, at most ",
                       kMostCorners, " are watched; leave shapes out that others hold"));
    return std::move(chain_);
  }

 private:
  // Parents come before their children.
  absl::Status PlaceLinks(const std::vector<std::string>& joints, const ArmLimits& limits) {
    for (const int index : model_.order) {
      const urdf::Link& link = model_.links[static_cast<size_t>(index)];
      if (link.parent < 0) continue;
      const urdf::Joint& joint = model_.joints[static_cast<size_t>(link.parent)];
      const Place& before = places_[static_cast<size_t>(joint.parent)];
      Place& place = places_[static_cast<size_t>(index)];
      place = before;
      const Eigen::Isometry3d origin = PoseOf(joint.origin.xyz, joint.origin.rpy);
      if (!(origin.translation().norm() <= kLongest))
        return absl::InvalidArgumentError(absl::StrCat(
            file_.name(), ": joint '", joint.name, "' is ", origin.translation().norm(),
            " m from the one before, at most ", kLongest, "; URDF is in metres"));
      place.T_owner_link = before.T_owner_link * origin;
      if (!joint.moves) continue;
      const auto found = std::find(joints.begin(), joints.end(), joint.name);
      const int k = static_cast<int>(found - joints.begin());
      if (before.owner != k - 1)
        return absl::InvalidArgumentError(
            absl::StrCat(file_.name(), ": joint '", joint.name, "' is J", k + 1, " of [",
                         absl::StrJoin(joints, ", "), "], and ",
                         before.owner < 0 ? "the base" : absl::StrCat("J", before.owner + 1),
                         " carries it; list the joints from the base on"));
      RS_RETURN_IF_ERROR(CheckJoint(joint, k, limits));
      ChainLink& moved = chain_.links[static_cast<size_t>(k)];
      moved.T_before_joint = place.T_owner_link;
      moved.axis = Eigen::Map<const Eigen::Vector3d>(joint.axis.data()).normalized();
      place = {k, Eigen::Isometry3d::Identity()};
    }
    return absl::OkStatus();
  }

  absl::Status CheckJoint(const urdf::Joint& joint, int k, const ArmLimits& limits) const {
    if (joint.type == "prismatic")
      return absl::InvalidArgumentError(absl::StrCat(
          file_.name(), ": joint '", joint.name,
          "' slides, and the joints of a robot file turn; leave model out for this arm"));
    const double lower = limits.lower[k], upper = limits.upper[k];
    if (joint.limited && (lower < joint.lower - kBeyondEnd || upper > joint.upper + kBeyondEnd))
      return absl::InvalidArgumentError(absl::StrCat(
          file_.name(), ": joint '", joint.name, "' goes from ", joint.lower, " to ", joint.upper,
          " rad, joints[", k, "] of the robot file from ", lower, " to ", upper,
          "; correct lower and upper, or sign and zero, so that both count alike"));
    return absl::OkStatus();
  }

  struct Part {
    int owner;
    double mass;
    Eigen::Vector3d centre;
    Eigen::Matrix3d inertia;
  };
  void AddMass(const urdf::Link& link, const Place& place) {
    if (link.mass <= 0) return;
    const Eigen::Isometry3d T = place.T_owner_link * PoseOf(link.com.xyz, link.com.rpy);
    masses_[static_cast<size_t>(place.owner)].push_back(
        {place.owner, link.mass, T.translation(),
         T.linear() * link.inertia * T.linear().transpose()});
  }
  // Of parallel axes: I about the common centre.
  void SumUp(ChainLink& link) const {
    const std::vector<Part>& parts = masses_[static_cast<size_t>(&link - chain_.links.data())];
    for (const Part& part : parts) {
      link.mass += part.mass;
      link.centre += part.mass * part.centre;
    }
    if (link.mass > 0) link.centre /= link.mass;
    for (const Part& part : parts) {
      const Eigen::Vector3d d = part.centre - link.centre;
      link.inertia += part.inertia + part.mass * (d.squaredNorm() * Eigen::Matrix3d::Identity() -
                                                  d * d.transpose());
    }
  }

  void AddShape(const urdf::Link& link, UrdfShapes::Link& shapes, const Place& place) {
    for (Hull& part : shapes.parts) {
      for (Eigen::Vector3d& corner : part.corners) corner = place.T_owner_link * corner;
      chain_.body.push_back({place.owner, std::move(part)});
    }
    if (!shapes.parts.empty()) return;
    const bool solid = shapes.shown || link.mass > kFrameMass;
    const Eigen::Vector3d origin = place.T_owner_link.translation();
    chain_.body.push_back(
        {place.owner, {{origin}, solid ? options_.radius : 0}, true, true, false});
    if (solid) unknown_.push_back({place.owner, origin});
  }

  // A body of unknown shape reaches from its frame around the next joint, or up to the tool's
  // point.
  void AddBones() {
    for (const auto& [owner, origin] : unknown_) {
      const size_t next = static_cast<size_t>(owner + 1);
      Eigen::Vector3d end = chain_.tool;
      if (next < chain_.links.size()) {
        end = chain_.links[next].T_before_joint.translation();
      } else {
        const double way = (end - origin).norm();
        end = origin + std::max(0.0, 1 - options_.radius / std::max(way, 1e-9)) * (end - origin);
      }
      chain_.body.push_back({owner, {{origin, end}, options_.radius}, false, false, true});
    }
  }

  absl::Status FindTool() {
    const int last = static_cast<int>(chain_.links.size()) - 1;
    std::vector<std::string> carried;
    for (size_t i = 0; i < model_.links.size(); ++i) {
      if (places_[i].owner != last) continue;
      if (model_.links[i].name == options_.tool) {
        chain_.tool = places_[i].T_owner_link.translation();
        chain_.body.push_back({last, {{chain_.tool}, 0}, true, true, false});
        return HoldOthers(model_.links[i]);
      }
      carried.push_back(model_.links[i].name);
    }
    if (carried.size() > 12) carried.resize(12);
    return absl::InvalidArgumentError(
        absl::StrCat("model.tool is '", options_.tool, "', must be a link of ", file_.name(),
                     " that the last joint carries: ", absl::StrJoin(carried, ", ")));
  }

  // Every listed joint is on the way to the tool. One there that is not listed stands at 0 in the
  // model: what moves with a listed one would not be where the model has it.
  absl::Status HoldOthers(const urdf::Link& tool) {
    for (int index = tool.parent; index >= 0;) {
      const urdf::Joint& joint = model_.joints[static_cast<size_t>(index)];
      if (!joint.moves && joint.type != "fixed") {
        if (const std::string master = MasterOf(joint); !master.empty())
          return file_.Error(
              *joint.element,
              absl::StrCat("joint '", joint.name, "' moves with '", master,
                           "' (<mimic>) and carries the tool; the model would hold it at 0: "
                           "leave model out for this arm"));
        chain_.held.insert(chain_.held.begin(), joint.name);
      }
      index = model_.links[static_cast<size_t>(joint.parent)].parent;
    }
    return absl::OkStatus();
  }
  // The listed joint that it follows, over others; empty: none.
  std::string MasterOf(const urdf::Joint& joint) const {
    std::string name = joint.mimic;
    for (size_t steps = 0; steps < model_.joints.size() && !name.empty(); ++steps) {
      const auto master = std::find_if(model_.joints.begin(), model_.joints.end(),
                                       [&](const urdf::Joint& j) { return j.name == name; });
      if (master == model_.joints.end()) break;
      if (master->moves) return name;
      name = master->mimic;
    }
    return "";
  }

  const XmlFile& file_;
  const UrdfModel& model_;
  const ModelOptions& options_;
  ArmChain chain_;
  std::vector<Place> places_;              // by link of the file
  std::vector<std::vector<Part>> masses_;  // by link of the chain
  std::vector<std::pair<int, Eigen::Vector3d>>
      unknown_;  // owner and origin of bodies without a shape
};

}  // namespace

absl::StatusOr<LinkPair> ParseLinkPair(const std::string& text, int joints) {
  std::vector<int> links;
  for (const absl::string_view name : absl::StrSplit(text, '-')) {
    int joint = 0;
    if (name == "base") {
      links.push_back(-1);
    } else if (absl::StartsWith(name, "J") && absl::SimpleAtoi(name.substr(1), &joint) &&
               joint >= 1 && joint <= joints) {
      links.push_back(joint - 1);
    }
  }
  if (links.size() != 2 || links[0] == links[1])
    return absl::InvalidArgumentError(absl::StrCat(
        "'", text, "', must be two links, such as J1-J3 or base-J2; this arm has J1 to J", joints));
  return LinkPair{std::min(links[0], links[1]), std::max(links[0], links[1])};
}

std::string LinkPairName(const LinkPair& pair) {
  return absl::StrCat(pair.first < 0 ? "the base" : absl::StrCat("J", pair.first + 1), " and J",
                      pair.second + 1);
}

absl::StatusOr<ArmChain> ReadArmChain(const std::string& file, const std::string& text,
                                      const std::vector<std::string>& joints,
                                      const ArmLimits& limits, const ModelOptions& options) {
  RS_ASSIGN_OR_RETURN(const XmlFile xml, XmlFile::Parse(file, text));
  if (absl::string_view(xml.root().Name()) == "mujoco")
    return xml.Error(xml.root(),
                     absl::StrCat("is MJCF, and the client reads URDF; `robostress urdf ", file,
                                  " --out arm.urdf` writes one"));
  if (absl::string_view(xml.root().Name()) != "robot")
    return xml.Error(xml.root(), absl::StrCat("the root is <", xml.root().Name(),
                                              ">, must be <robot>: of the formats a model is "
                                              "written in the client reads URDF"));
  RS_ASSIGN_OR_RETURN(const UrdfModel model, ReadUrdf(xml, joints));
  return ChainReader(xml, model, options).Read(joints, limits);
}

}  // namespace robostress::bridge
