#include "calibration/model/mjcf_reduction.h"

#include <filesystem>
#include <map>
#include <set>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

using tinyxml2::XMLElement;
using Names = std::set<std::string>;

constexpr uint64_t kMostBytes = 16 << 20;  // of an included file
constexpr int kMostIncludes = 100;

// What is kept of an element; what is not named here is left out.
const std::map<std::string, Names> kAttributes = {
    {"mujoco", {"model"}},
    {"compiler",
     {"angle", "eulerseq", "autolimits", "coordinate", "balanceinertia", "boundmass",
      "boundinertia", "settotalmass"}},
    {"option", {"gravity"}},
    {"default", {"class"}},
    {"worldbody", {}},
    {"body",
     {"name", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass", "mocap"}},
    {"inertial",
     {"pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mass", "diaginertia",
      "fullinertia"}},
    {"joint",
     {"name", "class", "type", "pos", "axis", "limited", "range", "ref", "springref", "stiffness",
      "springdamper", "damping", "armature", "frictionloss"}},
    {"freejoint", {"name"}},
    {"keyframe", {}},
    {"key", {"name", "qpos"}},
    {"site",
     {"name", "class", "type", "size", "fromto", "pos", "quat", "axisangle", "xyaxes", "zaxis",
      "euler"}}};
const std::map<std::string, Names> kChildren = {
    {"mujoco", {"compiler", "option", "default", "worldbody", "keyframe"}},
    {"keyframe", {"key"}},
    {"default", {"default", "joint", "site"}},
    {"worldbody", {"body", "site"}},
    {"body", {"body", "inertial", "joint", "freejoint", "site"}}};
// What is kept besides with shapes.
const std::map<std::string, Names> kShapeAttributes = {
    {"equality", {}},
    {"joint", {"joint1", "joint2", "polycoef", "active"}},
    {"compiler",
     {"inertiafromgeom", "inertiagrouprange", "exactmeshinertia", "strippath", "fitaabb"}},
    {"geom",
     {"class", "type", "contype", "conaffinity", "group", "size", "mass", "density", "shellinertia",
      "fromto", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mesh", "fitscale"}},
    {"mesh", {"name", "class", "file", "vertex", "face", "refpos", "refquat", "scale"}}};
const std::map<std::string, Names> kShapeChildren = {
    {"mujoco", {"asset", "equality"}}, {"equality", {"joint"}}, {"asset", {"mesh"}},
    {"default", {"geom", "mesh"}},     {"worldbody", {"geom"}}, {"body", {"geom"}}};
// These place or bring bodies.
const Names kStructure = {"frame", "replicate", "attach", "composite", "flexcomp"};

bool Contains(const std::map<std::string, Names>& table, const std::string& key,
              const std::string& name) {
  const auto found = table.find(key);
  return found != table.end() && found->second.count(name) > 0;
}

class Reducer {
 public:
  Reducer(const XmlFile& file, MjcfShapes shapes)
      : main_(file),
        folder_(std::filesystem::absolute(file.name()).parent_path()),
        shapes_(shapes == MjcfShapes::kKept) {}

  absl::StatusOr<MjcfReduction> Reduce() {
    tinyxml2::XMLDocument out;
    XMLElement* root = out.NewElement("mujoco");
    out.InsertEndChild(root);
    RS_RETURN_IF_ERROR(Copy(main_, main_.root(), *root, /*moves=*/false));
    XMLElement* compiler = root->FirstChildElement("compiler");
    if (compiler == nullptr)
      compiler = root->InsertFirstChild(out.NewElement("compiler"))->ToElement();
    // As newer files mean it where they do not say.
    if (!autolimits_) compiler->SetAttribute("autolimits", "true");
    if (shapes_) compiler->SetAttribute("meshdir", (folder_ / meshes_).string().c_str());
    MjcfReduction reduction;
    tinyxml2::XMLPrinter printer(nullptr, true);
    int line = 1;
    Print(*root, printer, line);
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
  static absl::Status Refuse(const XmlFile& file, const XMLElement& e, const std::string& what) {
    return absl::FailedPreconditionError(file.Error(e, what).message());
  }
  bool Keeps(const std::map<std::string, Names>& bare, const std::map<std::string, Names>& shape,
             const std::string& key, const std::string& name) const {
    return Contains(bare, key, name) || (shapes_ && Contains(shape, key, name));
  }

  // Elements stand on the lines of the main file, which MuJoCo's messages name.
  void Print(const XMLElement& e, tinyxml2::XMLPrinter& printer, int& line) const {
    printer.OpenElement(e.Name(), true);
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next())
      printer.PushAttribute(a->Name(), a->Value());
    for (const XMLElement* child = e.FirstChildElement(); child != nullptr;
         child = child->NextSiblingElement()) {
      if (const auto at = lines_.find(child); at != lines_.end() && at->second > line) {
        printer.PushText(std::string(static_cast<size_t>(at->second - line), '\n').c_str());
        line = at->second;
      }
      Print(*child, printer, line);
    }
    printer.CloseElement(true);
  }

  // `moves`: a joint stands between the world and `from`, an element of `file`.
  absl::Status Copy(const XmlFile& file, const XMLElement& from, XMLElement& to, bool moves) {
    const std::string name = from.Name();
    if (&file == &main_) lines_[&to] = from.GetLineNum();
    for (const auto* a = from.FirstAttribute(); a != nullptr; a = a->Next())
      if (Keeps(kAttributes, kShapeAttributes, name, a->Name()))
        to.SetAttribute(a->Name(), a->Value());
    if (name == "compiler") {
      if (!shapes_ && AttributeOf(from, "inertiafromgeom") == "true")
        return Refuse(file, from, "inertiafromgeom is true, so that masses come from shapes");
      autolimits_ |= from.Attribute("autolimits") != nullptr;
      for (const char* folder : {"assetdir", "meshdir"})
        if (from.Attribute(folder) != nullptr) meshes_ = AttributeOf(from, folder);
    }
    if (name == "body") {
      moves |= from.FirstChildElement("joint") != nullptr ||
               from.FirstChildElement("freejoint") != nullptr;
      compensated_ += from.Attribute("gravcomp") != nullptr;
      if (!shapes_ && moves && from.FirstChildElement("inertial") == nullptr &&
          from.FirstChildElement("geom") != nullptr)
        return Refuse(file, from,
                      absl::StrCat("body '", AttributeOf(from, "name"),
                                   "' has shapes and no <inertial>; give it one"));
    }
    return CopyChildren(file, from, name, to, moves);
  }

  // Into `to`, which stands for an element `name`.
  absl::Status CopyChildren(const XmlFile& file, const XMLElement& from, const std::string& name,
                            XMLElement& to, bool moves) {
    for (const XMLElement* e = from.FirstChildElement(); e != nullptr;
         e = e->NextSiblingElement()) {
      const std::string child = e->Name();
      if (kStructure.count(child) > 0)
        return Refuse(
            file, *e,
            absl::StrCat("<", child, "> places bodies in a way that is not read without MuJoCo"));
      if (child == "include") {
        RS_RETURN_IF_ERROR(Include(file, *e, name, to, moves));
      } else if (Keeps(kChildren, kShapeChildren, name, child) && !IsHeightField(*e)) {
        RS_RETURN_IF_ERROR(Copy(file, *e, *to.InsertNewChildElement(child.c_str()), moves));
      } else if (name != "default") {
        left_out_.insert(child);
      }
    }
    return absl::OkStatus();
  }
  static bool IsHeightField(const XMLElement& e) {
    return e.Attribute("hfield") != nullptr || AttributeOf(e, "type") == "hfield";
  }

  // Paths begin at the main file's folder, as MuJoCo's do.
  absl::Status Include(const XmlFile& file, const XMLElement& e, const std::string& name,
                       XMLElement& to, bool moves) {
    const std::string path = (folder_ / AttributeOf(e, "file")).string();
    std::error_code error;
    if (!std::filesystem::is_regular_file(path, error))
      return Refuse(file, e, absl::StrCat("<include>: no file ", path));
    if (++includes_ > kMostIncludes)
      return Refuse(file, e, absl::StrCat("more than ", kMostIncludes, " <include>s"));
    const absl::StatusOr<std::string> text = ReadFileUpTo(path, kMostBytes);
    const absl::StatusOr<XmlFile> part = text.ok() ? XmlFile::Parse(path, *text) : text.status();
    if (!part.ok()) return Refuse(file, e, absl::StrCat("<include>: ", part.status().message()));
    return CopyChildren(*part, part->root(), name, to, moves);
  }

  const XmlFile& main_;
  const std::filesystem::path folder_;
  const bool shapes_;
  std::map<const XMLElement*, int> lines_;
  std::string meshes_;  // meshdir
  bool autolimits_ = false;
  int includes_ = 0;
  Names left_out_;
  int compensated_ = 0;
};

}  // namespace

absl::StatusOr<MjcfReduction> ReduceMjcf(const XmlFile& file, MjcfShapes shapes) {
  return Reducer(file, shapes).Reduce();
}

}  // namespace robostress::calibration
