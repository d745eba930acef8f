#include "sim_worker/libero/box_contacts.h"

#include <Eigen/Core>
#include <atomic>
#include <cmath>
#include <mutex>

namespace robostress::libero {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr double kSlack = 1e-6;  // [m] of rounding

std::atomic<mjfCollision> mujocos{nullptr};

// Half the box's shadow on a direction.
double HalfShadow(const mjModel& model, const mjData& data, int geom, const Vector3d& direction) {
  const Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> frame(data.geom_xmat + 9 * geom);
  const Map<const Vector3d> size(model.geom_size + 3 * geom);
  return (frame.transpose() * direction).cwiseAbs().dot(size);
}

int Collide(const mjModel* model, const mjData* data, mjContact* contacts, int g1, int g2,
            mjtNum margin) {
  const int count = mujocos.load()(model, data, contacts, g1, g2, margin);
  return KeepPossible(*model, *data, g1, g2, contacts, count);
}

}  // namespace

int KeepPossible(const mjModel& model, const mjData& data, int g1, int g2, mjContact* contacts,
                 int count) {
  int kept = 0;
  for (int i = 0; i < count; ++i) {
    const Map<const Vector3d> normal(contacts[i].frame);
    const double apart = std::abs((Map<const Vector3d>(data.geom_xpos + 3 * g2) -
                                   Map<const Vector3d>(data.geom_xpos + 3 * g1))
                                      .dot(normal));
    const double overlap =
        HalfShadow(model, data, g1, normal) + HalfShadow(model, data, g2, normal) - apart;
    if (!(-contacts[i].dist <= overlap + kSlack)) continue;  // also where a number is none
    if (kept != i) contacts[kept] = contacts[i];
    ++kept;
  }
  return kept;
}

void LeaveOutImpossibleBoxContacts() {
  static std::once_flag once;
  std::call_once(once, [] {
    mujocos = mjCOLLISIONFUNC[mjGEOM_BOX][mjGEOM_BOX];
    mjCOLLISIONFUNC[mjGEOM_BOX][mjGEOM_BOX] = Collide;
  });
}

}  // namespace robostress::libero
