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
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "common/check.h"
#include "common/random.h"
#include "common/status_macros.h"
#include "sim_worker/libero/mjcf.h"
#include "sim_worker/libero/object_file.h"
#include "sim_worker/libero/scene_parts.h"
#include "sim_worker/libero/task_doubts.h"

namespace robostress::libero {
namespace {

using tinyxml2::XMLElement;

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
  model.AddSource(*path);
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
absl::StatusOr<SharedModel> CompileScene(const BddlProblem& bddl, const std::string& mjcf) {
  absl::StatusOr<SharedModel> compiled = CompileModel(bddl.file, mjcf);
  if (compiled.ok()) return compiled;
  constexpr std::string_view kMarks[] = {", line ", ", line = "};
  const std::string message(compiled.status().message());
  const std::vector<std::string> lines = absl::StrSplit(mjcf, '\n');
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
          "correct that part's MJCF file, or what it reads"));
}

std::shared_ptr<mjModel> CopyModel(const mjModel& model) {
  return std::shared_ptr<mjModel>(mj_copyModel(nullptr, &model),
                                  [](mjModel* m) { mj_deleteModel(m); });
}

// What the textures' pixels take in a model's buffer: the next array begins behind them. MuJoCo
// ends the process when a copy's size differs.
int TextureBytes(const mjModel& model) {
  return static_cast<int>(reinterpret_cast<const char*>(model.mat_texid) -
                          reinterpret_cast<const char*>(model.tex_rgb));
}

}  // namespace

std::shared_ptr<mjModel> CopyWithoutTextures(const mjModel& model) {
  mjModel bare = model;  // its arrays are the model's
  bare.ntexdata = 0;
  bare.nbuffer -= TextureBytes(model);
  return CopyModel(bare);
}

absl::StatusOr<LiberoScene> ComposeScene(const LiberoPaths& paths, BddlProblem problem,
                                         bool pictures) {
  LiberoScene scene;
  scene.problem = std::move(problem);
  const BddlProblem& bddl = scene.problem;
  absl::StatusOr<ProblemClass> problem_class = FindProblemClass(bddl.name);
  if (!problem_class.ok())
    return absl::NotFoundError(absl::StrCat(bddl.file, ": ", problem_class.status().message()));
  scene.problem_class = *problem_class;
  RS_RETURN_IF_ERROR(CheckFixturesPlaced(bddl, scene.problem_class));

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
  scene.files.insert(model.sources().begin(), model.sources().end());
  VisitElements(model.Section("asset"), [&](XMLElement* element) {
    if (const char* file = element->Attribute("file")) scene.files.insert(file);
  });
  RS_ASSIGN_OR_RETURN(scene.missing_visuals, ReplaceMissingVisuals(model, pictures));
  std::set<std::string> replaced_meshes;
  XMLElement* asset = model.Section("asset");
  for (XMLElement* mesh = asset->FirstChildElement("mesh"); mesh;
       mesh = mesh->NextSiblingElement("mesh")) {
    if (mesh->Attribute("vertex") != nullptr) replaced_meshes.insert(Attribute(mesh, "name"));
  }
  tinyxml2::XMLPrinter printer;
  model.document().Print(&printer);
  scene.mjcf = printer.CStr();
  RS_ASSIGN_OR_RETURN(scene.model, CompileScene(bddl, scene.mjcf));
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
  std::shared_ptr<mjModel> model = CopyWithoutTextures(*scene.model);
  if (model == nullptr) return absl::ResourceExhaustedError("no memory for a copy of the model");
  RS_RETURN_IF_ERROR(MoveFixtures(scene, poses, *model));
  return model;
}

std::string PlacedMjcf(const LiberoScene& scene, const mjModel& model) {
  tinyxml2::XMLDocument document;
  RS_CHECK(document.Parse(scene.mjcf.c_str()) == tinyxml2::XML_SUCCESS);
  std::map<std::string, int> moved;  // bodies by name
  for (const FixturePose& pose : scene.centred_fixtures) {
    const int body = scene.objects.at(pose.fixture).body;
    moved[mj_id2name(&model, mjOBJ_BODY, body)] = body;
  }
  VisitElements(document.RootElement(), [&](XMLElement* element) {
    const char* name = element->Attribute("name");
    if (name == nullptr || std::string_view(element->Name()) != "body") return;
    const auto found = moved.find(name);
    if (found == moved.end()) return;
    for (const char* other : {"axisangle", "xyaxes", "zaxis", "euler"})
      element->DeleteAttribute(other);
    const double *pos = model.body_pos + 3 * found->second,
                 *quat = model.body_quat + 4 * found->second;
    element->SetAttribute("pos",
                          absl::StrFormat("%.17g %.17g %.17g", pos[0], pos[1], pos[2]).c_str());
    element->SetAttribute(
        "quat",
        absl::StrFormat("%.17g %.17g %.17g %.17g", quat[0], quat[1], quat[2], quat[3]).c_str());
  });
  tinyxml2::XMLPrinter printer;
  document.Print(&printer);
  return printer.CStr();
}

std::shared_ptr<mjModel> MakeSimulationModel(const mjModel& model, const double* qpos) {
  std::shared_ptr<mjModel> copy = CopyWithoutTextures(model);
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
  mjModel textured = physics;
  textured.ntexdata = scene.model->ntexdata;
  textured.tex_rgb = scene.model->tex_rgb;
  textured.nbuffer += TextureBytes(*scene.model) - TextureBytes(physics);
  std::shared_ptr<mjModel> model = CopyModel(textured);
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
