#include "sim_worker/libero/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/random.h"
#include "common/status_macros.h"
#include "sim_worker/libero/mjcf.h"
#include "sim_worker/libero/object_file.h"

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

bool OnWorkspace(const ProblemClass& problem, const BddlRegion& region) {
  return region.name.find(problem.region_marker) != std::string::npos;
}

// The arena: LIBERO's scene file with its table placed, textures chosen, cameras set and regions
// added.
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

// What composition learns of an object before the model is compiled.
struct Part {
  LiberoObject object;
  std::vector<std::string> joints;
  std::vector<std::string> contact_geoms;
};

// Loads an object's file and appends its body to the world.
absl::StatusOr<Part> AddObject(const LiberoPaths& paths, const BddlProblem& bddl,
                               const BddlGroup& group, const std::string& instance, bool fixture,
                               MjcfFile& model, std::map<std::string, SiteOwner>& sites) {
  absl::StatusOr<std::string> path = FindObjectFile(paths, group.category);
  if (!path.ok()) {
    return absl::NotFoundError(
        absl::StrCat(bddl.file, ":", group.line, ": ", path.status().message()));
  }
  RS_ASSIGN_OR_RETURN(ObjectFile file, ObjectFile::Load(*path, instance, fixture));
  Part part;
  part.object.name = instance;
  part.object.category = group.category;
  part.object.fixture = fixture;
  part.object.articulation = FindArticulation(group.category);
  part.object.bottom = file.bottom();
  part.object.top = file.top();
  part.object.horizontal_radius = file.horizontal_radius();
  RS_ASSIGN_OR_RETURN(part.object.rotation, FindPlacementRotation(group.category, *path));
  part.joints = file.joints();
  part.contact_geoms = file.contact_geoms();
  for (const auto& [name, owner] : file.sites()) sites[name] = owner;
  MergeAssets(model.Section("asset"), file.asset());
  AppendCopy(model.Section("worldbody"), file.body());
  return part;
}

absl::StatusOr<int> Id(const mjModel& model, mjtObj type, const std::string& name) {
  const int id = mj_name2id(&model, type, name.c_str());
  if (id < 0)
    return absl::InternalError(
        absl::StrCat("the compiled scene has no ", mju_type2Str(type), " '", name, "'"));
  return id;
}

absl::Status ResolveParts(std::vector<Part>& parts, const std::map<std::string, SiteOwner>& sites,
                          LiberoScene& scene) {
  const mjModel& model = *scene.model;
  for (Part& part : parts) {
    LiberoObject& object = part.object;
    RS_ASSIGN_OR_RETURN(object.body, Id(model, mjOBJ_BODY, object.name + "_main"));
    for (const std::string& name : part.joints) {
      RS_ASSIGN_OR_RETURN(int joint, Id(model, mjOBJ_JOINT, name));
      object.joints.push_back(joint);
    }
    object.contact_geom.assign(model.ngeom, 0);
    for (const std::string& name : part.contact_geoms) {
      RS_ASSIGN_OR_RETURN(int geom, Id(model, mjOBJ_GEOM, name));
      object.contact_geom[geom] = 1;
    }
    scene.objects[object.name] = object;
  }
  for (const BddlRegion& region : scene.problem.regions) {
    LiberoSite site;
    site.name = region.name;
    if (!OnWorkspace(scene.problem_class, region)) {
      const auto owner = sites.find(region.name);
      if (owner == sites.end()) continue;  // LIBERO's files name regions of absent objects
      site.parent = owner->second.parent;
      for (const std::string& name : owner->second.joints) {
        RS_ASSIGN_OR_RETURN(int joint, Id(model, mjOBJ_JOINT, name));
        site.joints.push_back(joint);
      }
    }
    RS_ASSIGN_OR_RETURN(site.site, Id(model, mjOBJ_SITE, region.name));
    scene.sites[site.name] = site;
  }
  return absl::OkStatus();
}

// Calls `pose` with (fixture, region, z) for every fixture that an init atom places on the
// workspace.
template <class F>
void ForEachPlacedFixture(const LiberoScene& scene, const F& pose) {
  for (const BddlAtom& atom : scene.problem.init) {
    if (atom.predicate != "on" || atom.arguments.size() != 2) continue;
    const auto object = scene.objects.find(atom.arguments[0]);
    const BddlRegion* region = scene.problem.FindRegion(atom.arguments[1]);
    if (object == scene.objects.end() || !object->second.fixture || region == nullptr ||
        region->ranges.empty())
      continue;
    pose(object->first, *region);
  }
}

FixturePose MakePose(const ProblemClass& problem, const std::string& fixture, double x, double y,
                     double z, double yaw) {
  return {fixture,
          {x + problem.workspace_offset[0], y + problem.workspace_offset[1], z},
          {std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)}};
}

const FixturePose* FindPose(const std::vector<FixturePose>& poses, const std::string& fixture) {
  for (const FixturePose& pose : poses) {
    if (pose.fixture == fixture) return &pose;
  }
  return nullptr;
}

// MuJoCo's errors count lines of the composed text, which nobody sees: the line is quoted, its
// names begin with the instance whose file is at fault.
absl::StatusOr<SharedModel> CompileScene(const BddlProblem& bddl, MjcfFile& model) {
  tinyxml2::XMLPrinter printer;
  model.document().Print(&printer);
  absl::StatusOr<SharedModel> compiled = CompileModel(bddl.file, printer.CStr());
  if (compiled.ok()) return compiled;
  constexpr std::string_view kMarks[] = {", line ", ", line = "};
  const std::string message(compiled.status().message());
  const std::vector<std::string> lines = absl::StrSplit(printer.CStr(), '\n');
  size_t number = 0;
  for (const std::string_view mark : kMarks) {
    const size_t at = message.find(mark);
    if (at == std::string::npos) continue;
    const std::string digits = message.substr(at + mark.size());
    if (absl::SimpleAtoi(digits.substr(0, digits.find_first_not_of("0123456789")), &number)) break;
  }
  if (number < 1 || number > lines.size()) return compiled;
  return absl::Status(
      compiled.status().code(),
      absl::StrCat(
          message, "\nin the composed scene: ", absl::StripAsciiWhitespace(lines[number - 1]),
          "\nnames begin with robot0_, gripper0_, mount0_ or the instance of the BDDL file: "
          "correct that part's MJCF file"));
}

std::shared_ptr<mjModel> CopyModel(const mjModel& model) {
  return std::shared_ptr<mjModel>(mj_copyModel(nullptr, &model),
                                  [](mjModel* m) { mj_deleteModel(m); });
}

}  // namespace

absl::StatusOr<LiberoScene> ComposeScene(const LiberoPaths& paths, BddlProblem problem) {
  LiberoScene scene;
  scene.problem = std::move(problem);
  const BddlProblem& bddl = scene.problem;
  absl::StatusOr<ProblemClass> problem_class = FindProblemClass(bddl.name);
  if (!problem_class.ok())
    return absl::NotFoundError(absl::StrCat(bddl.file, ": ", problem_class.status().message()));
  scene.problem_class = *problem_class;

  RS_ASSIGN_OR_RETURN(MjcfFile model, MjcfFile::Load(paths.robosuite + "/base.xml"));
  XMLElement* option = model.Section("option");
  option->SetAttribute("timestep", "0.002");
  RS_ASSIGN_OR_RETURN(MjcfFile arena, MakeArena(paths, bddl, scene.problem_class));
  MergeFile(model, model.Section("worldbody"), arena);
  RS_ASSIGN_OR_RETURN(MjcfFile robot, MakeRobot(paths, scene.problem_class));
  MergeFile(model, model.Section("worldbody"), robot);

  std::vector<Part> parts;
  std::map<std::string, SiteOwner> sites;
  for (const bool fixture : {false, true}) {
    for (const BddlGroup& group : fixture ? bddl.fixtures : bddl.objects) {
      if (fixture && group.category == scene.problem_class.workspace) continue;
      for (const std::string& instance : group.instances) {
        RS_ASSIGN_OR_RETURN(Part part,
                            AddObject(paths, bddl, group, instance, fixture, model, sites));
        parts.push_back(std::move(part));
      }
    }
  }
  RS_ASSIGN_OR_RETURN(scene.missing_visuals, ReplaceMissingVisuals(model));
  std::set<std::string> replaced_meshes;
  XMLElement* asset = model.Section("asset");
  for (XMLElement* mesh = asset->FirstChildElement("mesh"); mesh;
       mesh = mesh->NextSiblingElement("mesh")) {
    if (mesh->Attribute("vertex") != nullptr) replaced_meshes.insert(Attribute(mesh, "name"));
  }
  RS_ASSIGN_OR_RETURN(scene.model, CompileScene(bddl, model));
  for (int geom = 0; geom < scene.model->ngeom; ++geom) {
    const int mesh = scene.model->geom_dataid[geom];
    if (scene.model->geom_type[geom] != mjGEOM_MESH || mesh < 0) continue;
    const char* name = mj_id2name(scene.model.get(), mjOBJ_MESH, mesh);
    if (name != nullptr && replaced_meshes.count(name) > 0) scene.replaced_geoms.push_back(geom);
  }
  RS_RETURN_IF_ERROR(ResolveParts(parts, sites, scene));
  ForEachPlacedFixture(scene, [&](const std::string& fixture, const BddlRegion& region) {
    const double bottom = scene.objects.at(fixture).bottom;
    const std::array<double, 4>& range = region.ranges[0];
    const double z =
        scene.problem_class.fixture_z + scene.problem_class.workspace_offset[2] - bottom;
    scene.centred_fixtures.push_back(MakePose(scene.problem_class, fixture,
                                              (range[0] + range[2]) / 2, (range[1] + range[3]) / 2,
                                              z, (region.yaw[0] + region.yaw[1]) / 2));
  });
  return scene;
}

std::vector<FixturePose> SampleFixtures(const LiberoScene& scene, uint64_t key) {
  std::vector<FixturePose> poses;
  ForEachPlacedFixture(scene, [&](const std::string& fixture, const BddlRegion& region) {
    RandomStream random(
        StreamKey("libero fixture pose").With(static_cast<int64_t>(key)).With(fixture));
    const std::array<double, 4>& range =
        region.ranges[random.UniformInt(static_cast<int>(region.ranges.size()))];
    const double x = random.Uniform(range[0], range[2]);
    const double y = random.Uniform(range[1], range[3]);
    const double yaw = random.Uniform(region.yaw[0], region.yaw[1]);
    const FixturePose* centred = FindPose(scene.centred_fixtures, fixture);
    poses.push_back(MakePose(scene.problem_class, fixture, x, y, centred->pos[2], yaw));
  });
  return poses;
}

absl::Status MoveFixtures(const LiberoScene& scene, const std::vector<FixturePose>& poses,
                          mjModel& model) {
  for (const FixturePose& pose : poses) {
    const auto object = scene.objects.find(pose.fixture);
    if (object == scene.objects.end() || !object->second.fixture) {
      return absl::NotFoundError(
          absl::StrCat("'", pose.fixture, "' is not a fixture of ", scene.problem.file));
    }
    const int body = object->second.body;
    std::copy(pose.pos.begin(), pose.pos.end(), model.body_pos + 3 * body);
    std::copy(pose.quat.begin(), pose.quat.end(), model.body_quat + 4 * body);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<mjModel>> PlaceFixtures(const LiberoScene& scene,
                                                       const std::vector<FixturePose>& poses) {
  std::shared_ptr<mjModel> model = CopyModel(*scene.model);
  if (model == nullptr) return absl::ResourceExhaustedError("no memory for a copy of the model");
  RS_RETURN_IF_ERROR(MoveFixtures(scene, poses, *model));
  return model;
}

std::shared_ptr<mjModel> MakeSimulationModel(const mjModel& model, const double* qpos) {
  std::shared_ptr<mjModel> copy = CopyModel(model);
  if (copy == nullptr) return nullptr;
  copy->njmax = std::min(copy->njmax, kMaxConstraints);
  for (int joint = 0; joint < copy->njnt; ++joint) {
    if (copy->jnt_type[joint] != mjJNT_FREE) continue;
    const int address = copy->jnt_qposadr[joint];
    std::copy(qpos + address, qpos + address + 7, copy->qpos0 + address);
  }
  return copy;
}

absl::StatusOr<std::shared_ptr<mjModel>> MakeRenderModel(const LiberoScene& scene,
                                                         const mjModel& physics) {
  constexpr int kShown = 1, kHidden = 4;  // MuJoCo shows groups 0-2 by default
  std::shared_ptr<mjModel> model = CopyModel(physics);
  if (model == nullptr) return absl::ResourceExhaustedError("no memory for a copy of the model");
  std::vector<char> bare(model->nbody, 0);
  for (int geom : scene.replaced_geoms) bare[model->geom_bodyid[geom]] = 1;
  for (int geom = 0; geom < model->ngeom; ++geom) {
    const int body = model->geom_bodyid[geom];
    if (model->geom_group[geom] != 0) continue;
    if (!bare[body]) {
      model->geom_group[geom] = kHidden;
      continue;
    }
    // A plain colour per object: white for the robot, else a hue from the root body's name.
    const char* root = mj_id2name(model.get(), mjOBJ_BODY, model->body_rootid[body]);
    const std::string name = root == nullptr ? "" : root;
    float rgb[3] = {0.92f, 0.92f, 0.94f};
    if (absl::StrContains(name, "bowl")) {
      std::fill(rgb, rgb + 3, 0.15f);
    } else if (absl::StrContains(name, "cabinet") || absl::StrContains(name, "rack") ||
               absl::StrContains(name, "basket")) {
      rgb[0] = 0.50f, rgb[1] = 0.34f, rgb[2] = 0.22f;
    } else if (absl::StrContains(name, "stove") || absl::StrContains(name, "microwave")) {
      std::fill(rgb, rgb + 3, 0.42f);
    } else if (!absl::StrContains(name, "robot") && !absl::StrContains(name, "plate")) {
      RandomStream random(
          StreamKey("libero colour").With(name.substr(0, name.find_last_of("0123456789"))));
      for (float& channel : rgb) channel = static_cast<float>(random.Uniform(0.25, 0.9));
    }
    model->geom_group[geom] = kShown;
    model->geom_matid[geom] = -1;
    std::copy(rgb, rgb + 3, model->geom_rgba + 4 * geom);
    model->geom_rgba[4 * geom + 3] = 1.0f;
  }
  for (int geom : scene.replaced_geoms) model->geom_group[geom] = kHidden;
  for (int site = 0; site < model->nsite; ++site) model->site_rgba[4 * site + 3] = 0;
  return model;
}

}  // namespace robostress::libero
