#include "common/models/xacro.h"

#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace robostress {
namespace {

using tinyxml2::XMLElement;

class XacroFinder : public tinyxml2::XMLVisitor {
 public:
  bool VisitEnter(const XMLElement& e, const tinyxml2::XMLAttribute* attribute) override {
    if (absl::StartsWith(e.Name(), "xacro:")) Take(e, absl::StrCat("<", e.Name(), ">"));
    for (; attribute != nullptr; attribute = attribute->Next())
      if (absl::StrContains(attribute->Value(), "${") ||
          absl::StrContains(attribute->Value(), "$("))
        Take(e, absl::StrCat(attribute->Name(), "='", attribute->Value(), "'"));
    return where_ == nullptr;
  }
  const XMLElement* where() const { return where_; }
  const std::string& what() const { return what_; }

 private:
  void Take(const XMLElement& e, const std::string& what) {
    if (where_ == nullptr) where_ = &e, what_ = what;
  }
  const XMLElement* where_ = nullptr;
  std::string what_;
};

}  // namespace

absl::Status RefuseXacro(const XmlFile& file) {
  XacroFinder finder;
  file.root().Accept(&finder);
  if (finder.where() == nullptr) return absl::OkStatus();
  const std::string from = std::filesystem::path(file.name()).filename().string();
  std::string to(absl::StripSuffix(from, ".xacro"));
  if (to == from || !absl::EndsWith(to, ".urdf"))
    to = std::filesystem::path(to).stem().string() + (to == from ? "_expanded.urdf" : ".urdf");
  return file.Error(
      *finder.where(),
      absl::StrCat(finder.what(), " is xacro, a recipe of a model; expand it, `xacro ", from, " > ",
                   to, "`, and name ", to, " in the rig"));
}

}  // namespace robostress
