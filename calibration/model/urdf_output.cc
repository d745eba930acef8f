#include "calibration/model/urdf_output.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/models/urdf_parts.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using urdf::Joint;
using urdf::Link;
using urdf::Pose;
using urdf::Shape;

Vector3d VectorAt(const mjtNum* numbers, int index) {
  return Eigen::Map<const Vector3d>(numbers + 3 * index);
}
Isometry3d PoseAt(const mjtNum* positions, const mjtNum* quaternions, int index) {
  const mjtNum* q = quaternions + 4 * index;
  Isometry3d T = Isometry3d::Identity();
  T.translation() = VectorAt(positions, index);
  T.linear() = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
  return T;
}

// R = Rz(yaw) Ry(pitch) Rx(roll). Yaw follows from the roll that was chosen, so that nothing is
// lost where pitch is near 90 degrees.
Pose PoseOf(const Isometry3d& T) {
  const Eigen::Matrix3d R = T.linear();
  const double roll = std::atan2(R(2, 1), R(2, 2)), s = std::sin(roll), c = std::cos(roll);
  const double pitch = std::atan2(-R(2, 0), std::hypot(R(2, 1), R(2, 2)));
  const double yaw = std::atan2(s * R(0, 2) - c * R(0, 1), c * R(1, 1) - s * R(1, 2));
  const Vector3d p = T.translation();
  return {{p.x(), p.y(), p.z()}, {roll, pitch, yaw}};
}

std::string Number(double value) { return absl::StrFormat("%.17g", value); }

class UrdfWriter {
 public:
  UrdfWriter(const mjModel& model, std::string meshes)
      : model_(model), meshes_(std::move(meshes)), place_(static_cast<size_t>(model.nbody)) {}

  absl::StatusOr<UrdfOutput> Write() {
    RS_RETURN_IF_ERROR(CheckNumbers());
    NameAll();
    links_.emplace_back().name = body_names_[0];
    for (int body = 0; body < model_.nbody; ++body) AddBody(body);
    if (out_.joints.empty())
      return absl::InvalidArgumentError(
          loose_.empty()
              ? "no joint turns or slides"
              : absl::StrCat("no joint turns or slides but on bodies with a free joint (",
                             absl::StrJoin(loose_, ", "), "); take the free joint of the arm out"));
    for (int geom = 0; geom < model_.ngeom; ++geom) AddGeom(geom);
    AddSites();
    AddCouplings();
    AddEfforts();
    Describe();
    tinyxml2::XMLDocument document;
    document.Parse(urdf::Print(links_, joints_).c_str());
    tinyxml2::XMLPrinter lines;  // an element a line
    document.Print(&lines);
    out_.xml = lines.CStr();
    return std::move(out_);
  }

 private:
  // Where a body is: on which link, and where there. Loose: on none.
  struct Place {
    int link = 0;
    Isometry3d T_link_body = Isometry3d::Identity();
    bool loose = false;
  };

  std::string Named(mjtObj kind, int id) const {
    const char* name = mj_id2name(&model_, kind, id);
    if (name != nullptr && *name != '\0') return name;
    const char* const word = kind == mjOBJ_BODY    ? "body_"
                             : kind == mjOBJ_JOINT ? "joint_"
                             : kind == mjOBJ_SITE  ? "site_"
                             : kind == mjOBJ_GEOM  ? "geom_"
                                                   : "mesh_";
    return absl::StrCat(word, id);
  }
  static bool IsNumber(double value) { return std::abs(value) <= kMostNumber; }
  // MuJoCo compiles numbers that are none.
  absl::Status CheckNumbers() const {
    const auto check = [&](mjtObj kind, int count, const mjtNum* numbers, int each,
                           const char* what) {
      for (int i = 0; i < count * each; ++i)
        if (!IsNumber(numbers[i]))
          return absl::InvalidArgumentError(absl::StrFormat(
              "%s '%s': a number of its %s is %g, must be finite and at most %g in size",
              mju_type2Str(kind), Named(kind, i / each), what, numbers[i], kMostNumber));
      return absl::OkStatus();
    };
    const mjModel& m = model_;
    for (const absl::Status& status :
         {check(mjOBJ_BODY, m.nbody, m.body_pos, 3, "place"),
          check(mjOBJ_BODY, m.nbody, m.body_quat, 4, "orientation"),
          check(mjOBJ_BODY, m.nbody, m.body_mass, 1, "mass"),
          check(mjOBJ_BODY, m.nbody, m.body_ipos, 3, "centre of mass"),
          check(mjOBJ_BODY, m.nbody, m.body_iquat, 4, "inertia's orientation"),
          check(mjOBJ_BODY, m.nbody, m.body_inertia, 3, "inertia"),
          check(mjOBJ_JOINT, m.njnt, m.jnt_axis, 3, "axis"),
          check(mjOBJ_JOINT, m.njnt, m.jnt_pos, 3, "place"),
          check(mjOBJ_JOINT, m.njnt, m.jnt_range, 2, "range"),
          check(mjOBJ_GEOM, m.ngeom, m.geom_pos, 3, "place"),
          check(mjOBJ_GEOM, m.ngeom, m.geom_quat, 4, "orientation"),
          check(mjOBJ_GEOM, m.ngeom, m.geom_size, 3, "size"),
          check(mjOBJ_SITE, m.nsite, m.site_pos, 3, "place"),
          check(mjOBJ_SITE, m.nsite, m.site_quat, 4, "orientation")})
      RS_RETURN_IF_ERROR(status);
    for (int joint = 0; joint < m.njnt; ++joint) {
      const int dof = m.jnt_dofadr[joint];
      for (const double number :
           {m.qpos0[m.jnt_qposadr[joint]], m.dof_damping[dof], m.dof_frictionloss[dof]})
        if (!IsNumber(number))
          return absl::InvalidArgumentError(
              absl::StrFormat("joint '%s': its ref, damping or frictionloss is %g, must be finite "
                              "and at most %g in size",
                              Named(mjOBJ_JOINT, joint), number, kMostNumber));
    }
    return absl::OkStatus();
  }
  std::string NewLinkName(std::string name) {
    while (!names_.insert(name).second) name += "_link";
    return name;
  }
  // Of a joint that does not move.
  std::string FixedName(const std::string& link) {
    std::string name = absl::StrCat(link, "_fixed");
    while (!joint_names_in_use_.insert(name).second) name += "_";
    return name;
  }
  // A name that the file gives stays its own, whatever the nameless are called.
  std::vector<std::string> NamesOf(mjtObj kind, int count, std::set<std::string>* taken) const {
    std::vector<std::string> names(static_cast<size_t>(count));
    for (int id = 0; id < count; ++id) {
      const char* name = mj_id2name(&model_, kind, id);
      if (name != nullptr && *name != '\0' && taken->insert(name).second)
        names[static_cast<size_t>(id)] = name;
    }
    for (int id = 0; id < count; ++id) {
      std::string& name = names[static_cast<size_t>(id)];
      if (!name.empty()) continue;
      name = Named(kind, id);
      while (!taken->insert(name).second) name += kind == mjOBJ_SITE ? "_link" : "_";
    }
    return names;
  }
  // Bodies and sites are links, whose names differ.
  void NameAll() {
    body_names_ = NamesOf(mjOBJ_BODY, model_.nbody, &names_);
    site_names_ = NamesOf(mjOBJ_SITE, model_.nsite, &names_);
    joint_names_ = NamesOf(mjOBJ_JOINT, model_.njnt, &joint_names_in_use_);
  }

  // A link on another, and the joint between them.
  int AddLink(const std::string& name, const std::string& joint, int parent,
              const Isometry3d& T_parent_link) {
    const int link = static_cast<int>(links_.size());
    links_.emplace_back().name = name;
    Joint& between = joints_.emplace_back();
    between.name = joint;
    between.type = "fixed";
    between.parent = parent;
    between.child = link;
    between.origin = PoseOf(T_parent_link);
    return link;
  }

  void AddBody(int body) {
    Place& place = place_[static_cast<size_t>(body)];
    if (body == 0) return;
    const Place& parent = place_[static_cast<size_t>(model_.body_parentid[body])];
    const std::string name = body_names_[static_cast<size_t>(body)];
    const int first = model_.body_jntadr[body], count = model_.body_jntnum[body];
    const bool is_free = count == 1 && model_.jnt_type[first] == mjJNT_FREE;
    place.loose = parent.loose || is_free || model_.body_mocapid[body] >= 0;
    if (place.loose) {
      if (!parent.loose) loose_.push_back(name);
      return;
    }
    place.link = parent.link;
    place.T_link_body = parent.T_link_body * PoseAt(model_.body_pos, model_.body_quat, body);
    std::vector<int> moving;
    for (int id = first; id < first + count; ++id) {
      if (model_.jnt_type[id] == mjJNT_BALL)
        held_.push_back(Named(mjOBJ_JOINT, id));
      else
        moving.push_back(id);
    }
    if (moving.empty()) {
      place = {AddLink(name, FixedName(name), place.link, place.T_link_body),
               Isometry3d::Identity(), false};
    }
    for (const int id : moving)
      AddJoint(id,
               id == moving.back()
                   ? name
                   : NewLinkName(absl::StrCat(name, "_", joint_names_[static_cast<size_t>(id)])),
               place);
    AddInertia(body, place);
    out_.bodies.push_back(name);
  }

  void AddJoint(int id, const std::string& link, Place& place) {
    const bool slide = model_.jnt_type[id] == mjJNT_SLIDE;
    const Vector3d axis = VectorAt(model_.jnt_axis, id), anchor = VectorAt(model_.jnt_pos, id);
    const double ref = model_.qpos0[model_.jnt_qposadr[id]];
    Isometry3d origin = place.T_link_body * Eigen::Translation3d(anchor);
    if (slide)
      origin.translate(-ref * axis);
    else
      origin.rotate(Eigen::AngleAxisd(-ref, axis));
    place.link = AddLink(link, joint_names_[static_cast<size_t>(id)], place.link, origin);
    place.T_link_body = Isometry3d(Eigen::Translation3d(-anchor));
    Joint& joint = joints_.back();
    joint.type = slide ? "prismatic" : model_.jnt_limited[id] ? "revolute" : "continuous";
    joint.axis = {axis.x(), axis.y(), axis.z()};
    joint.moves = true;
    joint.limited = slide || model_.jnt_limited[id] != 0;
    joint.lower = model_.jnt_limited[id] ? model_.jnt_range[2 * id] : -kEndlessSlide;
    joint.upper = model_.jnt_limited[id] ? model_.jnt_range[2 * id + 1] : kEndlessSlide;
    joint.damping = model_.dof_damping[model_.jnt_dofadr[id]];
    joint.friction = model_.dof_frictionloss[model_.jnt_dofadr[id]];
    joint_of_[id] = joints_.size() - 1;
    out_.joints.push_back(joint.name);
    armature_ |= model_.dof_armature[model_.jnt_dofadr[id]] > 0;
    if (model_.jnt_stiffness[id] > 0) sprung_.push_back(joint.name);
  }

  void AddInertia(int body, const Place& place) {
    Link& link = links_[static_cast<size_t>(place.link)];
    link.mass = model_.body_mass[body];
    link.com = PoseOf(place.T_link_body * PoseAt(model_.body_ipos, model_.body_iquat, body));
    link.inertia = VectorAt(model_.body_inertia, body).asDiagonal();
  }

  bool Touches(int geom) const {
    return model_.geom_contype[geom] != 0 || model_.geom_conaffinity[geom] != 0;
  }

  void AddGeom(int geom) {
    const int body = model_.geom_bodyid[geom];
    const Place& place = place_[static_cast<size_t>(body)];
    if (place.loose) return;
    const int type = model_.geom_type[geom];
    if (type == mjGEOM_PLANE || type == mjGEOM_HFIELD) {
      ++planes_;
      return;
    }
    const int first = model_.body_geomadr[body], count = model_.body_geomnum[body];
    bool touched = false;
    for (int other = first; other < first + count; ++other)
      touched |= Touches(other) && model_.geom_type[other] != mjGEOM_PLANE;
    if (touched && !Touches(geom)) {
      ++seen_;
      return;
    }
    Isometry3d T = place.T_link_body * PoseAt(model_.geom_pos, model_.geom_quat, geom);
    Shape shape;
    const mjtNum* size = model_.geom_size + 3 * geom;
    switch (type) {
      case mjGEOM_SPHERE:
        shape = {"sphere", {{"radius", Number(size[0])}}, {}, touched};
        break;
      case mjGEOM_CAPSULE:
      case mjGEOM_CYLINDER:
        shape = {type == mjGEOM_CAPSULE ? "capsule" : "cylinder",
                 {{"radius", Number(size[0])}, {"length", Number(2 * size[1])}},
                 {},
                 touched};
        break;
      case mjGEOM_ELLIPSOID:
        shape = CapsuleAbout(VectorAt(model_.geom_size, geom), touched, T);
        break;
      case mjGEOM_BOX:
        shape = {"box",
                 {{"size", absl::StrCat(Number(2 * size[0]), " ", Number(2 * size[1]), " ",
                                        Number(2 * size[2]))}},
                 {},
                 touched};
        break;
      case mjGEOM_MESH:
        shape = {"mesh", {{"filename", MeshFile(model_.geom_dataid[geom])}}, {}, touched};
        break;
      default:
        return;
    }
    shape.origin = PoseOf(T);
    capsules_ += shape.kind == "capsule";
    links_[static_cast<size_t>(place.link)].shapes.push_back(std::move(shape));
  }

  // Of half axes a >= b >= c: radius b, its caps' centres a - b along the longest. At x beyond a -
  // b the ellipsoid is within b sqrt(1 - x^2 / a^2), the cap within sqrt(b^2 - (x - a + b)^2), and
  // x - a + b <= b x / a.
  Shape CapsuleAbout(const Vector3d& axes, bool touched, Isometry3d& T) const {
    int longest = 0;
    const double a = axes.maxCoeff(&longest);
    const double b = std::max(axes[(longest + 1) % 3], axes[(longest + 2) % 3]);
    if (longest != 2)
      T.rotate(Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), Vector3d::Unit(longest)));
    return {"capsule", {{"radius", Number(b)}, {"length", Number(2 * (a - b))}}, {}, touched};
  }

  std::string MeshFile(int mesh) {
    const auto known = mesh_files_.find(mesh);
    if (known != mesh_files_.end()) return known->second;
    std::string stem = Named(mjOBJ_MESH, mesh);
    for (char& c : stem)
      if (!std::isalnum(static_cast<unsigned char>(c)) && c != '_' && c != '-') c = '_';
    while (!stems_.insert(stem).second) stem += "_";
    const std::string path = absl::StrCat(meshes_, "/", stem, ".stl");
    out_.meshes[path] = Stl(mesh);
    return mesh_files_[mesh] = path;
  }
  std::string Stl(int mesh) const {
    std::string text(80, ' ');
    const auto append = [&](const auto& value) {
      text.append(reinterpret_cast<const char*>(&value), sizeof value);
    };
    const int first_face = model_.mesh_faceadr[mesh];
    const int faces = model_.mesh_facenum[mesh];
    append(static_cast<uint32_t>(faces));
    for (int face = first_face; face < first_face + faces; ++face) {
      text.append(12, '\0');  // readers take the normal from the corners
      for (int k = 0; k < 3; ++k) {
        const int vertex = model_.mesh_vertadr[mesh] + model_.mesh_face[3 * face + k];
        for (int axis = 0; axis < 3; ++axis) append(model_.mesh_vert[3 * vertex + axis]);
      }
      text.append(2, '\0');
    }
    return text;
  }

  void AddSites() {
    for (int site = 0; site < model_.nsite; ++site) {
      const Place& place = place_[static_cast<size_t>(model_.site_bodyid[site])];
      if (place.loose) continue;
      const std::string& name = site_names_[static_cast<size_t>(site)];
      AddLink(name, FixedName(name), place.link,
              place.T_link_body * PoseAt(model_.site_pos, model_.site_quat, site));
      out_.sites.push_back(name);
    }
  }

  void AddCouplings() {
    for (int k = 0; k < model_.neq; ++k) {
      if (!model_.eq_active[k]) continue;
      if (model_.eq_type[k] != mjEQ_JOINT) {
        ++loops_;
        continue;
      }
      const int follower = model_.eq_obj1id[k], leader = model_.eq_obj2id[k];
      if (joint_of_.count(follower) == 0) continue;
      const mjtNum* c = model_.eq_data + mjNEQDATA * k;
      Joint& joint = joints_[joint_of_[follower]];
      if (leader < 0 || joint_of_.count(leader) == 0 || c[2] != 0 || c[3] != 0 || c[4] != 0 ||
          !IsNumber(c[0]) || !IsNumber(c[1])) {
        Add(joint.name, "equality", "of joints, not linear", FactSource::kLeftOut, "");
        continue;
      }
      joint.mimic = joints_[joint_of_[leader]].name;
      joint.multiplier = c[1];
      joint.offset = model_.qpos0[model_.jnt_qposadr[follower]] + c[0] -
                     c[1] * model_.qpos0[model_.jnt_qposadr[leader]];
    }
  }

  // The least of the actuators that pull at the joint alone.
  void AddEfforts() {
    for (int k = 0; k < model_.nu; ++k) {
      const auto joint = joint_of_.find(model_.actuator_trnid[2 * k]);
      if (model_.actuator_trntype[k] != mjTRN_JOINT || !model_.actuator_forcelimited[k] ||
          joint == joint_of_.end())
        continue;
      const double gear = std::abs(model_.actuator_gear[6 * k]);
      const double most = gear * std::max(std::abs(model_.actuator_forcerange[2 * k]),
                                          std::abs(model_.actuator_forcerange[2 * k + 1]));
      if (!IsNumber(most)) continue;
      double& effort = joints_[joint->second].effort;
      effort = effort > 0 ? std::min(effort, most) : most;
    }
  }

  void Add(const std::string& part, const char* what, std::string value, FactSource source,
           std::string remedy) {
    out_.facts.push_back({part, what, std::move(value), source, std::move(remedy)});
  }

  void Describe() {
    const mjtNum* gravity = model_.opt.gravity;
    if (gravity[0] != 0 || gravity[1] != 0 || !(gravity[2] < 0))
      Add("model", "gravity", absl::StrFormat("%g %g %g m/s^2", gravity[0], gravity[1], gravity[2]),
          FactSource::kLeftOut, "URDF stands upright, its z up");
    if (armature_)
      Add("model", "armature", "of joints", FactSource::kLeftOut,
          "what rotors ask for is not in the torques of the URDF");
    if (!sprung_.empty())
      Add("model", "stiffness", absl::StrCat("of ", absl::StrJoin(sprung_, ", ")),
          FactSource::kLeftOut, "URDF has no springs");
    if (loops_ > 0)
      Add("model", "equality", absl::StrCat(loops_, " of connect, weld or tendon"),
          FactSource::kLeftOut, "URDF is a tree: what they hold together is loose in it");
    if (model_.ntendon > 0)
      Add("model", "tendons", absl::StrCat(model_.ntendon), FactSource::kLeftOut,
          "what they pull or couple moves by itself in the URDF");
    std::vector<std::string> unlimited;
    for (const Joint& joint : joints_)
      if (joint.moves && joint.effort <= 0) unlimited.push_back(joint.name);
    if (!unlimited.empty())
      Add("model", "effort",
          absl::StrFormat("%g of %s", urdf::kUnknownLimit, absl::StrJoin(unlimited, ", ")),
          FactSource::kAssumed, "no actuator of the file that was read says one");
    Add("model", "velocity", absl::StrFormat("%g rad/s or m/s", urdf::kUnknownLimit),
        FactSource::kAssumed, "MJCF says none");
    if (capsules_ > 0)
      Add("model", "capsules", absl::StrCat(capsules_), FactSource::kRead,
          "as <capsule>, which robot_client reads; URDF itself has none: MuJoCo refuses such a "
          "file, "
          "others leave them out");
    if (planes_ > 0)
      Add("model", "planes and height fields", absl::StrCat(planes_), FactSource::kLeftOut,
          "workspace.table_z of a robot file is a floor");
    if (seen_ > 0)
      Add("model", "shapes that touch nothing", absl::StrCat(seen_), FactSource::kLeftOut,
          "their bodies have shapes that do");
    if (!loose_.empty())
      Add("model", "bodies that stand on nothing", absl::StrJoin(loose_, ", "),
          FactSource::kLeftOut, "");
    if (!held_.empty()) out_.facts.push_back(HeldFact(held_));
    int shapes = 0;
    for (const Link& link : links_) shapes += static_cast<int>(link.shapes.size());
    Add("model", "shapes", absl::StrFormat("%d, %d meshes", shapes, out_.meshes.size()),
        shapes > 0 ? FactSource::kRead : FactSource::kLeftOut,
        shapes > 0 ? "" : "nothing is watched exactly");
  }

  static constexpr double kMostNumber = 1e6;     // as readers of URDF take
  static constexpr double kEndlessSlide = 1000;  // [m]: URDF has no prismatic joint without ends

  const mjModel& model_;
  const std::string meshes_;
  std::vector<Place> place_;
  std::vector<Link> links_;
  std::vector<Joint> joints_;
  std::map<int, size_t> joint_of_;  // of the model's joints
  std::map<int, std::string> mesh_files_;
  std::vector<std::string> body_names_, joint_names_, site_names_;  // by id
  std::set<std::string> names_, joint_names_in_use_, stems_;
  std::vector<std::string> loose_, held_, sprung_;
  int planes_ = 0, seen_ = 0, loops_ = 0, capsules_ = 0;
  bool armature_ = false;
  UrdfOutput out_;
};

}  // namespace

absl::StatusOr<UrdfOutput> UrdfOf(const mjModel& model, const std::string& meshes) {
  return UrdfWriter(model, meshes).Write();
}

}  // namespace robostress::calibration
