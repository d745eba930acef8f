#pragma once

#include <tinyxml2.h>

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress::libero {

// One MJCF file, prepared as robosuite prepares it before it merges files (robosuite 1.4,
// models/base.py): default classes are written into the elements that use them, asset files get
// absolute paths, every section exists.
class MjcfFile {
 public:
  static absl::StatusOr<MjcfFile> Load(const std::string& path);
  // `path` names the text in errors, with the line; asset files are relative to its folder.
  static absl::StatusOr<MjcfFile> Parse(const std::string& path, std::string_view text);
  const std::string& path() const { return path_; }
  tinyxml2::XMLElement* root() { return document_->RootElement(); }
  // The section's element, e.g. "worldbody", created when absent.
  tinyxml2::XMLElement* Section(const char* name);
  tinyxml2::XMLDocument& document() { return *document_; }
  // Its own path, then those of the files that were merged into it.
  const std::vector<std::string>& sources() const { return sources_; }
  void AddSource(const std::string& path) { sources_.push_back(path); }

 private:
  MjcfFile() = default;
  std::string path_;
  std::vector<std::string> sources_;
  std::unique_ptr<tinyxml2::XMLDocument> document_;
};

// An attribute's text; empty when the element does not have it.
std::string Attribute(const tinyxml2::XMLElement* element, const char* name);
bool IsTag(const tinyxml2::XMLElement* element, const char* tag);
// Collision geoms are those of group 0, MuJoCo's default.
bool IsCollisionGroup(const tinyxml2::XMLElement* geom);

// Calls `visit` for root and every element below it, parents first. The visited element may be
// changed, not removed.
void VisitElements(tinyxml2::XMLElement* root,
                   const std::function<void(tinyxml2::XMLElement*)>& visit);
// The first element, parents first, with this tag and this name attribute; nullptr if there is
// none.
tinyxml2::XMLElement* FindElement(tinyxml2::XMLElement* root, const char* tag,
                                  const std::string& name);
// Direct child with this tag and name.
tinyxml2::XMLElement* FindChild(tinyxml2::XMLElement* parent, const char* tag,
                                const std::string& name);
// Prefixes every attribute that names something, unless it starts with the prefix already.
void AddPrefix(tinyxml2::XMLElement* root, const std::string& prefix);
// Deep copy of `element` as the last child of `parent`, across documents. Returns the copy.
tinyxml2::XMLElement* AppendCopy(tinyxml2::XMLElement* parent, const tinyxml2::XMLElement* element);
tinyxml2::XMLElement* AppendNew(tinyxml2::XMLElement* parent, const char* tag);
// Copies the assets of `other` whose (tag, name) is not in `asset` yet: the first one wins.
void MergeAssets(tinyxml2::XMLElement* asset, tinyxml2::XMLElement* other);
// Robosuite's merge: children of other's worldbody below `body`, then assets, actuators, sensors,
// tendons, equalities and contacts. Other sections of `other` are dropped.
void MergeFile(MjcfFile& into, tinyxml2::XMLElement* body, MjcfFile& other);

// Numbers of an attribute; `fallback` when it is absent. An error names file, element and value.
absl::StatusOr<std::vector<double>> ReadNumbers(const std::string& file,
                                                const tinyxml2::XMLElement* element,
                                                const char* attribute,
                                                const std::vector<double>& fallback);
// Shortest text that reads back as the same doubles.
std::string FormatNumbers(const std::vector<double>& numbers);

// Replaces mesh and texture files that do not exist: a texture by a flat one of the same type, a
// mesh by a box with its bounding sphere (visual_bounds.h) or, where that is not known, of 2 cm.
// Returns the files. pictures = false: all that only pictures need, there or not. A missing mesh
// that a colliding geom uses is an error, because it would change the physics.
absl::StatusOr<std::vector<std::string>> ReplaceMissingVisuals(MjcfFile& model, bool pictures);

}  // namespace robostress::libero
