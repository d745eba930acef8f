#include "calibration/model/mjcf_reduction.h"

#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

using tinyxml2::XMLElement;
using Names = std::set<std::string>;

// What is kept of an element; what is not named here is left out.
const std::map<std::string, Names> kAttributes = {
    {"mujoco", {"model"}},
    {"compiler",
     {"angle", "eulerseq", "autolimits", "coordinate", "balanceinertia", "boundmass",
      "boundinertia", "settotalmass"}},
    {"option", {"gravity"}},
    {"default", {"class"}},
    {"worldbody", {}},
    {"body", {"name", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass"}},
    {"inertial",
     {"pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mass", "diaginertia",
      "fullinertia"}},
    {"joint",
     {"name", "class", "type", "pos", "axis", "limited", "range", "ref", "springref", "stiffness",
      "damping", "armature", "frictionloss"}},
    {"freejoint", {"name"}},
    {"site", {"name", "pos"}}};
const std::map<std::string, Names> kChildren = {
    {"mujoco", {"compiler", "option", "default", "worldbody"}},
    {"default", {"default", "joint"}},
    {"worldbody", {"body", "site"}},
    {"body", {"body", "inertial", "joint", "freejoint", "site"}}};
// These place or bring bodies.
const Names kStructure = {"include", "frame", "replicate", "attach", "composite", "flexcomp"};

bool Contains(const std::map<std::string, Names>& table, const std::string& key,
              const std::string& name) {
  const auto found = table.find(key);
  return found != table.end() && found->second.count(name) > 0;
}

class Reducer {
 public:
  explicit Reducer(const XmlFile& file) : file_(file) {}

  absl::StatusOr<MjcfReduction> Reduce() {
    tinyxml2::XMLDocument out;
    XMLElement* root = out.NewElement("mujoco");
    out.InsertEndChild(root);
    RS_RETURN_IF_ERROR(Copy(file_.root(), *root, /*moves=*/false));
    tinyxml2::XMLPrinter printer(nullptr, true);
    out.Print(&printer);
    MjcfReduction reduction;
    reduction.xml = printer.CStr();
    if (!left_out_.empty())
      reduction.facts.push_back({"model", "elements", absl::StrJoin(left_out_, ", "),
                                 FactSource::kLeftOut, "none of them moves a joint by itself"});
    if (compensated_ > 0)
      reduction.facts.push_back({"model", "gravcomp", absl::StrCat("of ", compensated_, " bodies"),
                                 FactSource::kLeftOut,
                                 "a drive that bears the arm's weight shows as gravity_error"});
    return reduction;
  }

 private:
  absl::Status Refuse(const XMLElement& e, const std::string& what) const {
    return absl::FailedPreconditionError(file_.Error(e, what).message());
  }

  // `moves`: a joint stands between the world and `from`.
  absl::Status Copy(const XMLElement& from, XMLElement& to, bool moves) {
    const std::string name = from.Name();
    for (const auto* a = from.FirstAttribute(); a != nullptr; a = a->Next())
      if (Contains(kAttributes, name, a->Name())) to.SetAttribute(a->Name(), a->Value());
    if (name == "compiler" && AttributeOf(from, "inertiafromgeom") == "true")
      return Refuse(from, "inertiafromgeom is true, so that masses come from shapes");
    if (name == "body") {
      moves |= from.FirstChildElement("joint") != nullptr ||
               from.FirstChildElement("freejoint") != nullptr;
      compensated_ += from.Attribute("gravcomp") != nullptr;
      if (moves && from.FirstChildElement("inertial") == nullptr &&
          from.FirstChildElement("geom") != nullptr)
        return Refuse(from, absl::StrCat("body '", AttributeOf(from, "name"),
                                         "' has shapes and no <inertial>; give it one"));
    }
    for (const XMLElement* e = from.FirstChildElement(); e != nullptr;
         e = e->NextSiblingElement()) {
      if (kStructure.count(e->Name()) > 0)
        return Refuse(*e, absl::StrCat("<", e->Name(),
                                       "> places bodies in a way that is not read without MuJoCo"));
      if (Contains(kChildren, name, e->Name())) {
        RS_RETURN_IF_ERROR(Copy(*e, *to.InsertNewChildElement(e->Name()), moves));
      } else if (name != "default") {
        left_out_.insert(e->Name());
      }
    }
    return absl::OkStatus();
  }

  const XmlFile& file_;
  Names left_out_;
  int compensated_ = 0;
};

}  // namespace

absl::StatusOr<MjcfReduction> ReduceMjcf(const XmlFile& file) { return Reducer(file).Reduce(); }

}  // namespace robostress::calibration
