#include "sim_worker/libero/mjcf.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <map>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "sim_worker/libero/visual_bounds.h"

namespace robostress::libero {
namespace {

using tinyxml2::XMLAttribute;
using tinyxml2::XMLDocument;
using tinyxml2::XMLElement;

constexpr const char* kSections[] = {"worldbody", "actuator", "sensor",  "asset",
                                     "tendon",    "equality", "contact", "default"};
// Attributes that hold the name of something (robosuite 1.4, utils/mjcf_utils.py).
constexpr const char* kNamingAttributes[] = {
    "class",  "childclass", "name",          "objname", "material", "texture",   "joint",
    "joint1", "joint2",     "jointinparent", "geom",    "geom1",    "geom2",     "mesh",
    "fixed",  "actuator",   "tendon",        "tendon1", "tendon2",  "slidesite", "cranksite",
    "body",   "body1",      "body2",         "hfield",  "target",   "prefix",    "site"};

bool SameName(const XMLElement* a, const XMLElement* b) {
  const char* left = a->Attribute("name");
  const char* right = b->Attribute("name");
  return (left == nullptr || right == nullptr) ? left == right : std::strcmp(left, right) == 0;
}

absl::Status InlineDefaults(const std::string& path, XMLElement* root, XMLElement* defaults) {
  std::map<std::string, XMLElement*> classes;
  for (XMLElement* item = defaults->FirstChildElement(); item; item = item->NextSiblingElement()) {
    classes[Attribute(item, "class")] = item;
  }
  absl::Status status;
  VisitElements(root, [&](XMLElement* element) {
    const std::string name = Attribute(element, "class");
    for (XMLElement* up = element; up != nullptr;
         up = up->Parent() ? up->Parent()->ToElement() : nullptr) {
      if (up == defaults) return;
    }
    if (element->Attribute("childclass") != nullptr && status.ok()) {
      status = absl::UnimplementedError(
          absl::StrCat(path, ":", element->GetLineNum(), ": childclass is not supported"));
    }
    if (name.empty()) return;
    auto found = classes.find(name);
    if (found == classes.end()) {
      if (status.ok()) {
        status = absl::InvalidArgumentError(absl::StrCat(
            path, ":", element->GetLineNum(), ": default class '", name, "' does not exist"));
      }
      return;
    }
    element->DeleteAttribute("class");
    // The last element of a tag wins, as in robosuite's dictionary.
    const XMLElement* last = nullptr;
    for (const XMLElement* item = found->second->FirstChildElement(element->Name()); item;
         item = item->NextSiblingElement(element->Name())) {
      last = item;
    }
    if (last == nullptr) return;
    for (const XMLAttribute* a = last->FirstAttribute(); a; a = a->Next()) {
      if (element->Attribute(a->Name()) == nullptr) element->SetAttribute(a->Name(), a->Value());
    }
  });
  return status;
}

// A geom collides unless both masks are zero; MuJoCo's default is 1 for both.
bool Collides(const XMLElement* geom) {
  return Attribute(geom, "contype") != "0" || Attribute(geom, "conaffinity") != "0";
}

// Flat colours that keep a scene without its textures readable.
const char* ColourFor(const std::string& file) {
  static constexpr std::pair<const char*, const char*> kColours[] = {
      {"floor", "0.75 0.75 0.75"}, {"tile", "0.75 0.75 0.75"}, {"plaster", "0.85 0.85 0.82"},
      {"wall", "0.87 0.85 0.76"},  {"wood", "0.55 0.40 0.27"}, {"table", "0.60 0.45 0.30"},
      {"metal", "0.62 0.63 0.66"}, {"bowl", "0.12 0.12 0.13"}, {"plate", "0.90 0.90 0.92"},
      {"basket", "0.70 0.52 0.30"}};
  for (const auto& [word, colour] : kColours) {
    if (absl::StrContains(file, word)) return colour;
  }
  return "0.7 0.7 0.7";
}

}  // namespace

std::string Attribute(const XMLElement* element, const char* name) {
  const char* value = element->Attribute(name);
  return value == nullptr ? "" : value;
}

bool IsTag(const XMLElement* element, const char* tag) {
  return std::strcmp(element->Name(), tag) == 0;
}

bool IsCollisionGroup(const XMLElement* geom) {
  const char* group = geom->Attribute("group");
  return group == nullptr || std::strcmp(group, "0") == 0;
}

absl::StatusOr<MjcfFile> MjcfFile::Load(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return Parse(path, text);
}

absl::StatusOr<MjcfFile> MjcfFile::Parse(const std::string& path, std::string_view text) {
  MjcfFile file;
  file.path_ = path;
  file.AddSource(path);
  file.document_ = std::make_unique<XMLDocument>();
  if (file.document_->Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS) {
    return absl::InvalidArgumentError(absl::StrCat(path, ":", file.document_->ErrorLineNum(),
                                                   ": not XML: ", file.document_->ErrorStr()));
  }
  XMLElement* root = file.root();
  if (root == nullptr || std::strcmp(root->Name(), "mujoco") != 0) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": the root element is not <mujoco>"));
  }
  for (const char* section : kSections) file.Section(section);
  XMLElement* defaults = file.Section("default");
  RS_RETURN_IF_ERROR(InlineDefaults(path, root, defaults));
  root->DeleteChild(defaults);
  const std::filesystem::path folder = std::filesystem::absolute(path).parent_path();
  XMLElement* asset = file.Section("asset");
  for (XMLElement* item = asset->FirstChildElement(); item; item = item->NextSiblingElement()) {
    if (const char* name = item->Attribute("file")) {
      item->SetAttribute("file", (folder / name).lexically_normal().c_str());
    }
  }
  return file;
}

XMLElement* MjcfFile::Section(const char* name) {
  XMLElement* section = root()->FirstChildElement(name);
  return section != nullptr ? section : AppendNew(root(), name);
}

void VisitElements(XMLElement* root, const std::function<void(XMLElement*)>& visit) {
  visit(root);
  for (XMLElement* child = root->FirstChildElement(); child; child = child->NextSiblingElement()) {
    VisitElements(child, visit);
  }
}

XMLElement* FindElement(XMLElement* root, const char* tag, const std::string& name) {
  if (std::strcmp(root->Name(), tag) == 0 && Attribute(root, "name") == name) return root;
  for (XMLElement* child = root->FirstChildElement(); child; child = child->NextSiblingElement()) {
    if (XMLElement* found = FindElement(child, tag, name)) return found;
  }
  return nullptr;
}

XMLElement* FindChild(XMLElement* parent, const char* tag, const std::string& name) {
  for (XMLElement* child = parent->FirstChildElement(tag); child;
       child = child->NextSiblingElement(tag)) {
    if (Attribute(child, "name") == name) return child;
  }
  return nullptr;
}

void AddPrefix(XMLElement* root, const std::string& prefix) {
  VisitElements(root, [&](XMLElement* element) {
    for (const char* attribute : kNamingAttributes) {
      const char* value = element->Attribute(attribute);
      if (value == nullptr || absl::StartsWith(value, prefix)) continue;
      element->SetAttribute(attribute, (prefix + value).c_str());
    }
  });
}

XMLElement* AppendCopy(XMLElement* parent, const XMLElement* element) {
  return parent->InsertEndChild(element->DeepClone(parent->GetDocument()))->ToElement();
}

XMLElement* AppendNew(XMLElement* parent, const char* tag) {
  return parent->InsertEndChild(parent->GetDocument()->NewElement(tag))->ToElement();
}

void MergeAssets(XMLElement* asset, XMLElement* other) {
  for (XMLElement* item = other->FirstChildElement(); item; item = item->NextSiblingElement()) {
    bool known = false;
    for (XMLElement* mine = asset->FirstChildElement(item->Name()); mine && !known;
         mine = mine->NextSiblingElement(item->Name())) {
      known = SameName(mine, item);
    }
    if (!known) AppendCopy(asset, item);
  }
}

void MergeFile(MjcfFile& into, XMLElement* body, MjcfFile& other) {
  XMLElement* world = other.Section("worldbody");
  for (XMLElement* item = world->FirstChildElement(); item; item = item->NextSiblingElement())
    AppendCopy(body, item);
  for (const std::string& path : other.sources()) into.AddSource(path);
  MergeAssets(into.Section("asset"), other.Section("asset"));
  for (const char* section : {"actuator", "sensor", "tendon", "equality", "contact"}) {
    XMLElement* from = other.Section(section);
    for (XMLElement* item = from->FirstChildElement(); item; item = item->NextSiblingElement()) {
      AppendCopy(into.Section(section), item);
    }
  }
}

absl::StatusOr<std::vector<double>> ReadNumbers(const std::string& file, const XMLElement* element,
                                                const char* attribute,
                                                const std::vector<double>& fallback) {
  const char* text = element->Attribute(attribute);
  if (text == nullptr) return fallback;
  std::vector<double> numbers;
  for (absl::string_view word :
       absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty())) {
    double value = 0;
    if (!absl::SimpleAtod(word, &value)) {
      return absl::InvalidArgumentError(
          absl::StrCat(file, ":", element->GetLineNum(), ": <", element->Name(), " ", attribute,
                       "=\"", text, "\">: '", std::string(word), "' is not a number"));
    }
    numbers.push_back(value);
  }
  return numbers;
}

std::string FormatNumbers(const std::vector<double>& numbers) {
  std::string text;
  for (double number : numbers) {
    char buffer[32];
    const std::to_chars_result end = std::to_chars(std::begin(buffer), std::end(buffer), number);
    if (!text.empty()) text.push_back(' ');
    text.append(buffer, end.ptr);
  }
  return text;
}

namespace {

// Vertices of a box with the bounding sphere of a visual mesh, where that is known; else of a cube
// 2 cm wide. The sides differ, so that the mesh's principal axes, along which MuJoCo measures it,
// are the box's.
std::string BoxInPlaceOf(const std::string& file) {
  std::array<double, 3> centre = {0, 0, 0}, half = {0.01, 0.01, 0.01};
  if (const std::optional<VisualBounds> bounds = FindVisualBounds(file)) {
    centre = bounds->centre;
    const double unit = bounds->radius / std::sqrt(0.9 * 0.9 + 1.0 + 1.1 * 1.1);
    half = {0.9 * unit, unit, 1.1 * unit};
  }
  std::vector<double> vertices;
  for (int corner = 0; corner < 8; ++corner) {
    for (int axis = 0; axis < 3; ++axis)
      vertices.push_back(centre[axis] + ((corner >> axis) & 1 ? half[axis] : -half[axis]));
  }
  return FormatNumbers(vertices);
}

}  // namespace

absl::StatusOr<std::vector<std::string>> ReplaceMissingVisuals(MjcfFile& model, bool pictures) {
  std::map<std::string, std::string> missing_meshes;  // name -> file
  std::set<std::string> colliding_meshes;
  VisitElements(model.Section("worldbody"), [&](XMLElement* element) {
    if (std::strcmp(element->Name(), "geom") == 0 && Collides(element))
      colliding_meshes.insert(Attribute(element, "mesh"));
  });
  std::vector<std::string> files;
  std::error_code ignored;
  XMLElement* asset = model.Section("asset");
  for (XMLElement* item = asset->FirstChildElement(); item; item = item->NextSiblingElement()) {
    const std::string file = Attribute(item, "file");
    const bool drawn = std::strcmp(item->Name(), "texture") == 0 ||
                       (std::strcmp(item->Name(), "mesh") == 0 &&
                        colliding_meshes.count(Attribute(item, "name")) == 0);
    if (file.empty() || ((pictures || !drawn) && std::filesystem::exists(file, ignored))) continue;
    files.push_back(file);
    item->DeleteAttribute("file");
    if (std::strcmp(item->Name(), "mesh") == 0) {
      missing_meshes[Attribute(item, "name")] = file;
      item->SetAttribute("vertex", BoxInPlaceOf(file).c_str());
    } else if (std::strcmp(item->Name(), "texture") == 0) {
      for (const char* attribute : {"gridsize", "gridlayout", "fileright", "fileleft", "fileup",
                                    "filedown", "filefront", "fileback"}) {
        item->DeleteAttribute(attribute);
      }
      item->SetAttribute("builtin", "flat");
      item->SetAttribute("rgb1", ColourFor(file));
      item->SetAttribute("rgb2", ColourFor(file));
      item->SetAttribute("width", "8");
      item->SetAttribute("height", "8");
    } else {
      return absl::NotFoundError(
          absl::StrCat(file, ": missing, and a <", item->Name(), "> cannot be replaced"));
    }
  }
  for (const auto& [mesh, file] : missing_meshes) {
    if (colliding_meshes.count(mesh) == 0) continue;
    return absl::NotFoundError(
        absl::StrCat("collision mesh '", mesh, "' is missing: ", file,
                     "; physics cannot go on without it, complete the checkout"));
  }
  return files;
}

}  // namespace robostress::libero
