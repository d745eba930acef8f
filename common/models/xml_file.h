#pragma once

#include <tinyxml2.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// A file of XML and how messages name places in it.
class XmlFile {
 public:
  // `text` of `name`; a refusal names file and line. Entities of a document's own are not expanded.
  static absl::StatusOr<XmlFile> Parse(const std::string& name, const std::string& text);

  const tinyxml2::XMLElement& root() const { return *document_->RootElement(); }
  tinyxml2::XMLDocument& document() const { return *document_; }
  const std::string& name() const { return name_; }
  // INVALID_ARGUMENT "FILE:LINE: what".
  absl::Status Error(const tinyxml2::XMLElement& element, const std::string& what) const;
  // The numbers of an attribute; `absent` where it is missing. They are finite and at most 1e6 in
  // size, and as many as `absent` has.
  absl::StatusOr<std::vector<double>> Numbers(const tinyxml2::XMLElement& element,
                                              const char* attribute,
                                              std::vector<double> absent) const;

 private:
  std::string name_;
  std::unique_ptr<tinyxml2::XMLDocument> document_;
};

// An attribute's text; empty where it is missing.
std::string AttributeOf(const tinyxml2::XMLElement& element, const char* name);

}  // namespace robostress
