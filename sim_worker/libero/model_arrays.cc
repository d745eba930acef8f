#include "sim_worker/libero/model_arrays.h"

#include <type_traits>

namespace robostress::libero {
namespace {

template <class T>
DType TypeOf() {
  if (std::is_same_v<T, int>) return DType::kI32;
  if (std::is_same_v<T, mjtByte>) return DType::kU8;
  static_assert(std::is_same_v<T, int> || std::is_same_v<T, mjtByte> || std::is_same_v<T, mjtNum>);
  return DType::kF64;
}

template <class T>
ModelArray View(const char* name, const T* data, int rows, int columns) {
  std::vector<int64_t> shape = {rows};
  if (columns > 1) shape.push_back(columns);
  return {name, TypeOf<T>(), shape, data};
}

}  // namespace

std::vector<ModelArray> ModelArrays(const mjModel& m) {
#define ARRAY(name, rows, columns) View(#name, m.name, m.rows, columns)
  return {ARRAY(qpos0, nq, 1),
          ARRAY(body_parentid, nbody, 1),
          ARRAY(body_pos, nbody, 3),
          ARRAY(body_quat, nbody, 4),
          ARRAY(body_ipos, nbody, 3),
          ARRAY(body_iquat, nbody, 4),
          ARRAY(body_mass, nbody, 1),
          ARRAY(body_inertia, nbody, 3),
          ARRAY(jnt_type, njnt, 1),
          ARRAY(jnt_qposadr, njnt, 1),
          ARRAY(jnt_bodyid, njnt, 1),
          ARRAY(jnt_limited, njnt, 1),
          ARRAY(jnt_solref, njnt, mjNREF),
          ARRAY(jnt_solimp, njnt, mjNIMP),
          ARRAY(jnt_pos, njnt, 3),
          ARRAY(jnt_axis, njnt, 3),
          ARRAY(jnt_range, njnt, 2),
          ARRAY(dof_frictionloss, nv, 1),
          ARRAY(dof_armature, nv, 1),
          ARRAY(dof_damping, nv, 1),
          ARRAY(geom_type, ngeom, 1),
          ARRAY(geom_contype, ngeom, 1),
          ARRAY(geom_conaffinity, ngeom, 1),
          ARRAY(geom_condim, ngeom, 1),
          ARRAY(geom_bodyid, ngeom, 1),
          ARRAY(geom_group, ngeom, 1),
          ARRAY(geom_priority, ngeom, 1),
          ARRAY(geom_solmix, ngeom, 1),
          ARRAY(geom_solref, ngeom, mjNREF),
          ARRAY(geom_solimp, ngeom, mjNIMP),
          ARRAY(geom_size, ngeom, 3),
          ARRAY(geom_pos, ngeom, 3),
          ARRAY(geom_quat, ngeom, 4),
          ARRAY(geom_friction, ngeom, 3),
          ARRAY(geom_margin, ngeom, 1),
          ARRAY(geom_gap, ngeom, 1),
          ARRAY(site_type, nsite, 1),
          ARRAY(site_bodyid, nsite, 1),
          ARRAY(site_size, nsite, 3),
          ARRAY(site_pos, nsite, 3),
          ARRAY(site_quat, nsite, 4),
          ARRAY(cam_pos, ncam, 3),
          ARRAY(cam_quat, ncam, 4),
          ARRAY(cam_fovy, ncam, 1),
          ARRAY(actuator_gainprm, nu, mjNGAIN),
          ARRAY(actuator_biasprm, nu, mjNBIAS),
          ARRAY(actuator_ctrlrange, nu, 2),
          ARRAY(actuator_forcerange, nu, 2)};
#undef ARRAY
}

}  // namespace robostress::libero
