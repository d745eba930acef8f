#include "calibration/excite/urdf_shapes_model.h"

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/model/model_file.h"
#include "common/atomic_file.h"
#include "common/models/urdf_shapes.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

using tinyxml2::XMLElement;

constexpr uint64_t kMostBytes = 16 << 20;

std::string Triple(const Eigen::Vector3d& v) {
  return absl::StrFormat("%.9g %.9g %.9g", v.x(), v.y(), v.z());
}

// Balls and capsules are MuJoCo's; of other hulls every corner becomes a cube that holds its ball.
void AddPart(const Hull& part, int index, XMLElement& body, XMLElement& asset) {
  XMLElement* geom = body.InsertNewChildElement("geom");
  geom->SetAttribute("mass", "0");
  if (part.corners.size() == 1 && part.radius > 0) {
    geom->SetAttribute("type", "sphere");
    geom->SetAttribute("pos", Triple(part.corners[0]).c_str());
    geom->SetAttribute("size", part.radius);
    return;
  }
  if (part.corners.size() == 2 && part.radius > 0 && part.corners[0] != part.corners[1]) {
    geom->SetAttribute("type", "capsule");
    geom->SetAttribute("fromto",
                       absl::StrCat(Triple(part.corners[0]), " ", Triple(part.corners[1])).c_str());
    geom->SetAttribute("size", part.radius);
    return;
  }
  std::string corners;
  for (const Eigen::Vector3d& corner : part.corners) {
    for (int k = 0; k < 8; ++k) {
      const Eigen::Vector3d aside(k & 1 ? 1 : -1, k & 2 ? 1 : -1, k & 4 ? 1 : -1);
      absl::StrAppend(&corners, Triple(corner + part.radius * aside), " ");
      if (part.radius == 0) break;
    }
  }
  const std::string name = absl::StrCat("part", index);
  XMLElement* mesh = asset.InsertNewChildElement("mesh");
  mesh->SetAttribute("name", name.c_str());
  mesh->SetAttribute("vertex", corners.c_str());
  geom->SetAttribute("type", "mesh");
  geom->SetAttribute("mesh", name.c_str());
}

void FindBodies(XMLElement& above, std::map<std::string, XMLElement*>* bodies) {
  for (XMLElement* body = above.FirstChildElement("body"); body != nullptr;
       body = body->NextSiblingElement("body")) {
    bodies->emplace(AttributeOf(*body, "name"), body);
    FindBodies(*body, bodies);
  }
}

}  // namespace

absl::StatusOr<ShapedModel> LoadUrdfWithShapes(const Rig& rig) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(rig.model, kMostBytes));
  RS_ASSIGN_OR_RETURN(const XmlFile file, XmlFile::Parse(rig.model, text));
  std::vector<std::string> moving;
  for (const RigJoint& joint : rig.joints) moving.push_back(joint.name);
  RS_ASSIGN_OR_RETURN(const UrdfModel urdf, ReadUrdf(file, moving));
  RS_ASSIGN_OR_RETURN(UrdfShapes shapes, ReadUrdfShapes(file, urdf, {}));
  RS_ASSIGN_OR_RETURN(const std::string mjcf, MjcfOf(rig.model, urdf.xml));
  RS_ASSIGN_OR_RETURN(const XmlFile model, XmlFile::Parse(rig.model, mjcf));
  XMLElement& root = *model.document().RootElement();
  std::map<std::string, XMLElement*> bodies;
  if (XMLElement* world = root.FirstChildElement("worldbody")) FindBodies(*world, &bodies);
  // What was written with six digits may be lighter than MuJoCo takes.
  if (XMLElement* compiler = root.FirstChildElement("compiler")) {
    compiler->SetAttribute("boundmass", 1e-9);
    compiler->SetAttribute("boundinertia", 1e-12);
  }
  // The sizes of a model without shapes.
  if (XMLElement* size = root.FirstChildElement("size")) root.DeleteChild(size);
  XMLElement& asset = *root.InsertNewChildElement("asset");
  int parts = 0;
  for (size_t i = 0; i < urdf.links.size(); ++i) {
    const auto body = bodies.find(urdf.links[i].name);
    if (body == bodies.end()) continue;
    for (const Hull& part : shapes.links[i].parts) AddPart(part, parts++, *body->second, asset);
  }
  tinyxml2::XMLPrinter printer;
  model.document().Print(&printer);
  RS_ASSIGN_OR_RETURN(auto compiled, CompileModel(rig.model, printer.CStr()));
  return ShapedModel{std::shared_ptr<mjModel>(std::move(compiled)), std::move(shapes.missing)};
}

}  // namespace robostress::calibration
