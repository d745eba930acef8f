#include "sim_worker/libero/object_file.h"

#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

using tinyxml2::XMLElement;

// LIBERO's search for the joints that move a site: walks the bodies in document order, stops at the
// first body without a site below it, and lets a later (deeper) body override an earlier one.
std::map<std::string, SiteOwner> FindSites(XMLElement* wrapper, const std::string& parent) {
  std::map<std::string, SiteOwner> sites;
  bool stopped = false;
  for (XMLElement* top = wrapper->FirstChildElement(); top; top = top->NextSiblingElement()) {
    VisitElements(top, [&](XMLElement* body) {
      if (!IsTag(body, "body") || stopped) return;
      std::vector<std::string> names;
      VisitElements(body, [&](XMLElement* element) {
        if (IsTag(element, "site")) names.push_back(Attribute(element, "name"));
      });
      if (names.empty()) stopped = true;
      SiteOwner owner{parent, {}};
      for (XMLElement* joint = body->FirstChildElement("joint"); joint;
           joint = joint->NextSiblingElement("joint")) {
        owner.joints.push_back(Attribute(joint, "name"));
      }
      for (const std::string& name : names) sites[name] = owner;
    });
  }
  return sites;
}

// A geom of another group than collision (0) and visual (1) is not part of the object.
void DropOtherGeoms(XMLElement* element) {
  for (XMLElement* child = element->FirstChildElement(); child;) {
    XMLElement* next = child->NextSiblingElement();
    const std::string group = Attribute(child, "group");
    if (IsTag(child, "geom") && group != "0" && group != "1") {
      element->DeleteChild(child);
    } else {
      DropOtherGeoms(child);
    }
    child = next;
  }
}

}  // namespace

absl::Status ObjectFile::FindBody() {
  wrapper_ = file_.Section("worldbody")->FirstChildElement("body");
  body_ = wrapper_ == nullptr ? nullptr : FindChild(wrapper_, "body", "object");
  if (body_ == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(file_.path(), ": no worldbody/body/body[@name='object']"));
  }
  RS_ASSIGN_OR_RETURN(bottom_, ReadMarker("bottom_site", 2));
  RS_ASSIGN_OR_RETURN(top_, ReadMarker("top_site", 2));
  RS_ASSIGN_OR_RETURN(horizontal_radius_, ReadMarker("horizontal_radius_site", 0));
  return absl::OkStatus();
}

absl::StatusOr<double> ObjectFile::ReadMarker(const char* site, int axis) {
  const XMLElement* marker = FindChild(wrapper_, "site", site);
  if (marker == nullptr)
    return absl::InvalidArgumentError(absl::StrCat(file_.path(), ": no ", site));
  RS_ASSIGN_OR_RETURN(const std::vector<double> pos,
                      ReadNumbers(file_.path(), marker, "pos", {0, 0, 0}));
  if (pos.size() == 3) return pos[axis];
  return absl::InvalidArgumentError(absl::StrCat(file_.path(), ":", marker->GetLineNum(), ": ",
                                                 site, "'s pos has ", pos.size(),
                                                 " numbers, expected 3"));
}

// Unnamed geoms are called after their place among all geoms, dropped ones included.
void ObjectFile::NameGeoms() {
  int index = 0;
  VisitElements(body_, [&](XMLElement* element) {
    if (!IsTag(element, "geom")) return;
    const int position = index++;
    if (element->Attribute("name") == nullptr)
      element->SetAttribute("name", absl::StrCat("g", position).c_str());
  });
  DropOtherGeoms(body_);
}

absl::Status ObjectFile::CheckNames() const {
  absl::Status status;
  VisitElements(body_, [&](const XMLElement* element) {
    if (!status.ok() || !IsTag(element, "joint") || element->Attribute("name") != nullptr) return;
    status = absl::InvalidArgumentError(
        absl::StrCat(file_.path(), ":", element->GetLineNum(), ": a <joint> without a name"));
  });
  return status;
}

void ObjectFile::AddFreeJoint(const std::string& instance) {
  XMLElement* joint = AppendNew(body_, "joint");
  joint->SetAttribute("type", "free");
  joint->SetAttribute("damping", "0.0005");
  joint->SetAttribute("name", (instance + "_joint0").c_str());
}

void ObjectFile::AddDefaultSite(const std::string& instance) {
  XMLElement* site = AppendNew(body_, "site");
  for (const auto& [name, value] : {std::pair("pos", "0 0 0"),
                                    {"size", "0.002 0.002 0.002"},
                                    {"rgba", "1 0 0 0"},
                                    {"type", "sphere"},
                                    {"group", "0"}}) {
    site->SetAttribute(name, value);
  }
  site->SetAttribute("name", (instance + "_default_site").c_str());
}

absl::StatusOr<ObjectFile> ObjectFile::Parse(const std::string& path, std::string_view text,
                                             const std::string& instance, bool fixture) {
  RS_ASSIGN_OR_RETURN(MjcfFile mjcf, MjcfFile::Parse(path, text));
  ObjectFile object(std::move(mjcf));
  RS_RETURN_IF_ERROR(object.FindBody());
  RS_RETURN_IF_ERROR(object.CheckNames());
  object.body_->SetAttribute("name", "main");
  object.NameGeoms();
  AddPrefix(object.file_.root(), instance + "_");
  // Before the free joint: LIBERO searches the file, not the model.
  object.sites_ = FindSites(object.wrapper_, instance);
  if (!fixture) object.AddFreeJoint(instance);
  object.AddDefaultSite(instance);
  VisitElements(object.body_, [&](XMLElement* element) {
    if (IsTag(element, "joint")) object.joints_.push_back(Attribute(element, "name"));
    if (IsTag(element, "geom") && IsCollisionGroup(element))
      object.contact_geoms_.push_back(Attribute(element, "name"));
  });
  return object;
}

absl::StatusOr<ObjectFile> ObjectFile::Load(const std::string& path, const std::string& instance,
                                            bool fixture) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return Parse(path, text, instance, fixture);
}

}  // namespace robostress::libero
