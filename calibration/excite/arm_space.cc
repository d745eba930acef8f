#include "calibration/excite/arm_space.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/excite/urdf_shapes_model.h"
#include "calibration/model/model_file.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "sim_worker/renderer.h"

namespace robostress::calibration {
namespace {

constexpr int kFloor = -1, kBox = -2;           // in the place of a second body
constexpr double kG = 9.81, kLightest = 0.005;  // [m/s^2], [kg]
constexpr int kWidth = 480, kHeight = 360;
constexpr float kQuality = 60, kLight = 0.6F;
constexpr double kFilmed =
    0.7;  // of the diagonal of what moves: MuJoCo's camera stands 1.5 times this away

// With its shapes, where their files are found; else without them, and why.
absl::StatusOr<std::shared_ptr<mjModel>> LoadWithShapes(const Rig& rig, std::string* why_without,
                                                        std::vector<std::string>* notes) {
  RS_ASSIGN_OR_RETURN(LoadedModel loaded, LoadModel(rig));
  std::shared_ptr<mjModel> model = std::move(loaded.model);
  for (const ModelFact& fact : loaded.facts)
    if (fact.what == "shapes" && fact.source == FactSource::kLeftOut) *why_without = fact.remedy;
  if (loaded.urdf) {
    RS_ASSIGN_OR_RETURN(ShapedModel shaped, LoadUrdfWithShapes(rig));
    for (const std::string& mesh : shaped.missing)
      notes->push_back(absl::StrCat("mesh ", mesh, " is not watched"));
    model = std::move(shaped.model);
  }
  if (rig.gravity) mju_copy3(model->opt.gravity, rig.gravity->data());
  return model;
}

absl::StatusOr<int> JointId(const mjModel& model, const Rig& rig, const RigJoint& joint) {
  const int id = mj_name2id(&model, mjOBJ_JOINT, joint.name.c_str());
  if (id < 0)
    return absl::NotFoundError(absl::StrCat(rig.model, ": has no joint '", joint.name, "'"));
  return id;
}

std::string BodyName(const mjModel& model, int body) {
  const char* name = mj_id2name(&model, mjOBJ_BODY, body);
  return name == nullptr || *name == '\0' ? absl::StrCat("body ", body) : name;
}

bool Collides(const mjModel& model, int geom) {
  return model.geom_contype[geom] != 0 || model.geom_conaffinity[geom] != 0;
}

std::string PairName(const mjModel& model, const std::pair<int, int>& pair) {
  return absl::StrCat(BodyName(model, pair.first), " and ",
                      pair.second == kFloor ? "the floor"
                      : pair.second == kBox ? "the workspace box"
                                            : BodyName(model, pair.second));
}

}  // namespace

double ArmSpace::RoundLoad(double mass) {
  if (!(mass > kLightest)) return 0;
  const double digit = std::pow(10, std::floor(std::log10(mass)));
  return std::floor(mass / digit + 1e-9) * digit;
}

absl::StatusOr<std::unique_ptr<ArmSpace>> ArmSpace::Load(const Rig& rig, const Options& options) {
  std::unique_ptr<ArmSpace> space(new ArmSpace());
  RS_ASSIGN_OR_RETURN(space->model_,
                      LoadWithShapes(rig, &space->why_without_shapes_, &space->notes_));
  mjModel& model = *space->model_;
  space->options_ = options;
  space->moves_.assign(model.nbody, 0);
  space->data_ = mj_makeData(&model);
  if (model.nkey > 0)
    mj_resetDataKeyframe(&model, space->data_, std::max(0, mj_name2id(&model, mjOBJ_KEY, "home")));
  for (const RigJoint& joint : rig.joints) {
    RS_ASSIGN_OR_RETURN(const int id, JointId(model, rig, joint));
    space->moves_[model.jnt_bodyid[id]] = 1;
    space->qpos_.push_back(model.jnt_qposadr[id]);
    space->dof_.push_back(model.jnt_dofadr[id]);
    space->stops_.emplace_back();
    double q = space->data_->qpos[model.jnt_qposadr[id]];
    if (model.jnt_limited[id]) {
      const double lower = model.jnt_range[2 * id], upper = model.jnt_range[2 * id + 1],
                   quarter = (upper - lower) / 4;
      space->stops_.back() = Stops{lower, upper};
      // At a stop there is no room on one side.
      if (model.nkey == 0) q = std::clamp(q, lower + quarter, upper - quarter);
    }
    space->home_.push_back(q);
  }
  for (int body = 1; body < model.nbody; ++body)
    space->moves_[body] |= space->moves_[model.body_parentid[body]];
  for (const char* name : kPayloadSites)
    if (space->payload_site_ < 0) space->payload_site_ = mj_name2id(&model, mjOBJ_SITE, name);
  space->FindCouplings();
  space->TakeParameters(rig);
  // Contacts begin at the clearance; of two shapes the larger margin counts. Whatever can touch
  // something can touch everything: masks that keep an arm's parts from each other are for speed.
  for (int geom = 0; geom < model.ngeom; ++geom) {
    model.geom_margin[geom] = std::max(model.geom_margin[geom], options.clearance);
    if (!Collides(model, geom)) continue;
    model.geom_contype[geom] = model.geom_conaffinity[geom] = 1;
    space->shapes_ += space->moves_[model.geom_bodyid[geom]];
  }
  return space;
}

void ArmSpace::FindCouplings() {
  const mjModel& m = *model_;
  std::set<int> known(qpos_.begin(), qpos_.end());  // the rig's, and what is led
  std::vector<Coupling> found;
  for (int k = 0; k < m.neq; ++k) {
    if (m.eq_type[k] != mjEQ_JOINT || !m.eq_active[k]) continue;
    int follower = m.eq_obj1id[k], leader = m.eq_obj2id[k];
    Coupling coupling;
    std::copy_n(m.eq_data + mjNEQDATA * k, 5, coupling.polynomial);
    if (known.count(m.jnt_qposadr[follower]) > 0) {
      // The rig lists the one that the model makes follow: of a line the other way round.
      const double* p = coupling.polynomial;
      if (leader < 0 || known.count(m.jnt_qposadr[leader]) > 0 || p[1] == 0 || p[2] != 0 ||
          p[3] != 0 || p[4] != 0)
        continue;
      std::swap(follower, leader);
      const double offset = p[0], slope = p[1];
      coupling.polynomial[0] = -offset / slope;
      coupling.polynomial[1] = 1 / slope;
    }
    coupling.q = m.jnt_qposadr[follower];
    coupling.dof = m.jnt_dofadr[follower];
    if (leader >= 0) {
      coupling.leader_q = m.jnt_qposadr[leader];
      coupling.leader_dof = m.jnt_dofadr[leader];
    }
    known.insert(coupling.q);
    found.push_back(coupling);
  }
  // Of a circle nothing is left over that waits for nobody; it stays where it is.
  while (!found.empty()) {
    const auto next = std::find_if(found.begin(), found.end(), [&](const Coupling& c) {
      return std::none_of(found.begin(), found.end(),
                          [&](const Coupling& other) { return other.q == c.leader_q; });
    });
    if (next == found.end()) break;
    if (next->leader_dof >= 0)
      moves_[m.dof_bodyid[next->dof]] |= moves_[m.dof_bodyid[next->leader_dof]];
    couplings_.push_back(*next);
    found.erase(next);
  }
  for (int body = 1; body < m.nbody; ++body) moves_[body] |= moves_[m.body_parentid[body]];
}

double ArmSpace::Coupling::Value(double x) const {
  double value = 0;
  for (int i = 4; i >= 0; --i) value = value * x + polynomial[i];
  return value;
}
double ArmSpace::Coupling::Slope(double x) const {
  double slope = 0;
  for (int i = 4; i >= 1; --i) slope = slope * x + i * polynomial[i];
  return slope;
}

void ArmSpace::TakeParameters(const Rig& rig) {
  for (size_t j = 0; j < rig.joints.size(); ++j) {
    mass_scale_.push_back(1);
    torque_gain_.push_back(1);
    torque_offset_.push_back(0);
    for (const auto& [name, value] : rig.joints[j].parameters) {
      if (name == "armature") model_->dof_armature[dof_[j]] = value;
      if (name == "damping") model_->dof_damping[dof_[j]] = value;
      if (name == "frictionloss") model_->dof_frictionloss[dof_[j]] = value;
      if (name == "mass_scale") mass_scale_[j] = value;
      if (name == "torque_gain") torque_gain_[j] = value;
      if (name == "torque_offset") torque_offset_[j] = value;
    }
  }
}

const char* ArmSpace::TorqueUnit(size_t joint) const {
  return model_->jnt_type[model_->dof_jntid[dof_[joint]]] == mjJNT_SLIDE ? "N" : "Nm";
}

// Turned by upright hinges alone: whatever the arm does, it stays as high as it is.
bool ArmSpace::KeepsItsHeight(int body) const {
  for (; body > 0; body = model_->body_parentid[body]) {
    for (int j = 0; j < model_->body_jntnum[body]; ++j) {
      const int joint = model_->body_jntadr[body] + j;
      const bool upright = std::abs(data_->xaxis[3 * joint + 2]) > 1 - 1e-9;
      if (model_->jnt_type[joint] != mjJNT_HINGE || !upright) return false;
    }
  }
  return true;
}

absl::Status ArmSpace::WatchFrom(const std::vector<double>& centre) {
  SetPosture(centre);
  for (const std::pair<int, int>& pair : NearPairs()) {
    if (pair.second < 0) {
      return absl::FailedPreconditionError(
          absl::StrFormat("in the middle of the motion %s are nearer than %g m; choose another "
                          "--centre, --floor or "
                          "--box",
                          PairName(*model_, pair), options_.clearance));
    }
    neighbours_.push_back(pair);
    notes_.push_back(absl::StrCat(PairName(*model_, pair),
                                  " are near each other in the middle of the motion: not watched"));
  }
  return absl::OkStatus();
}

ArmSpace::~ArmSpace() {
  if (data_ != nullptr) mj_deleteData(data_);
}

void ArmSpace::Place(const std::vector<double>& posture) {
  for (size_t i = 0; i < qpos_.size(); ++i) data_->qpos[qpos_[i]] = posture[i];
  for (const Coupling& c : couplings_) {
    const double x = c.leader_q < 0 ? 0 : data_->qpos[c.leader_q] - model_->qpos0[c.leader_q];
    data_->qpos[c.q] = model_->qpos0[c.q] + (c.leader_q < 0 ? c.polynomial[0] : c.Value(x));
  }
}

void ArmSpace::SetPosture(const std::vector<double>& posture) {
  Place(posture);
  mj_kinematics(model_.get(), data_);
  mj_comPos(model_.get(), data_);
}

// Of bodies, the smaller first; each once.
std::vector<std::pair<int, int>> ArmSpace::NearPairs() {
  std::set<std::pair<int, int>> near;
  mj_collision(model_.get(), data_);
  for (int i = 0; i < data_->ncon; ++i) {
    const int a = model_->geom_bodyid[data_->contact[i].geom1],
              b = model_->geom_bodyid[data_->contact[i].geom2];
    if (data_->contact[i].dist < options_.clearance && (moves_[a] || moves_[b]))
      near.insert({std::min(a, b), std::max(a, b)});
  }
  for (int geom = 0; geom < model_->ngeom; ++geom) {
    const int body = model_->geom_bodyid[geom];
    if (!moves_[body] || !Collides(*model_, geom)) continue;
    // The sphere around a shape is on the safe side.
    const double radius = model_->geom_rbound[geom] + options_.clearance;
    const mjtNum* place = data_->geom_xpos + 3 * geom;
    if (options_.floor_z && place[2] - radius < *options_.floor_z && !KeepsItsHeight(body))
      near.insert({body, kFloor});
    for (size_t axis = 0; axis < options_.box_lower.size(); ++axis) {
      if (place[axis] - radius < options_.box_lower[axis] ||
          place[axis] + radius > options_.box_upper[axis])
        near.insert({body, kBox});
    }
  }
  return {near.begin(), near.end()};
}

std::string ArmSpace::MetAt(const std::vector<double>& posture) {
  SetPosture(posture);
  for (const std::pair<int, int>& pair : NearPairs()) {
    if (std::find(neighbours_.begin(), neighbours_.end(), pair) == neighbours_.end())
      return PairName(*model_, pair);
  }
  return "";
}

std::vector<double> ArmSpace::TorquesAt(const std::vector<double>& posture,
                                        const std::vector<double>& velocity,
                                        const std::vector<double>& acceleration) {
  const mjModel& m = *model_;
  Place(posture);
  for (size_t i = 0; i < dof_.size(); ++i) {
    data_->qvel[dof_[i]] = velocity[i];
    data_->qacc[dof_[i]] = acceleration[i];
  }
  std::vector<double> slopes;
  for (const Coupling& c : couplings_) {
    slopes.push_back(c.leader_q < 0 ? 0 : c.Slope(data_->qpos[c.leader_q] - m.qpos0[c.leader_q]));
    if (c.leader_q < 0) continue;
    data_->qvel[c.dof] = slopes.back() * data_->qvel[c.leader_dof];
    data_->qacc[c.dof] = slopes.back() * data_->qacc[c.leader_dof];
  }
  const int flags = m.opt.disableflags;
  model_->opt.disableflags |= mjDSBL_CONTACT | mjDSBL_EQUALITY | mjDSBL_LIMIT;
  mj_inverse(&m, data_);
  model_->opt.disableflags = flags;
  std::vector<double> all(data_->qfrc_inverse, data_->qfrc_inverse + m.nv), rigid(m.nv, 0);
  if (std::any_of(mass_scale_.begin(), mass_scale_.end(), [](double s) { return s != 1; })) {
    mj_rne(&m, data_, 1, rigid.data());
    for (size_t j = 0; j < dof_.size(); ++j) all[dof_[j]] += (mass_scale_[j] - 1) * rigid[dof_[j]];
  }
  if (load_ > 0 && payload_site_ >= 0) {
    std::vector<double> jacobian(3 * m.nv);
    mjtNum acceleration_of_site[6];  // turning, then along; of what gravity is not
    mj_rnePostConstraint(&m, data_);
    mj_objectAcceleration(&m, data_, mjOBJ_SITE, payload_site_, acceleration_of_site, 0);
    mj_jacSite(&m, data_, jacobian.data(), nullptr, payload_site_);
    for (int dof = 0; dof < m.nv; ++dof)
      for (int axis = 0; axis < 3; ++axis)
        all[dof] += load_ * jacobian[axis * m.nv + dof] * acceleration_of_site[3 + axis];
  }
  for (size_t k = couplings_.size(); k-- > 0;)
    if (couplings_[k].leader_dof >= 0)
      all[couplings_[k].leader_dof] += slopes[k] * all[couplings_[k].dof];
  // What the servo is asked for: its limit stands before the motor's gain.
  std::vector<double> torques;
  for (size_t j = 0; j < dof_.size(); ++j)
    torques.push_back((all[dof_[j]] - torque_offset_[j]) /
                      (torque_gain_[j] != 0 ? torque_gain_[j] : 1));
  mju_zero(data_->qvel, model_->nv);
  mju_zero(data_->qacc, model_->nv);
  return torques;
}

double ArmSpace::LoadOf(double share, double torque_share, const std::vector<double>& limits,
                        const std::vector<std::vector<double>>& postures) {
  if (payload_site_ < 0) return 0;
  std::vector<double> jacobian(3 * model_->nv), inertia(model_->nv * model_->nv);
  double most = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < postures.size(); ++i) {
    const std::vector<double> still(qpos_.size(), 0),
        torques = TorquesAt(postures[i], still, still);
    SetPosture(postures[i]);
    mj_jacSite(model_.get(), data_, jacobian.data(), nullptr, payload_site_);
    if (i == 0) {
      mj_crb(model_.get(), data_);
      mj_fullM(model_.get(), inertia.data(), data_->qM);
    }
    for (size_t j = 0; j < dof_.size(); ++j) {
      const int dof = dof_[j];
      double arm2 = 0;  // [m^2]
      for (int axis = 0; axis < 3; ++axis) arm2 += std::pow(jacobian[axis * model_->nv + dof], 2);
      if (arm2 < 1e-8) continue;
      if (i == 0) most = std::min(most, share * inertia[dof * model_->nv + dof] / arm2);
      const double left = torque_share * limits[j] - std::abs(torques[j]);
      if (std::isfinite(limits[j]))
        most = std::min(most, std::max(0.0, left) / (kG * std::sqrt(arm2)));
    }
  }
  return std::isfinite(most) ? RoundLoad(0.95 * most) : 0;
}

absl::Status ArmSpace::Film(const std::vector<std::vector<double>>& q, int every, double frame_s,
                            const std::string& file) {
  // Whatever the model says of light, the arm shall be seen.
  for (float* light : {model_->vis.headlight.ambient, model_->vis.headlight.diffuse})
    std::fill_n(light, 3, kLight);
  std::vector<double> posture(q.size());
  const auto set_row = [&](size_t row) {
    for (size_t i = 0; i < q.size(); ++i) posture[i] = q[i][row];
    SetPosture(posture);
  };
  // The free camera looks at what moves, wherever it goes.
  Eigen::AlignedBox3d seen;
  for (size_t row = 0; row < q[0].size(); row += every) {
    set_row(row);
    for (int geom = 0; geom < model_->ngeom; ++geom) {
      const Eigen::Map<const Eigen::Vector3d> place(data_->geom_xpos + 3 * geom);
      const Eigen::Vector3d radius = Eigen::Vector3d::Constant(model_->geom_rbound[geom]);
      if (moves_[model_->geom_bodyid[geom]]) seen.extend(place - radius).extend(place + radius);
    }
  }
  if (!seen.isEmpty()) {
    mju_copy3(model_->stat.center, seen.center().eval().data());
    model_->stat.extent = kFilmed * seen.diagonal().norm();
  }
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Renderer> renderer, Renderer::Create(model_));
  std::vector<Image> frames;
  for (size_t row = 0; row < q[0].size(); row += every) {
    set_row(row);
    mj_camlight(model_.get(), data_);
    RS_ASSIGN_OR_RETURN(Image frame,
                        renderer->Render(*data_, "", {.width = kWidth, .height = kHeight}));
    frames.push_back(std::move(frame));
  }
  RS_ASSIGN_OR_RETURN(const std::string film, EncodeAnimatedWebp(frames, frame_s, kQuality));
  return WriteFileAtomically(file, film);
}

}  // namespace robostress::calibration
