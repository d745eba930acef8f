#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "sim_worker/libero/mjcf.h"

namespace robostress::libero {

// What LIBERO's SiteObject remembers of a site: who owns it and which joints move it.
struct SiteOwner {
  std::string parent;
  std::vector<std::string> joints;  // of the innermost body that holds the site
};

// The MJCF file of one object or fixture, prepared for merging as robosuite's MujocoXMLObject
// prepares it (robosuite 1.4, models/objects): names are those of the compiled scene, movable
// objects have their free joint.
class ObjectFile {
 public:
  // An error names `path` and what is missing or malformed in it, with the line.
  static absl::StatusOr<ObjectFile> Parse(const std::string& path, std::string_view text,
                                          const std::string& instance, bool fixture);
  static absl::StatusOr<ObjectFile> Load(const std::string& path, const std::string& instance,
                                         bool fixture);

  // The body that goes below the world's; owned by this file.
  const tinyxml2::XMLElement* body() const { return body_; }
  tinyxml2::XMLElement* asset() { return file_.Section("asset"); }
  // Extent for placement [m]: z of bottom and top above its origin, radius around it.
  double bottom() const { return bottom_; }
  double top() const { return top_; }
  double horizontal_radius() const { return horizontal_radius_; }
  const std::vector<std::string>& joints() const { return joints_; }  // in the file's order
  const std::vector<std::string>& contact_geoms() const { return contact_geoms_; }
  const std::map<std::string, SiteOwner>& sites() const { return sites_; }

 private:
  explicit ObjectFile(MjcfFile file) : file_(std::move(file)) {}
  absl::Status FindBody();
  // One coordinate of a marker site that only placement reads.
  absl::StatusOr<double> ReadMarker(const char* site, int axis);
  void NameGeoms();
  absl::Status CheckNames() const;
  void AddFreeJoint(const std::string& instance);
  void AddDefaultSite(const std::string& instance);

  MjcfFile file_;
  tinyxml2::XMLElement* wrapper_ = nullptr;  // holds the body and the sites of the placement
  tinyxml2::XMLElement* body_ = nullptr;
  double bottom_ = 0, top_ = 0, horizontal_radius_ = 0;
  std::vector<std::string> joints_, contact_geoms_;
  std::map<std::string, SiteOwner> sites_;
};

}  // namespace robostress::libero
