#include "sim_worker/libero/scene_parts.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

using tinyxml2::XMLElement;

constexpr double kZoneHalfHeight = 0.007;  // [m] of a workspace region's site
// Robosuite's arm: damping from LIBERO's robot classes, the rest from RobotModel (5 / (i + 1)
// armature).
constexpr std::array<double, 7> kJointDamping = {0.1, 0.1, 0.1, 0.1, 0.1, 0.01, 0.01};
constexpr double kJointFriction = 0.1;

template <size_t N>
void SetNumbers(XMLElement* element, const char* attribute, const std::array<double, N>& values) {
  element->SetAttribute(attribute, FormatNumbers({values.begin(), values.end()}).c_str());
}

absl::StatusOr<XMLElement*> Child(const MjcfFile& file, XMLElement* parent, const char* tag,
                                  const std::string& name) {
  XMLElement* child = FindChild(parent, tag, name);
  if (child != nullptr) return child;
  return absl::NotFoundError(absl::StrCat(file.path(), ": no <", tag, " name=\"", name,
                                          "\"> below <", parent->Name(), " name=\"",
                                          Attribute(parent, "name"), "\">"));
}

// Collision geoms get a flat colour and lose their material (robosuite's recolor_collision_geoms).
void Recolour(XMLElement* root, const char* rgba) {
  VisitElements(root, [&](XMLElement* element) {
    if (!IsTag(element, "geom") || !IsCollisionGroup(element) ||
        Attribute(element, "name") == "floor")
      return;
    element->SetAttribute("rgba", rgba);
    element->DeleteAttribute("material");
  });
}

void PlaceTableLegs(XMLElement* table, const std::array<double, 3>& half, double offset_z) {
  constexpr std::array<double, 4> kDx = {0.1, -0.1, -0.1, 0.1}, kDy = {0.1, 0.1, -0.1, -0.1};
  for (int i = 0; i < 4; ++i) {
    XMLElement* leg = FindChild(table, "geom", absl::StrCat("table_leg", i + 1, "_visual"));
    if (leg == nullptr) continue;
    const double x =
        half[0] > std::abs(kDx[i] * 2.0) ? std::copysign(1.0, kDx[i]) * half[0] - kDx[i] : 0;
    const double y =
        half[1] > std::abs(kDy[i] * 2.0) ? std::copysign(1.0, kDy[i]) * half[1] - kDy[i] : 0;
    const double z = (offset_z - half[2]) / 2.0;
    SetNumbers(leg, "pos", std::array<double, 3>{x, y, -z});
    SetNumbers(leg, "size", std::array<double, 2>{0.025, z});
  }
}

void ReplaceFileName(XMLElement* asset, const char* texture, std::string_view file_name) {
  XMLElement* element = FindChild(asset, "texture", texture);
  if (element == nullptr) return;
  const std::string file = Attribute(element, "file");
  const size_t slash = file.rfind('/');
  element->SetAttribute(
      "file", (file.substr(0, slash == std::string::npos ? 0 : slash + 1) + std::string(file_name))
                  .c_str());
}

// A robot part: unnamed geoms get robosuite's names, everything its prefix.
absl::StatusOr<MjcfFile> LoadPart(const std::string& path, const std::string& prefix,
                                  const char* rgba) {
  RS_ASSIGN_OR_RETURN(MjcfFile part, MjcfFile::Load(path));
  int visual = 0, collision = 0;
  VisitElements(part.root(), [&](XMLElement* element) {
    if (!IsTag(element, "geom") || element->Attribute("name") != nullptr) return;
    const std::string name = IsCollisionGroup(element) ? absl::StrCat("g", collision++, "_col")
                                                       : absl::StrCat("g", visual++, "_vis");
    element->SetAttribute("name", name.c_str());
  });
  AddPrefix(part.root(), prefix);
  Recolour(part.Section("worldbody"), rgba);
  return part;
}

}  // namespace

bool OnWorkspace(const ProblemClass& problem, const BddlRegion& region) {
  return region.name.find(problem.region_marker) != std::string::npos;
}

absl::StatusOr<MjcfFile> MakeArena(const LiberoPaths& paths, const BddlProblem& bddl,
                                   const ProblemClass& problem) {
  RS_ASSIGN_OR_RETURN(MjcfFile arena,
                      MjcfFile::Load(paths.libero + "/assets/" + std::string(problem.scene)));
  XMLElement* world = arena.Section("worldbody");
  Recolour(world, "0.5 0.5 0 1");
  RS_ASSIGN_OR_RETURN(XMLElement * body,
                      Child(arena, world, "body", std::string(problem.arena_body)));
  if (problem.has_table) {
    std::array<double, 3> half, centre = problem.workspace_offset;
    for (int i = 0; i < 3; ++i) half[i] = problem.table_size[i] / 2;
    centre[2] = -half[2] + problem.workspace_offset[2];
    if (XMLElement* floor = FindChild(world, "geom", "floor"))
      SetNumbers(floor, "pos", std::array<double, 3>{0, 0, 0});
    SetNumbers(body, "pos", centre);
    RS_ASSIGN_OR_RETURN(XMLElement * collision, Child(arena, body, "geom", "table_collision"));
    SetNumbers(collision, "size", half);
    SetNumbers(collision, "friction", problem.table_friction);
    RS_ASSIGN_OR_RETURN(XMLElement * visual, Child(arena, body, "geom", "table_visual"));
    SetNumbers(visual, "size", half);
    RS_ASSIGN_OR_RETURN(XMLElement * top, Child(arena, body, "site", "table_top"));
    SetNumbers(top, "pos", std::array<double, 3>{0, 0, half[2]});
    PlaceTableLegs(body, half, problem.workspace_offset[2]);
  }
  ReplaceFileName(arena.Section("asset"), "texplane", problem.floor_texture);
  ReplaceFileName(arena.Section("asset"), "tex-wall", problem.wall_texture);
  for (const CameraPlacement& placement : problem.cameras) {
    if (placement.name.empty()) break;
    const std::string name(placement.name);
    XMLElement* camera = FindElement(world, "camera", name);
    if (camera == nullptr) {
      camera = AppendNew(world, "camera");
      camera->SetAttribute("name", name.c_str());
    }
    SetNumbers(camera, "pos", placement.pos);
    SetNumbers(camera, "quat", placement.quat);
  }
  for (const BddlRegion& region : bddl.regions) {
    if (!OnWorkspace(problem, region)) continue;
    if (region.ranges.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(bddl.file, ":", region.line, ": region '",
                                                     region.name,
                                                     "' lies on the workspace and has no :ranges"));
    }
    const std::array<double, 4>& range = region.ranges[0];
    if (range[0] == range[2] || range[1] == range[3]) {
      return absl::InvalidArgumentError(
          absl::StrCat(bddl.file, ":", region.line, ": region '", region.name,
                       "' has a range without area, of which MuJoCo makes no site; :ranges are x0 "
                       "y0 x1 y1 [m] with x0 < x1 and y0 < y1"));
    }
    std::array<double, 3> pos = {(range[2] + range[0]) / 2, (range[3] + range[1]) / 2,
                                 problem.zone_z};
    if (problem.zone_at_workspace) {
      pos[0] += problem.workspace_offset[0];
      pos[1] += problem.workspace_offset[1];
    }
    XMLElement* site = AppendNew(body, "site");
    site->SetAttribute("name", region.name.c_str());
    SetNumbers(site, "pos", pos);
    site->SetAttribute("quat", "1 0 0 0");
    SetNumbers(site, "rgba", region.rgba);
    SetNumbers(site, "size",
               std::array<double, 3>{(range[2] - range[0]) / 2, (range[3] - range[1]) / 2,
                                     kZoneHalfHeight});
    site->SetAttribute("type", "box");
  }
  return arena;
}

absl::StatusOr<MjcfFile> MakeRobot(const LiberoPaths& paths, const ProblemClass& problem) {
  RS_ASSIGN_OR_RETURN(MjcfFile robot, LoadPart(paths.robosuite + "/robots/panda/robot.xml",
                                               "robot0_", "0 0.5 0 1"));
  int joint = 0;
  VisitElements(robot.Section("worldbody"), [&](XMLElement* element) {
    if (!IsTag(element, "joint") || joint >= 7) return;
    SetNumbers(element, "damping", std::array<double, 1>{kJointDamping[joint]});
    if (element->Attribute("frictionloss") == nullptr)
      SetNumbers(element, "frictionloss", std::array<double, 1>{kJointFriction});
    if (element->Attribute("armature") == nullptr)
      SetNumbers(element, "armature", std::array<double, 1>{5.0 / (joint + 1)});
    ++joint;
  });
  if (joint != 7)
    return absl::InvalidArgumentError(
        absl::StrCat(robot.path(), ": ", joint, " joints, expected a Panda's 7"));

  RS_ASSIGN_OR_RETURN(MjcfFile mount,
                      LoadPart(paths.robosuite + (problem.mounted ? "/mounts/rethink_mount.xml"
                                                                  : "/mounts/null_mount.xml"),
                               "mount0_", "0.5 0.5 0 1"));
  RS_ASSIGN_OR_RETURN(XMLElement * base,
                      Child(robot, robot.Section("worldbody"), "body", "robot0_base"));
  RS_ASSIGN_OR_RETURN(XMLElement * mount_base,
                      Child(mount, mount.Section("worldbody"), "body", "mount0_base"));
  RS_ASSIGN_OR_RETURN(std::vector<double> base_offset,
                      ReadNumbers(robot.path(), base, "pos", {0, 0, 0}));
  RS_ASSIGN_OR_RETURN(std::vector<double> mount_bottom,
                      ReadNumbers(mount.path(), mount_base, "pos", {0, 0, 0}));
  if (base_offset.size() != 3 || mount_bottom.size() != 3) {
    return absl::InvalidArgumentError(
        absl::StrCat(mount.path(), ": a pos attribute does not have 3 numbers"));
  }
  const std::array<double, 3> mount_top = {0, 0, problem.mounted ? -0.01 : 0.0};
  std::array<double, 3> mount_pos, base_pos;
  for (int i = 0; i < 3; ++i) {
    mount_pos[i] = base_offset[i] - mount_top[i];
    base_pos[i] = problem.robot_base[i] - ((mount_bottom[i] - mount_top[i]) + base_offset[i]);
  }
  SetNumbers(mount_base, "pos", mount_pos);
  MergeFile(robot, base, mount);
  RS_ASSIGN_OR_RETURN(MjcfFile gripper, LoadPart(paths.robosuite + "/grippers/panda_gripper.xml",
                                                 "gripper0_", "0 0 0.5 1"));
  XMLElement* hand = FindElement(robot.Section("worldbody"), "body", "robot0_right_hand");
  if (hand == nullptr)
    return absl::NotFoundError(absl::StrCat(robot.path(), ": no body 'right_hand'"));
  MergeFile(robot, hand, gripper);
  SetNumbers(base, "pos", base_pos);
  return robot;
}

}  // namespace robostress::libero
