#include "common/models/xml_file.h"

#include <cmath>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace robostress {
namespace {

constexpr double kMostNumber = 1e6;  // no arm has a length, mass, inertia or torque beyond

}  // namespace

absl::StatusOr<XmlFile> XmlFile::Parse(const std::string& name, const std::string& text) {
  XmlFile file;
  file.name_ = name;
  file.document_ = std::make_unique<tinyxml2::XMLDocument>();
  if (file.document_->Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS)
    return absl::InvalidArgumentError(
        absl::StrCat(name, ":", file.document_->ErrorLineNum(),
                     ": does not load: is no XML that can be read: ", file.document_->ErrorStr()));
  if (file.document_->RootElement() == nullptr)
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": does not load: has no element; must be MJCF or URDF"));
  return file;
}

absl::Status XmlFile::Error(const tinyxml2::XMLElement& element, const std::string& what) const {
  return absl::InvalidArgumentError(absl::StrCat(name_, ":", element.GetLineNum(), ": ", what));
}

absl::StatusOr<std::vector<double>> XmlFile::Numbers(const tinyxml2::XMLElement& element,
                                                     const char* attribute,
                                                     std::vector<double> absent) const {
  if (element.Attribute(attribute) == nullptr) return absent;
  const std::string text = AttributeOf(element, attribute);
  std::vector<double> numbers;
  for (const auto& word : absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty())) {
    double number = 0;
    if (!absl::SimpleAtod(word, &number) || !(std::abs(number) <= kMostNumber))
      return Error(element, absl::StrCat("<", element.Name(), "> ", attribute, " is '", text,
                                         "', must be finite numbers of at most 1e6, as in 0.25"));
    numbers.push_back(number);
  }
  if (numbers.size() != absent.size())
    return Error(element, absl::StrCat("<", element.Name(), "> ", attribute, " is '", text,
                                       "', must be ", absent.size(), " numbers"));
  return numbers;
}

std::string AttributeOf(const tinyxml2::XMLElement& element, const char* name) {
  const char* value = element.Attribute(name);
  return value == nullptr ? "" : value;
}

}  // namespace robostress
