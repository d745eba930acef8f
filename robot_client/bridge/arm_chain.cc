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
#include "common/status_macros.h"
#include "robot_client/bridge/mesh_file.h"
#include "robot_client/bridge/mesh_parts.h"

namespace robostress::bridge {
namespace {

using tinyxml2::XMLElement;

constexpr size_t kMostCorners = 8192;  // the control thread looks at each of them
constexpr size_t kMostPartsOfMesh = 6;
constexpr int kSides = 16;            // of a prism about a cylinder
constexpr int kMostStrips = 4;        // of a box
constexpr double kFrameMass = 0.001;  // [kg] that a frame is given by those who must give it some
constexpr double kBeyondEnd = 0.1;    // [rad] of a limit beyond the model's: two sheets may differ
constexpr double kLongest = 5;        // [m] of a shape, and from a frame to the next
constexpr double kLongestOfBase = 1000;  // [m] of a shape: it may be the ground

Eigen::Isometry3d PoseOf(const std::vector<double>& xyz, const std::vector<double>& rpy) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(xyz[0], xyz[1], xyz[2]);
  T.linear() = (Eigen::AngleAxisd(rpy[2], Eigen::Vector3d::UnitZ()) *
                Eigen::AngleAxisd(rpy[1], Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(rpy[0], Eigen::Vector3d::UnitX()))
                   .toRotationMatrix();
  return T;
}

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
    for (size_t i = 0; i < model_.links.size(); ++i) {
      if (places_[i].owner >= 0) AddMass(model_.links[i], places_[i]);
      RS_RETURN_IF_ERROR(AddShape(model_.links[i], places_[i]));
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

  // What a link is where it is touched, or else where it is seen.
  absl::Status AddShape(const urdf::Link& link, const Place& place) {
    const XMLElement& e = *link.element;
    const bool touched = e.FirstChildElement("collision") != nullptr;
    RS_ASSIGN_OR_RETURN(const bool known, AddShapes(e, touched ? "collision" : "visual", place));
    if (known) return absl::OkStatus();
    const bool solid =
        touched || e.FirstChildElement("visual") != nullptr || link.mass > kFrameMass;
    const Eigen::Vector3d origin = place.T_owner_link.translation();
    chain_.body.push_back({place.owner, {{origin}, solid ? options_.radius : 0}, true, false});
    if (solid) unknown_.push_back({place.owner, origin});
    return absl::OkStatus();
  }

  // Whether there is any whose size is known.
  absl::StatusOr<bool> AddShapes(const XMLElement& link, const char* what, const Place& place) {
    bool known = false;
    for (const XMLElement* shown = link.FirstChildElement(what); shown != nullptr;
         shown = shown->NextSiblingElement(what)) {
      Eigen::Isometry3d T = place.T_owner_link;
      if (const XMLElement* origin = shown->FirstChildElement("origin"); origin != nullptr) {
        RS_ASSIGN_OR_RETURN(const auto xyz, file_.Numbers(*origin, "xyz", {0, 0, 0}));
        RS_ASSIGN_OR_RETURN(const auto rpy, file_.Numbers(*origin, "rpy", {0, 0, 0}));
        T = T * PoseOf(xyz, rpy);
      }
      const XMLElement* geometry = shown->FirstChildElement("geometry");
      if (geometry == nullptr) continue;
      for (const XMLElement* kind = geometry->FirstChildElement(); kind != nullptr;
           kind = kind->NextSiblingElement()) {
        RS_ASSIGN_OR_RETURN(std::vector<Hull> shapes, ShapesOf(*kind, place.owner));
        known = known || !shapes.empty();
        for (Hull& shape : shapes) {
          for (Eigen::Vector3d& corner : shape.corners) corner = T * corner;
          chain_.body.push_back({place.owner, std::move(shape)});
        }
      }
    }
    return known;
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
      chain_.body.push_back({owner, {{origin, end}, options_.radius}, false, true});
    }
  }

  // Nothing where a mesh is not there, which is listed.
  absl::StatusOr<std::vector<Hull>> MeshShapes(const XMLElement& kind, int owner) {
    const std::string filename = AttributeOf(kind, "filename");
    RS_ASSIGN_OR_RETURN(const auto scale, file_.Numbers(kind, "scale", {1, 1, 1}));
    const auto missing = [&](const char* why) {
      chain_.missing_meshes.push_back(absl::StrCat(filename, why));
      return std::vector<Hull>();
    };
    if (!IsMeshRead(filename)) return missing(" (STL, OBJ and COLLADA are read)");
    const std::string path = FindMesh(filename, file_.name(), options_.packages);
    if (path.empty()) return missing(" (not found)");
    RS_ASSIGN_OR_RETURN(std::vector<Eigen::Vector3d> corners, ReadMesh(path));
    double longest = 0;
    for (Eigen::Vector3d& corner : corners) {
      corner = corner.cwiseProduct(Eigen::Map<const Eigen::Vector3d>(scale.data()));
      longest = std::max({longest, corner.cwiseAbs().maxCoeff(),
                          (corner - corners.front()).cwiseAbs().maxCoeff()});
    }
    if (!(longest <= kLongest)) {
      if (owner < 0) return missing(" (larger than 5 m)");
      return file_.Error(
          kind, absl::StrCat("mesh ", path, " is ", longest, " m long or away, at most ", kLongest,
                             "; where it is in millimetres write scale=\"0.001 0.001 0.001\""));
    }
    ++chain_.meshes;
    return PartsOf(corners, kMostPartsOfMesh);
  }

  absl::StatusOr<std::vector<Hull>> ShapesOf(const XMLElement& kind, int owner) {
    const absl::string_view name = kind.Name();
    const double longest = owner < 0 ? kLongestOfBase : kLongest;
    const auto within = [&](double value) { return value >= 0 && value <= longest; };
    const auto wrong = [&] {
      return file_.Error(kind, absl::StrCat("<", kind.Name(), "> is larger than ", longest,
                                            " m or below 0; URDF is in metres"));
    };
    if (name == "mesh") return MeshShapes(kind, owner);
    if (name == "sphere") {
      RS_ASSIGN_OR_RETURN(const auto radius, file_.Numbers(kind, "radius", {0}));
      if (!within(radius[0])) return wrong();
      return std::vector<Hull>{{{Eigen::Vector3d::Zero()}, radius[0]}};
    }
    if (name == "cylinder" || name == "capsule") {
      RS_ASSIGN_OR_RETURN(const auto radius, file_.Numbers(kind, "radius", {0}));
      RS_ASSIGN_OR_RETURN(const auto length, file_.Numbers(kind, "length", {0}));
      if (!within(radius[0]) || !within(length[0])) return wrong();
      const Eigen::Vector3d end(0, 0, length[0] / 2);
      if (name == "capsule") return std::vector<Hull>{{{end, -end}, radius[0]}};
      Hull prism;  // about the cylinder
      const double corner = radius[0] / std::cos(M_PI / kSides);
      for (int k = 0; k < kSides; ++k) {
        const double angle = 2 * M_PI * k / kSides;
        const Eigen::Vector3d side(corner * std::cos(angle), corner * std::sin(angle), 0);
        prism.corners.insert(prism.corners.end(), {side + end, side - end});
      }
      return std::vector<Hull>{prism};
    }
    if (name != "box") return std::vector<Hull>();
    RS_ASSIGN_OR_RETURN(const auto size, file_.Numbers(kind, "size", {0, 0, 0}));
    const Eigen::Vector3d half = Eigen::Map<const Eigen::Vector3d>(size.data()) / 2;
    for (const double side : size)
      if (!within(side)) return wrong();
    Hull box;
    for (int corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3d sign(corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1);
      box.corners.push_back(half.cwiseProduct(sign));
    }
    return std::vector<Hull>{box};
  }

  absl::Status FindTool() {
    const int last = static_cast<int>(chain_.links.size()) - 1;
    std::vector<std::string> carried;
    for (size_t i = 0; i < model_.links.size(); ++i) {
      if (places_[i].owner != last) continue;
      if (model_.links[i].name == options_.tool) {
        chain_.tool = places_[i].T_owner_link.translation();
        chain_.body.push_back({last, {{chain_.tool}, 0}, true, false});
        return absl::OkStatus();
      }
      carried.push_back(model_.links[i].name);
    }
    if (carried.size() > 12) carried.resize(12);
    return absl::InvalidArgumentError(
        absl::StrCat("model.tool is '", options_.tool, "', must be a link of ", file_.name(),
                     " that the last joint carries: ", absl::StrJoin(carried, ", ")));
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
  if (absl::string_view(xml.root().Name()) != "robot")
    return xml.Error(xml.root(), absl::StrCat("the root is <", xml.root().Name(),
                                              ">, must be <robot>: of the formats a model is "
                                              "written in the client reads URDF"));
  RS_ASSIGN_OR_RETURN(const UrdfModel model, ReadUrdf(xml, joints));
  return ChainReader(xml, model, options).Read(joints, limits);
}

}  // namespace robostress::bridge
