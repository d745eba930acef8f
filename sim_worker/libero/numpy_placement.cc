#include "sim_worker/libero/numpy_placement.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "sim_worker/robosuite_rotation.h"

namespace robostress::libero {
namespace {

constexpr int kArmJoints = 7;
constexpr int kTries = 5000;            // per object
constexpr int kFailedResets = 100;      // before a scene counts as impossible
constexpr double kObjectHeight = 0.01;  // [m] above the workspace or the object below

absl::Status AtomError(const LiberoScene& scene, const BddlAtom& atom, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(scene.problem.file, ":", atom.line, ": ", what));
}

const LiberoObject* FindObject(const LiberoScene& scene, const std::string& name) {
  const auto object = scene.objects.find(name);
  return object == scene.objects.end() ? nullptr : &object->second;
}

// The samplers' quaternion of a turn. For objects they build x y z w and hand it on as w x y z.
std::array<double, 4> TurnXyzw(char axis, double angle) {
  std::array<double, 4> quat = {0, 0, 0, std::cos(angle / 2)};
  quat[axis - 'x'] = std::sin(angle / 2);
  return quat;
}

// q1 * q0, both x y z w (utils/transform_utils.py, quat_multiply), rounded to single precision.
std::array<double, 4> MultiplyXyzw(const std::array<double, 4>& q1,
                                   const std::array<double, 4>& q0) {
  const auto [x0, y0, z0, w0] = q0;
  const auto [x1, y1, z1, w1] = q1;
  std::array<double, 4> product = {
      x1 * w0 + y1 * z0 - z1 * y0 + w1 * x0, -x1 * z0 + y1 * w0 + z1 * x0 + w1 * y0,
      x1 * y0 - y1 * x0 + z1 * w0 + w1 * z0, -x1 * x0 - y1 * y0 - z1 * z0 + w1 * w0};
  for (double& element : product) element = static_cast<float>(element);
  return product;
}

}  // namespace

absl::StatusOr<NumpyPlacement> NumpyPlacement::Create(const LiberoScene& scene, uint32_t seed,
                                                      int resets_before) {
  NumpyPlacement result(scene, seed);
  result.models_loaded_ += resets_before;
  for (const BddlAtom& atom : scene.problem.init) RS_RETURN_IF_ERROR(result.AddAtom(atom));
  RS_RETURN_IF_ERROR(result.CheckOrder());
  if (!result.on_sites_.empty() || !result.in_sites_.empty()) result.PrepareKinematics();
  return result;
}

absl::Status NumpyPlacement::AddAtom(const BddlAtom& atom) {
  if (atom.arguments.size() == 1) return AddJointDraw(atom);
  if (atom.arguments.size() != 2 || (atom.predicate != "on" && atom.predicate != "in"))
    return absl::OkStatus();  // the originals pass over it, here and below
  const BddlRegion* region = scene_->problem.FindRegion(atom.arguments[1]);
  const LiberoObject* below = FindObject(*scene_, atom.arguments[1]);
  const bool on_object = atom.predicate == "on" && below != nullptr && !below->fixture;
  if (!on_object && region == nullptr) return absl::OkStatus();
  const LiberoObject* object = FindObject(*scene_, atom.arguments[0]);
  if (object == nullptr) {
    return AtomError(*scene_, atom,
                     absl::StrCat("'", atom.arguments[0], "' is not an object of this file"));
  }
  if (!on_object) return AddPlacement(atom, *object, *region);
  on_objects_.push_back({.object = object,
                         .ranges = {{0, 0, 0, 0}},
                         .z_offset = kObjectHeight,
                         .must_be_free = false,
                         .reference = below});
  return absl::OkStatus();
}

absl::Status NumpyPlacement::AddJointDraw(const BddlAtom& atom) {
  const bool is_switch = atom.predicate == "turnon" || atom.predicate == "turnoff";
  if (!is_switch && atom.predicate != "open" && atom.predicate != "close") return absl::OkStatus();
  const auto site = scene_->sites.find(atom.arguments[0]);
  const bool is_site = site != scene_->sites.end();
  const LiberoObject* object =
      FindObject(*scene_, is_site ? site->second.parent : atom.arguments[0]);
  if (object == nullptr) return absl::OkStatus();
  const Articulation* parts = object->articulation;
  if (parts == nullptr || parts->has_switch != is_switch) {
    return AtomError(*scene_, atom,
                     absl::StrCat("'", atom.arguments[0], "' cannot ", atom.predicate));
  }
  const Articulation::Range range = atom.predicate == "open"     ? parts->open_range
                                    : atom.predicate == "close"  ? parts->close_range
                                    : atom.predicate == "turnon" ? parts->on_range
                                                                 : parts->off_range;
  joint_draws_.push_back({is_site ? site->second.joints : object->joints, range});
  return absl::OkStatus();
}

absl::Status NumpyPlacement::AddPlacement(const BddlAtom& atom, const LiberoObject& object,
                                          const BddlRegion& region) {
  const bool on_workspace = FindObject(*scene_, region.target) == nullptr;
  if (on_workspace && atom.predicate == "on") {
    if (region.ranges.empty())
      return AtomError(*scene_, atom, absl::StrCat("'", region.name, "' has no :ranges"));
    const ProblemClass& problem = scene_->problem_class;
    on_workspace_.push_back(
        {.object = &object,
         .ranges = region.ranges,
         .inset = problem.draws_inset && !object.fixture ? object.horizontal_radius : 0,
         .z_offset = object.fixture ? problem.fixture_z : kObjectHeight,
         .must_be_free = !object.fixture,
         .yaw = region.yaw});
    return absl::OkStatus();
  }
  RS_ASSIGN_OR_RETURN(Placement placement, OnSite(atom, object, region));
  (atom.predicate == "on" ? on_sites_ : in_sites_).push_back(std::move(placement));
  return absl::OkStatus();
}

absl::StatusOr<NumpyPlacement::Placement> NumpyPlacement::OnSite(const BddlAtom& atom,
                                                                 const LiberoObject& object,
                                                                 const BddlRegion& region) const {
  const auto site = scene_->sites.find(region.name);
  const LiberoObject* reference = FindObject(*scene_, region.target);
  if (object.fixture || site == scene_->sites.end() || reference == nullptr) {
    return AtomError(*scene_, atom,
                     absl::StrCat("only movable objects start at the site of an object, not '",
                                  object.name, "' at '", region.name, "'"));
  }
  Placement placement{.object = &object, .ranges = {{0, 0, 0, 0}}, .reference = reference};
  placement.site = site->second.site;
  placement.on_top = atom.predicate == "on";
  if (placement.on_top) {
    const double* size = scene_->model->site_size + 3 * placement.site;
    placement.ranges[0] = {-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2};
    placement.inset = object.horizontal_radius;
  }
  return placement;
}

// Every reference is placed before what refers to it, and nothing is placed twice.
absl::Status NumpyPlacement::CheckOrder() const {
  std::set<const LiberoObject*> placed;
  for (const auto* group : {&on_workspace_, &on_sites_, &in_sites_, &on_objects_}) {
    for (const Placement& placement : *group) {
      const LiberoObject* reference = placement.reference;
      if (reference != nullptr && placed.count(reference) == 0) {
        return absl::InvalidArgumentError(
            absl::StrCat(scene_->problem.file, ": (:init: '", placement.object->name,
                         "' is placed before '", reference->name, "', which it stands on"));
      }
      if (!placed.insert(placement.object).second) {
        return absl::InvalidArgumentError(absl::StrCat(
            scene_->problem.file, ": (:init: '", placement.object->name, "' is placed twice"));
      }
    }
  }
  return absl::OkStatus();
}

void NumpyPlacement::PrepareKinematics() {
  model_ = CopyWithoutTextures(*scene_->model);
  // Kinematics needs no contacts, constraints or stack; with robosuite's sizes mjData has 308 MB.
  model_->nconmax = model_->njmax = 1;
  model_->nstack = 1024;
  data_.reset(mj_makeData(model_.get()), mj_deleteData);
}

absl::StatusOr<ResetDraw> NumpyPlacement::Reset() {
  const mjModel& model = *scene_->model;
  for (int failed = 0; failed < kFailedResets; ++failed) {
    ResetDraw draw{.qpos = {model.qpos0, model.qpos0 + model.nq}};
    std::copy(kHomePosture.begin(), kHomePosture.end(), draw.qpos.begin());
    std::copy(kHomeFingers.begin(), kHomeFingers.end(), draw.qpos.begin() + kArmJoints);
    ++models_loaded_;
    for (int i = 0; i < kArmJoints; ++i) random_.Randn();
    DrawJoints(draw.qpos);
    Poses placed;
    bool complete = true;
    for (const auto* group : {&on_workspace_, &on_sites_, &in_sites_, &on_objects_}) {
      for (const Placement& placement : *group) complete = complete && Place(placement, placed);
    }
    if (!complete) continue;
    for (const auto& [name, pose] : placed) {
      if (pose.object->fixture) {
        draw.fixtures.push_back({name, pose.pos, pose.quat});
        continue;
      }
      double* qpos = draw.qpos.data() + model.jnt_qposadr[pose.object->joints.back()];
      std::copy(pose.quat.begin(), pose.quat.end(),
                std::copy(pose.pos.begin(), pose.pos.end(), qpos));
    }
    return draw;
  }
  return absl::ResourceExhaustedError(
      absl::StrCat(scene_->problem.file, ": ", kFailedResets,
                   " resets in a row found no room for an object; are its regions too small?"));
}

void NumpyPlacement::DrawJoints(std::vector<double>& qpos) {
  for (int load = 0; load < models_loaded_; ++load) {
    for (const JointDraw& draw : joint_draws_) {
      const double coordinate = random_.Uniform(draw.range[0], draw.range[1]);
      for (const int joint : draw.joints) qpos[scene_->model->jnt_qposadr[joint]] = coordinate;
    }
  }
  if (data_ == nullptr) return;
  std::copy(qpos.begin(), qpos.end(), data_->qpos);
  mj_kinematics(model_.get(), data_.get());
}

std::array<double, 3> NumpyPlacement::BaseOf(const Placement& placement,
                                             const Poses& placed) const {
  if (placement.reference == nullptr) return scene_->problem_class.workspace_offset;
  std::array<double, 3> base = placed.at(placement.reference->name).pos;
  if (placement.on_top) base[2] += placement.reference->top;
  return base;
}

bool NumpyPlacement::Place(const Placement& placement, Poses& placed) {
  const LiberoObject& object = *placement.object;
  const std::array<double, 3> base = BaseOf(placement, placed);
  // The originals turn the site's position in the world, where the reference is not yet placed, by
  // the rotation that was drawn for the reference.
  Eigen::Vector3d site = Eigen::Vector3d::Zero();
  if (placement.site >= 0) {
    const std::array<double, 4>& quat = placed.at(placement.reference->name).quat;
    site = SinglePrecisionMatrix(Eigen::Map<const Eigen::Vector4d>(quat.data())) *
           Eigen::Map<const Eigen::Vector3d>(data_->site_xpos + 3 * placement.site);
  }
  for (int attempt = 0; attempt < kTries; ++attempt) {
    const std::array<double, 4>& range =
        placement.ranges[random_.Randint(static_cast<int>(placement.ranges.size()))];
    const double inset = placement.inset;
    const double x = random_.Uniform(range[0] + inset, range[2] - inset) + base[0] + site[0];
    const double y = random_.Uniform(range[1] + inset, range[3] - inset) + base[1] + site[1];
    const double z = placement.z_offset + base[2] + site[2] - object.bottom;
    const auto overlaps = [&](const auto& entry) {
      const auto& [other, pos, quat] = entry.second;
      const double dx = x - pos[0], dy = y - pos[1];
      return std::sqrt(dx * dx + dy * dy) <= other->horizontal_radius + object.horizontal_radius &&
             z - pos[2] <= other->top - object.bottom;
    };
    if (placement.must_be_free && std::any_of(placed.begin(), placed.end(), overlaps)) continue;
    placed[object.name] = {&object, {x, y, z}, DrawQuaternion(placement)};
    return true;
  }
  return false;
}

std::array<double, 4> NumpyPlacement::DrawQuaternion(const Placement& placement) {
  const auto angle = [this](double a, double b) {
    return random_.Uniform(std::min(a, b), std::max(a, b));
  };
  if (placement.object->fixture) {
    const double yaw = angle(placement.yaw[0], placement.yaw[1]);
    return {std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)};
  }
  const auto draw = [&](const PlacementRotation::Turn& turn) {
    return TurnXyzw(turn.axis, angle(turn.low, turn.high));
  };
  const auto& turns = placement.object->rotation.turns;
  const std::array<double, 4> first = draw(turns[0]);
  if (turns[1].axis == 0) return first;
  std::array<double, 4> product = MultiplyXyzw(first, {0, 0, 0, 1});
  for (size_t i = 1; i < turns.size() && turns[i].axis != 0; ++i)
    product = MultiplyXyzw(draw(turns[i]), product);
  return product;
}

}  // namespace robostress::libero
