#include "robot_client/study/table_scene.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

using ConstMap3 = Eigen::Map<const Eigen::Vector3d>;

// A place on the table and how far from it, to either side, it may be drawn [m].
struct Spread {
  double x, y, half_x, half_y;
};
constexpr Spread kPlate = {0.33, -0.09, 0.015, 0.02};
constexpr Spread kBowlBesidePlate = {0.31, 0.105, 0.035, 0.025};
constexpr Spread kBox = {0.36, -0.29, 0.015, 0.015};
constexpr Spread kCabinet = {0.42, 0.25, 0.012, 0.015};
constexpr double kOnTop = 0.012;  // how far a bowl on cabinet or box is from its middle [m]

constexpr double kOnPlate = 0.05;        // of bowl's and plate's centres, horizontally [m]
constexpr double kStandsWithin = 0.012;  // of the bowl's underside above the plate's face [m]
constexpr double kAtRest = 0.03;         // [m/s]
constexpr double kLetGo = 0.03;          // between the fingers [m]; a held wall is kBowlWall thick

Eigen::Vector3d Draw(const Spread& spread, RandomStream& random) {
  const double x = spread.x + random.Uniform(-spread.half_x, spread.half_x);
  const double y = spread.y + random.Uniform(-spread.half_y, spread.half_y);
  return {x, y, 0};
}

}  // namespace

absl::StatusOr<TableScene> TableScene::Create(PiperPlant* plant, const TableTask& task) {
  TableScene scene;
  scene.plant_ = plant;
  scene.task_ = &task;
  const mjModel& model = plant->model();
  const auto find = [&](int type, const char* name) -> absl::StatusOr<int> {
    const int id = mj_name2id(&model, type, name);
    if (id >= 0) return id;
    return absl::NotFoundError(
        absl::StrCat("the scene has no '", name, "'; make it with MakeTableScene"));
  };
  RS_ASSIGN_OR_RETURN(scene.bowl_, find(mjOBJ_BODY, "bowl"));
  RS_ASSIGN_OR_RETURN(scene.plate_, find(mjOBJ_BODY, "plate"));
  RS_ASSIGN_OR_RETURN(const int box, find(mjOBJ_BODY, "gift_box"));
  RS_ASSIGN_OR_RETURN(const int cabinet, find(mjOBJ_BODY, "cabinet"));
  RS_ASSIGN_OR_RETURN(const int bowl_joint, find(mjOBJ_JOINT, "bowl_free"));
  RS_ASSIGN_OR_RETURN(const int slide, find(mjOBJ_JOINT, "drawer_slide"));
  RS_ASSIGN_OR_RETURN(scene.handle_, find(mjOBJ_SITE, "handle"));
  RS_ASSIGN_OR_RETURN(scene.grip_, find(mjOBJ_SITE, "piper_grip"));
  scene.bowl_qpos_ = model.jnt_qposadr[bowl_joint];
  scene.bowl_dof_ = model.jnt_dofadr[bowl_joint];
  scene.drawer_qpos_ = model.jnt_qposadr[slide];
  scene.drawer_dof_ = model.jnt_dofadr[slide];
  scene.plate_mocap_ = model.body_mocapid[scene.plate_];
  scene.box_mocap_ = model.body_mocapid[box];
  scene.cabinet_mocap_ = model.body_mocapid[cabinet];
  return scene;
}

void TableScene::Place(int state) {
  RandomStream random(StreamKey("piper table").With(task_->name).With(state));
  mjData& data = plant_->data();
  const auto put = [&](int mocap, const Eigen::Vector3d& p) {
    std::copy_n(p.data(), 3, data.mocap_pos + 3 * mocap);
  };
  const Eigen::Vector3d plate = Draw(kPlate, random), box = Draw(kBox, random),
                        cabinet = Draw(kCabinet, random);
  Eigen::Vector3d bowl = Draw(kBowlBesidePlate, random);
  const Eigen::Vector3d aside(random.Uniform(-kOnTop, kOnTop), random.Uniform(-kOnTop, kOnTop), 0);
  if (task_->bowl == BowlPlace::kOnCabinet)
    bowl = cabinet + aside + Eigen::Vector3d(0, 0, kCabinetHeight);
  if (task_->bowl == BowlPlace::kOnBox) bowl = box + aside + Eigen::Vector3d(0, 0, kBoxHeight);
  put(plate_mocap_, plate);
  put(box_mocap_, box);
  put(cabinet_mocap_, cabinet);
  const double yaw = random.Uniform(-M_PI, M_PI);
  const mjtNum pose[7] = {bowl.x(), bowl.y(), bowl.z() + 0.001, std::cos(yaw / 2),
                          0,        0,        std::sin(yaw / 2)};
  std::copy_n(pose, 7, data.qpos + bowl_qpos_);
  std::fill_n(data.qvel + bowl_dof_, 6, 0.0);
  data.qpos[drawer_qpos_] = data.qvel[drawer_dof_] = 0;
  mj_step1(&plant_->model(), &data);  // as PiperPlant leaves it: positions and velocities computed
}

TableState TableScene::Look() const {
  const mjData& data = plant_->data();
  TableState state;
  state.bowl = ConstMap3(data.xpos + 3 * bowl_);
  state.plate = ConstMap3(data.xpos + 3 * plate_);
  state.handle = ConstMap3(data.site_xpos + 3 * handle_);
  state.grip = ConstMap3(data.site_xpos + 3 * grip_);
  state.bowl_upright = data.xmat[9 * bowl_ + 8] > 0.95;
  state.bowl_speed = ConstMap3(data.qvel + bowl_dof_).norm();
  state.drawer = data.qpos[drawer_qpos_];
  state.opening = plant_->reading().opening;
  return state;
}

bool TableScene::Done(const TableState& state) const {
  if (task_->kind == TableTaskKind::kOpenDrawer) return state.drawer >= kDrawerOpen;
  const double above = state.bowl.z() - state.plate.z() - kPlateHeight;
  return (state.bowl - state.plate).head<2>().norm() < kOnPlate && above > -0.005 &&
         above < kStandsWithin && state.bowl_upright && state.bowl_speed < kAtRest &&
         state.opening > kLetGo;
}

}  // namespace robostress::piper
