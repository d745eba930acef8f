#include "sim_worker/suites/task_model.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/check.h"
#include "common/status_macros.h"
#include "sim_worker/panda_mjcf.h"

namespace robostress {
namespace {

// Table, light and the third-person camera. The camera is framed on the places where props can be,
// so that a 64-pixel view spends its pixels on them.
constexpr char kStageXml[] = R"(
<light directional="true" pos="0.5 0 2" dir="-0.2 0.15 -1" diffuse="0.45 0.45 0.45" ambient="0.1 0.1 0.1"/>
<geom name="table" type="plane" size="1.5 1.5 0.1" pos="0 0 0" rgba="0.62 0.58 0.5 1" contype="1" conaffinity="2"
      friction="0.8 0.01 0.0001"/>
<camera name="agentview" pos="1.0 0 0.80" xyaxes="0 1 0 -0.845 0 0.534" fovy="45"/>
)";

constexpr int kSlices = 14;

std::string PropOf(const std::string& destination) {
  return std::vector<std::string>(absl::StrSplit(destination, '/'))[0];
}

}  // namespace

absl::StatusOr<std::unique_ptr<TaskModel>> TaskModel::Create(const SuiteSpec& suite, int task) {
  std::unique_ptr<TaskModel> result(new TaskModel(suite, task));
  PandaScene scene;
  scene.name = suite.name;
  scene.base_position = Eigen::Vector3d::Zero();
  scene.world_xml = result->SceneMjcf();
  result->mjcf_ = ComposePandaScene(scene);
  RS_ASSIGN_OR_RETURN(result->model_,
                      CompileModel(absl::StrCat(suite.name, " task ", task), result->mjcf_));
  // Round shapes are drawn with fewer faces: the software rasteriser spends its time on vertices.
  // Nobody else holds the model yet.
  mjModel& drawn = const_cast<mjModel&>(*result->model_);
  drawn.vis.quality.numslices = kSlices;
  drawn.vis.quality.numstacks = kSlices / 2;
  const mjModel& m = *result->model_;
  for (const Prop& prop : result->scene().props) {
    Entry entry;
    entry.mobility = result->MobilityOf(prop);
    const int body = result->BodyId(prop.name);
    if (entry.mobility == Mobility::kStatic) {
      entry.mocap = m.body_mocapid[body];
    } else {
      entry.qpos = m.jnt_qposadr[m.body_jntadr[body]];
    }
    result->entries_.push_back(entry);
  }
  return result;
}

Mobility TaskModel::MobilityOf(const Prop& prop) const {
  for (const Goal& goal : task().goals) {
    if (goal.object != prop.name) continue;
    if (goal.kind == GoalKind::kPlace) return Mobility::kFree;
    if (goal.kind == GoalKind::kPush) return Mobility::kPlanar;
  }
  return Mobility::kStatic;
}

std::string TaskModel::SceneMjcf() const {
  std::string xml = kStageXml;
  for (const Prop& prop : scene().props) absl::StrAppend(&xml, PropMjcf(prop, MobilityOf(prop)));
  return xml;
}

std::vector<double> TaskModel::Qpos(const InitialState& state) const {
  std::vector<double> qpos(model_->qpos0, model_->qpos0 + model_->nq);
  for (int j = 0; j < 7; ++j) qpos[j] = state.q[j];
  for (int j = 0; j < 2; ++j) qpos[7 + j] = PandaHomeFingers()[j];
  for (size_t i = 0; i < entries_.size(); ++i) {
    const Entry& entry = entries_[i];
    const int dofs = entry.mobility == Mobility::kFree     ? 3
                     : entry.mobility == Mobility::kPlanar ? 2
                                                           : 0;
    for (int k = 0; k < dofs; ++k) qpos[entry.qpos + k] = state.positions[i][k];
  }
  return qpos;
}

void TaskModel::PlaceStaticProps(const InitialState& state, mjData& data) const {
  for (size_t i = 0; i < entries_.size(); ++i) {
    if (entries_[i].mocap < 0) continue;
    for (int k = 0; k < 3; ++k) data.mocap_pos[3 * entries_[i].mocap + k] = state.positions[i][k];
  }
}

const Prop& TaskModel::FindProp(const std::string& name) const {
  for (const Prop& prop : scene().props) {
    if (prop.name == name) return prop;
  }
  RS_CHECK(false);
  return scene().props[0];
}

int TaskModel::BodyId(const std::string& body) const {
  const int id = mj_name2id(model_.get(), mjOBJ_BODY, body.c_str());
  RS_CHECK(id >= 0);
  return id;
}

Eigen::Vector3d TaskModel::Position(const mjData& data, const std::string& body) const {
  return Eigen::Map<const Eigen::Vector3d>(data.xpos + 3 * BodyId(body));
}

double TaskModel::Upright(const mjData& data, const std::string& body) const {
  return data.xmat[9 * BodyId(body) + 8];
}

double TaskModel::JointPosition(const mjData& data, const std::string& joint) const {
  const int id = mj_name2id(model_.get(), mjOBJ_JOINT, joint.c_str());
  RS_CHECK(id >= 0);
  return data.qpos[model_->jnt_qposadr[id]];
}

const Region& TaskModel::RegionOf(const Goal& goal) const {
  if (absl::EndsWith(goal.destination, "/drawer")) return DrawerRegion();
  return ShapeOf(FindProp(goal.destination).kind).region;
}

Eigen::Vector3d TaskModel::RegionCenter(const mjData& data, const Goal& goal) const {
  const Region& region = RegionOf(goal);
  return Position(data, PropOf(goal.destination) + region.body_suffix) + region.center;
}

Eigen::Vector3d TaskModel::HandleCenter(const mjData& data, const std::string& prop,
                                        const Handle& handle) const {
  const int body = BodyId(prop + handle.body_suffix);
  const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(data.xmat + 9 * body);
  return Eigen::Map<const Eigen::Vector3d>(data.xpos + 3 * body) + R * handle.center;
}

}  // namespace robostress
