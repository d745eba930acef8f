#include "sim_worker/unseen_geoms.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <vector>

namespace robostress {
namespace {

using Eigen::Vector3d;

struct Sphere {
  Vector3d centre;
  double radius = 0;  // [m]
};

// What a camera sees, as half spaces: n . (p - eye) >= offset with unit n.
class Frustum {
 public:
  Frustum(const mjvGLCamera& camera, double aspect)
      : eye_(Eigen::Map<const Eigen::Vector3f>(camera.pos).cast<double>()),
        forward_(Eigen::Map<const Eigen::Vector3f>(camera.forward).cast<double>()),
        near_(camera.frustum_near),
        far_(camera.frustum_far) {
    const Vector3d up = Eigen::Map<const Eigen::Vector3f>(camera.up).cast<double>();
    const Vector3d right = forward_.cross(up);
    const double half_height = 0.5 * (camera.frustum_top - camera.frustum_bottom);
    const double half_width = half_height * aspect, centre = camera.frustum_center;
    const double middle = 0.5 * (camera.frustum_top + camera.frustum_bottom);
    // On a plane through the eye and an edge of the near rectangle: side . p = slope * near there.
    sides_ = {Side(right, (centre - half_width) / near_),
              Side(-right, -(centre + half_width) / near_),
              Side(up, (middle - half_height) / near_), Side(-up, -(middle + half_height) / near_)};
  }

  bool Meets(const Sphere& sphere) const {
    const Vector3d from_eye = sphere.centre - eye_;
    const double ahead = from_eye.dot(forward_);
    if (ahead + sphere.radius < near_ || ahead - sphere.radius > far_) return false;
    return std::all_of(sides_.begin(), sides_.end(),
                       [&](const Vector3d& side) { return from_eye.dot(side) >= -sphere.radius; });
  }

 private:
  // The inward normal of {p : axis . p = slope (forward . p)}.
  Vector3d Side(const Vector3d& axis, double slope) const {
    return (axis - slope * forward_).normalized();
  }

  Vector3d eye_, forward_;
  double near_, far_;
  std::vector<Vector3d> sides_;
};

Vector3d Position(const mjvGeom& geom) {
  return Eigen::Map<const Eigen::Vector3f>(geom.pos).cast<double>();
}

// MuJoCo mirrors in planes and in the upper z face of boxes alone.
bool IsMirror(const mjvGeom& geom) {
  return geom.reflectance > 0 && (geom.type == mjGEOM_PLANE || geom.type == mjGEOM_BOX);
}

// mjvGeom.mat is row-major.
Vector3d MirrorNormal(const mjvGeom& geom) {
  return Vector3d(geom.mat[2], geom.mat[5], geom.mat[8]);
}

Sphere MirrorImage(const Sphere& sphere, const mjvGeom& mirror) {
  const Vector3d normal = MirrorNormal(mirror);
  const double thickness = mirror.type == mjGEOM_PLANE ? 0 : mirror.size[2];
  const Vector3d surface = Position(mirror) + thickness * normal;
  return {sphere.centre - 2 * normal.dot(sphere.centre - surface) * normal, sphere.radius};
}

}  // namespace

void LeaveOutUnseen(const mjModel& model, double aspect, mjvScene& scene) {
  for (int i = 0; scene.flags[mjRND_SHADOW] && i < scene.nlight; ++i) {
    if (scene.lights[i].castshadow) return;
  }
  // Between the two eyes, where MuJoCo draws from without stereo.
  const Frustum frustum(mjv_averageCamera(scene.camera, scene.camera + 1), aspect);
  // What has no bounding sphere, such as a plane, is always seen.
  const auto has_sphere = [&](const mjvGeom& geom) {
    return geom.objtype == mjOBJ_GEOM && geom.objid >= 0 && model.geom_rbound[geom.objid] > 0;
  };
  const auto sphere_of = [&](const mjvGeom& geom) {
    return Sphere{Position(geom), 1.001 * model.geom_rbound[geom.objid]};
  };
  std::vector<const mjvGeom*> mirrors;
  for (int i = 0; scene.flags[mjRND_REFLECTION] && i < scene.ngeom; ++i) {
    const mjvGeom& geom = scene.geoms[i];
    if (IsMirror(geom) && (!has_sphere(geom) || frustum.Meets(sphere_of(geom))))
      mirrors.push_back(&geom);
  }
  std::vector<mjvGeom> seen;
  for (int i = 0; i < scene.ngeom; ++i) {
    const mjvGeom& geom = scene.geoms[i];
    const bool keep = !has_sphere(geom) || frustum.Meets(sphere_of(geom)) ||
                      std::any_of(mirrors.begin(), mirrors.end(), [&](const mjvGeom* mirror) {
                        return frustum.Meets(MirrorImage(sphere_of(geom), *mirror));
                      });
    if (keep) seen.push_back(geom);
  }
  std::copy(seen.begin(), seen.end(), scene.geoms);
  scene.ngeom = static_cast<int>(seen.size());
}

}  // namespace robostress
