#include "common/models/urdf_shapes.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/models/mesh_file.h"
#include "common/models/mesh_parts.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using tinyxml2::XMLElement;

constexpr size_t kMostPartsOfMesh = 6;
constexpr int kSides = 16;               // of a prism about a cylinder
constexpr double kLongest = 5;           // [m] of a shape
constexpr double kLongestOfBase = 1000;  // [m] of one that no joint moves: it may be the ground

class ShapeReader {
 public:
  ShapeReader(const XmlFile& file, const UrdfModel& model, const std::vector<std::string>& packages)
      : file_(file), model_(model), packages_(packages) {}

  absl::StatusOr<UrdfShapes> Read() {
    std::vector<char> carried(model_.links.size(), 0);  // by a joint that moves
    shapes_.links.resize(model_.links.size());
    for (const int index : model_.order) {
      const urdf::Link& link = model_.links[static_cast<size_t>(index)];
      if (link.parent >= 0) {
        const urdf::Joint& joint = model_.joints[static_cast<size_t>(link.parent)];
        carried[static_cast<size_t>(index)] =
            joint.moves || carried[static_cast<size_t>(joint.parent)];
      }
      RS_RETURN_IF_ERROR(ReadLink(*link.element, carried[static_cast<size_t>(index)] != 0,
                                  shapes_.links[static_cast<size_t>(index)]));
    }
    return std::move(shapes_);
  }

 private:
  absl::Status ReadLink(const XMLElement& link, bool carried, UrdfShapes::Link& out) {
    const bool touched = link.FirstChildElement("collision") != nullptr;
    const char* const what = touched ? "collision" : "visual";
    for (const XMLElement* shown = link.FirstChildElement(what); shown != nullptr;
         shown = shown->NextSiblingElement(what)) {
      out.shown = true;
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      if (const XMLElement* origin = shown->FirstChildElement("origin"); origin != nullptr) {
        RS_ASSIGN_OR_RETURN(const auto xyz, file_.Numbers(*origin, "xyz", {0, 0, 0}));
        RS_ASSIGN_OR_RETURN(const auto rpy, file_.Numbers(*origin, "rpy", {0, 0, 0}));
        T = PoseOf(xyz, rpy);
      }
      const XMLElement* geometry = shown->FirstChildElement("geometry");
      if (geometry == nullptr) continue;
      for (const XMLElement* kind = geometry->FirstChildElement(); kind != nullptr;
           kind = kind->NextSiblingElement()) {
        RS_ASSIGN_OR_RETURN(std::vector<Hull> parts, ShapesOf(*kind, carried));
        for (Hull& part : parts) {
          for (Eigen::Vector3d& corner : part.corners) corner = T * corner;
          out.parts.push_back(std::move(part));
        }
      }
    }
    return absl::OkStatus();
  }

  // Nothing where a mesh is not there, which is listed.
  absl::StatusOr<std::vector<Hull>> MeshShapes(const XMLElement& kind, bool carried) {
    const std::string filename = AttributeOf(kind, "filename");
    RS_ASSIGN_OR_RETURN(const auto scale, file_.Numbers(kind, "scale", {1, 1, 1}));
    const auto missing = [&](const char* why) {
      shapes_.missing.push_back(absl::StrCat(filename, why));
      return std::vector<Hull>();
    };
    if (!IsMeshRead(filename)) return missing(" (STL, OBJ and COLLADA are read)");
    const std::string path = FindMesh(filename, file_.name(), packages_);
    if (path.empty()) return missing(" (not found)");
    RS_ASSIGN_OR_RETURN(std::vector<Eigen::Vector3d> corners, ReadMesh(path));
    double longest = 0;
    for (Eigen::Vector3d& corner : corners) {
      corner = corner.cwiseProduct(Eigen::Map<const Eigen::Vector3d>(scale.data()));
      longest = std::max({longest, corner.cwiseAbs().maxCoeff(),
                          (corner - corners.front()).cwiseAbs().maxCoeff()});
    }
    if (!(longest <= kLongest)) {
      if (!carried) return missing(" (larger than 5 m)");
      return file_.Error(
          kind, absl::StrCat("mesh ", path, " is ", longest, " m long or away, at most ", kLongest,
                             "; where it is in millimetres write scale=\"0.001 0.001 0.001\""));
    }
    ++shapes_.meshes;
    return PartsOf(corners, kMostPartsOfMesh);
  }

  absl::StatusOr<std::vector<Hull>> ShapesOf(const XMLElement& kind, bool carried) {
    const absl::string_view name = kind.Name();
    const double longest = carried ? kLongest : kLongestOfBase;
    const auto within = [&](double value) { return value >= 0 && value <= longest; };
    const auto wrong = [&] {
      return file_.Error(kind, absl::StrCat("<", kind.Name(), "> is larger than ", longest,
                                            " m or below 0; URDF is in metres"));
    };
    if (name == "mesh") return MeshShapes(kind, carried);
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

  const XmlFile& file_;
  const UrdfModel& model_;
  const std::vector<std::string>& packages_;
  UrdfShapes shapes_;
};

}  // namespace

absl::StatusOr<UrdfShapes> ReadUrdfShapes(const XmlFile& file, const UrdfModel& model,
                                          const std::vector<std::string>& packages) {
  return ShapeReader(file, model, packages).Read();
}

Eigen::Isometry3d PoseOf(const std::vector<double>& xyz, const std::vector<double>& rpy) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(xyz[0], xyz[1], xyz[2]);
  T.linear() = (Eigen::AngleAxisd(rpy[2], Eigen::Vector3d::UnitZ()) *
                Eigen::AngleAxisd(rpy[1], Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(rpy[0], Eigen::Vector3d::UnitX()))
                   .toRotationMatrix();
  return T;
}

}  // namespace robostress
