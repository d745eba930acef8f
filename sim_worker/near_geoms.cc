#include "sim_worker/near_geoms.h"

#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "absl/algorithm/container.h"

namespace robostress {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Which pairs collide, in what order and with what parameters is this version's.
constexpr int kMuJoCo = 222;

// Wider: the list is made more rarely, and holds more.
constexpr double kSlack = 0.02;                   // [m]
constexpr double kFarthestMove = 0.499 * kSlack;  // of each of the two
constexpr int kExpectedPairs = 4096;
constexpr int kMostIds = 1 << 16;

using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

Eigen::Map<const Vector3d> VectorAt(const mjtNum* values, int index) {
  return Eigen::Map<const Vector3d>(values + 3 * index);
}

Eigen::Map<const RowMajor> MatrixAt(const mjtNum* values, int index) {
  return Eigen::Map<const RowMajor>(values + 9 * index);
}

bool MayCollide(const mjModel& m, int a, int b) {
  return (m.geom_contype[a] & m.geom_conaffinity[b]) != 0 ||
         (m.geom_contype[b] & m.geom_conaffinity[a]) != 0;
}

bool Near(const Vector3d& between, double reach) {
  reach += kSlack;
  return between.squaredNorm() <= reach * reach;
}

uint64_t BodyPair(int a, int b) {
  return static_cast<uint64_t>(std::min(a, b)) << 16 | std::max(a, b);
}

// Whether the model has collisions that are none of geoms with bounding spheres and of still
// planes, or margins that shrink a body's box but not its geoms' contacts.
bool HasOwnRules(const mjModel& m) {
  if (mj_version() != kMuJoCo || m.npair > 0 || m.nbody >= kMostIds || m.ngeom >= kMostIds)
    return true;
  for (int geom = 0; geom < m.ngeom; ++geom) {
    const bool plane = m.geom_type[geom] == mjGEOM_PLANE;
    const bool mocap = m.body_mocapid[m.body_rootid[m.geom_bodyid[geom]]] >= 0;
    if (m.geom_type[geom] == mjGEOM_HFIELD || (plane && mocap) ||
        (!plane && m.geom_rbound[geom] <= 0) || m.geom_margin[geom] < 0)
      return true;
  }
  return false;
}

// The axes along which MuJoCo's broad phase sorts bodies, as rows: those of the spread of all geoms
// that are not the world's, with its order of additions.
Matrix3d SortingFrame(const mjModel& m, const mjData& data) {
  Vector3d mean = Vector3d::Zero();
  int count = 0;
  for (int geom = 0; geom < m.ngeom; ++geom) {
    if (m.geom_bodyid[geom] == 0) continue;
    mean += VectorAt(data.geom_xpos, geom);
    ++count;
  }
  for (int axis = 0; axis < 3; ++axis) mean[axis] /= count;
  RowMajor spread = RowMajor::Zero();
  for (int geom = 0; geom < m.ngeom; ++geom) {
    if (m.geom_bodyid[geom] == 0) continue;
    const Vector3d off = VectorAt(data.geom_xpos, geom) - mean;
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) spread(i, k) += off[i] * off[k];
  }
  for (int i = 0; i < 9; ++i) spread.data()[i] /= count;
  RowMajor axes;
  double eigenvalues[3], quaternion[4];
  mju_eig3(eigenvalues, axes.data(), quaternion, spread.data());
  return axes;
}

struct Box {
  Vector3d low, high;
};

// Of the bounding spheres of a body's geoms.
Box BoxOf(const mjModel& m, const mjData& data, const Matrix3d& frame, int body) {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  Box box = {Vector3d::Constant(kInfinite), Vector3d::Constant(-kInfinite)};
  for (int i = 0; i < m.body_geomnum[body]; ++i) {
    const int geom = m.body_geomadr[body] + i;
    for (int axis = 0; axis < 3; ++axis) {
      const Vector3d direction = frame.row(axis);
      const double centre = mju_dot3(data.geom_xpos + 3 * geom, direction.data());
      box.low[axis] = std::min(box.low[axis], centre - m.geom_rbound[geom] - m.geom_margin[geom]);
      box.high[axis] = std::max(box.high[axis], centre + m.geom_rbound[geom] + m.geom_margin[geom]);
    }
  }
  return box;
}

}  // namespace

NearGeoms::NearGeoms(const mjModel& model)
    : model_(model), usable_(!HasOwnRules(model)), shown_(model) {
  if (!usable_) return;
  has_plane_.resize(model.nbody);
  std::map<int, Group> groups;
  for (int id = 0; id < model.ngeom; ++id) {
    // One that touches nothing counts as well.
    if (model.geom_type[id] == mjGEOM_PLANE && model.geom_bodyid[id] != 0)
      has_plane_[model.geom_bodyid[id]] = true;
    if (model.geom_contype[id] == 0 && model.geom_conaffinity[id] == 0) continue;
    const int body = model.geom_bodyid[id], weld = model.body_weldid[body];
    Geom geom = {.id = id, .body = body, .margin = model.geom_margin[id]};
    geom.plane = model.geom_type[id] == mjGEOM_PLANE;
    geom.box = model.geom_type[id] == mjGEOM_BOX;
    geom.reach = geom.margin + model.geom_rbound[id];
    if (weld == 0) {
      fixed_.push_back(geom);
      continue;
    }
    Group& group = groups[weld];
    group.weld = weld;
    group.parent_weld = model.body_weldid[model.body_parentid[weld]];
    group.geoms.push_back(geom);
  }
  for (auto& [weld, group] : groups) {
    movers_.push_back({.body = weld});
    groups_.push_back(std::move(group));
  }
  for (int body = 1; body < model.nbody; ++body) {
    if (model.body_mocapid[body] >= 0) movers_.push_back({.body = body});
  }
  for (int i = 0; i < model.nexclude; ++i) {
    const int signature = model.exclude_signature[i];
    excluded_.push_back(BodyPair((signature >> 16) - 1, (signature & 0xFFFF) - 1));
  }
  absl::c_sort(excluded_);
  near_.reserve(kExpectedPairs);
  for (auto* values : {&dim_, &geom1_, &geom2_, &signature_}) values->reserve(kExpectedPairs);
  for (auto* values : {&margin_, &gap_}) values->reserve(kExpectedPairs);
  solref_.reserve(mjNREF * kExpectedPairs);
  solimp_.reserve(mjNIMP * kExpectedPairs);
  friction_.reserve(5 * kExpectedPairs);
}

bool NearGeoms::CanRun() const {
  return usable_ && mjcb_contactfilter == nullptr && model_.opt.collision != mjCOL_PAIR &&
         (model_.opt.enableflags & mjENBL_OVERRIDE) == 0;
}

void NearGeoms::Collide(mjData& data) {
  if (!CanRun()) return mj_collision(&model_, &data);
  if (((shown_.opt.disableflags ^ model_.opt.disableflags) & mjDSBL_FILTERPARENT) != 0) Forget();
  shown_.opt = model_.opt;
  shown_.opt.collision = mjCOL_PAIR;
  shown_.nconmax = model_.nconmax;
  if (!looked_ || Moved(data)) {
    Look(data);
    FindMeetings(data);
    UpdateMeetings(data);
    Show();
  } else if (UpdateMeetings(data)) {
    Show();
  }
  mj_collision(&shown_, &data);
}

bool NearGeoms::Moved(const mjData& data) const {
  return absl::c_any_of(movers_, [&](const Mover& mover) {
    const double shift = (VectorAt(data.xpos, mover.body) - mover.position).norm();
    const double turn = (MatrixAt(data.xmat, mover.body) - mover.turned).norm();
    return !(shift + turn * mover.radius <= kFarthestMove);
  });
}

void NearGeoms::Look(const mjData& data) {
  looked_ = true;
  near_.clear();
  for (Group& group : groups_) {
    group.centre.setZero();
    for (const Geom& geom : group.geoms) group.centre += VectorAt(data.geom_xpos, geom.id);
    group.centre /= static_cast<double>(group.geoms.size());
    group.radius = 0;
    for (const Geom& geom : group.geoms) {
      const double distance = (VectorAt(data.geom_xpos, geom.id) - group.centre).norm();
      group.radius = std::max(group.radius, distance + geom.reach);
    }
  }
  for (Mover& mover : movers_) {
    mover.position = VectorAt(data.xpos, mover.body);
    mover.turned = MatrixAt(data.xmat, mover.body);
    mover.radius = 0;
  }
  for (size_t i = 0; i < groups_.size(); ++i) {
    const Vector3d& origin = movers_[i].position;
    for (const Geom& geom : groups_[i].geoms) {
      const double distance = (VectorAt(data.geom_xpos, geom.id) - origin).norm();
      movers_[i].radius = std::max(movers_[i].radius, distance + geom.reach);
    }
  }
  for (auto mover = movers_.begin() + groups_.size(); mover != movers_.end(); ++mover) {
    for (const Geom& geom : fixed_) {
      if (model_.body_rootid[geom.body] != mover->body) continue;
      const double distance = (VectorAt(data.geom_xpos, geom.id) - mover->position).norm();
      mover->radius = std::max(mover->radius, distance + geom.reach);
    }
  }
  const bool apart_from_parents = (model_.opt.disableflags & mjDSBL_FILTERPARENT) == 0;
  for (auto group = groups_.begin(); group != groups_.end(); ++group) {
    LookAtFixed(data, *group);
    for (auto other = std::next(group); other != groups_.end(); ++other) {
      const bool parents = group->weld == other->parent_weld || other->weld == group->parent_weld;
      if (!(parents && apart_from_parents)) LookBetween(data, *group, *other);
    }
  }
  absl::c_sort(near_);
}

void NearGeoms::LookBetween(const mjData& data, const Group& group, const Group& other) {
  if (!Near(group.centre - other.centre, group.radius + other.radius)) return;
  for (const Geom& a : group.geoms) {
    if (!Near(VectorAt(data.geom_xpos, a.id) - other.centre, a.reach + other.radius)) continue;
    for (const Geom& b : other.geoms) {
      if (Touchable(data, a, b)) Add(a, b);
    }
  }
}

void NearGeoms::LookAtFixed(const mjData& data, const Group& group) {
  for (const Geom& a : fixed_) {
    const Vector3d position = VectorAt(data.geom_xpos, a.id);
    const Vector3d normal = MatrixAt(data.geom_xmat, a.id).col(2);
    const auto above = [&](const Vector3d& point, double reach) {
      return normal.dot(point - position) > a.reach + reach + kSlack;
    };
    if (a.plane ? above(group.centre, group.radius)
                : !Near(group.centre - position, a.reach + group.radius))
      continue;
    for (const Geom& b : group.geoms) {
      if (a.plane
              ? MayCollide(model_, a.id, b.id) && !above(VectorAt(data.geom_xpos, b.id), b.reach)
              : Touchable(data, a, b))
        Add(a, b);
    }
  }
}

bool NearGeoms::Touchable(const mjData& data, const Geom& a, const Geom& b) const {
  if (!MayCollide(model_, a.id, b.id)) return false;
  const Vector3d between = VectorAt(data.geom_xpos, b.id) - VectorAt(data.geom_xpos, a.id);
  if (!Near(between, a.reach + b.reach)) return false;
  const double room = kSlack + a.margin + b.margin;
  // Apart along an axis of a box, they are apart.
  const auto apart = [&](const Geom& box, const Geom& other) {
    const Matrix3d axes = MatrixAt(data.geom_xmat, box.id).transpose();
    const Vector3d half = VectorAt(model_.geom_size, box.id);
    Vector3d extent = Vector3d::Constant(other.reach - other.margin);
    if (other.box) {
      extent = (axes * MatrixAt(data.geom_xmat, other.id)).cwiseAbs() *
               VectorAt(model_.geom_size, other.id);
    }
    return ((axes * between).cwiseAbs() - half - extent).maxCoeff() > room;
  };
  return !(a.box && apart(a, b)) && !(b.box && apart(b, a));
}

void NearGeoms::Add(const Geom& a, const Geom& b) {
  const Geom &first = a.body < b.body ? a : b, &second = a.body < b.body ? b : a;
  const uint64_t bodies = BodyPair(a.body, b.body);
  if (absl::c_binary_search(excluded_, bodies)) return;
  near_.push_back(bodies << 32 | static_cast<uint64_t>(first.id) << 16 | second.id);
}

void NearGeoms::FindMeetings(const mjData& data) {
  meetings_.clear();
  // Of all geoms of a body, seen ones too: MuJoCo's box of it holds them.
  const auto reach = [&](int body) {
    double farthest = 0;
    for (int i = 0; i < model_.body_geomnum[body]; ++i) {
      const int geom = model_.body_geomadr[body] + i;
      const double distance = (VectorAt(data.geom_xpos, geom) - VectorAt(data.xpos, body)).norm();
      farthest = std::max(farthest,
                          distance + model_.geom_rbound[geom] + std::abs(model_.geom_margin[geom]));
    }
    return farthest;
  };
  uint64_t last = 0;
  for (const uint64_t pair : near_) {
    if (pair >> 32 == last) continue;
    last = pair >> 32;
    const int a = last >> 16, b = last & 0xFFFF;
    if (!has_plane_[a] && !has_plane_[b]) continue;
    meetings_.push_back({has_plane_[a] ? a : b, has_plane_[a] ? b : a, reach(a) + reach(b)});
  }
}

bool NearGeoms::UpdateMeetings(const mjData& data) {
  bool changed = false;
  std::optional<Matrix3d> frame;
  for (PlaneMeeting& meeting : meetings_) {
    const Vector3d between =
        VectorAt(data.xpos, meeting.body) - VectorAt(data.xpos, meeting.plane_body);
    bool twice = false;
    if (between.norm() <= 1.8 * meeting.reach) {
      if (!frame.has_value()) frame = SortingFrame(model_, data);
      twice = BoxesMeet(data, *frame, meeting.plane_body, meeting.body);
    }
    changed |= twice != meeting.twice;
    meeting.twice = twice;
  }
  return changed;
}

// To the bit, as MuJoCo's broad phase has it: boxes in its frame, the first axis in single
// precision, and where ends are equal the end of the body that comes first, comes first.
bool NearGeoms::BoxesMeet(const mjData& data, const Matrix3d& frame, int a, int b) const {
  const Box box_a = BoxOf(model_, data, frame, a), box_b = BoxOf(model_, data, frame, b);
  for (int axis = 1; axis < 3; ++axis) {
    if (box_a.low[axis] > box_b.high[axis] || box_a.high[axis] < box_b.low[axis]) return false;
  }
  const auto ends_before = [](const Box& box, int body, const Box& other, int other_body) {
    const auto end = static_cast<float>(box.high[0]), start = static_cast<float>(other.low[0]);
    return end < start || (end == start && body < other_body);
  };
  return !ends_before(box_a, a, box_b, b) && !ends_before(box_b, b, box_a, a);
}

void NearGeoms::Show() {
  for (auto* values : {&dim_, &geom1_, &geom2_, &signature_}) values->clear();
  for (auto* values : {&solref_, &solimp_, &margin_, &gap_, &friction_}) values->clear();
  for (auto pair = near_.begin(); pair != near_.end();) {
    const uint64_t bodies = *pair >> 32;
    const auto end = std::find_if(pair, near_.end(), [&](uint64_t p) { return p >> 32 != bodies; });
    const bool twice = absl::c_any_of(meetings_, [&](const PlaneMeeting& meeting) {
      return meeting.twice && BodyPair(meeting.plane_body, meeting.body) == bodies;
    });
    for (int time = 0; time < 1 + twice; ++time) {
      for (auto p = pair; p != end; ++p) {
        signature_.push_back(static_cast<int>(bodies) + (1 << 16) + 1);
        Describe(*p >> 16 & 0xFFFF, *p & 0xFFFF);
      }
    }
    pair = end;
  }
  shown_.npair = static_cast<int>(geom1_.size());
  shown_.pair_dim = dim_.data();
  shown_.pair_geom1 = geom1_.data();
  shown_.pair_geom2 = geom2_.data();
  shown_.pair_signature = signature_.data();
  shown_.pair_solref = solref_.data();
  shown_.pair_solimp = solimp_.data();
  shown_.pair_margin = margin_.data();
  shown_.pair_gap = gap_.data();
  shown_.pair_friction = friction_.data();
}

// MuJoCo's documentation, "Contact parameters".
void NearGeoms::Describe(int first, int second) {
  const mjModel& m = model_;
  geom1_.push_back(first);
  geom2_.push_back(second);
  const int a = m.geom_type[first] <= m.geom_type[second] ? first : second;
  const int b = first + second - a;
  margin_.push_back(std::max(m.geom_margin[a], m.geom_margin[b]));
  gap_.push_back(std::max(m.geom_gap[a], m.geom_gap[b]));
  const int stronger = m.geom_priority[a] == m.geom_priority[b]  ? -1
                       : m.geom_priority[a] > m.geom_priority[b] ? a
                                                                 : b;
  dim_.push_back(stronger < 0 ? std::max(m.geom_condim[a], m.geom_condim[b])
                              : m.geom_condim[stronger]);
  double share = 1;  // of a
  if (const double weight = m.geom_solmix[a], other = m.geom_solmix[b]; stronger >= 0) {
    share = stronger == a;
  } else if (weight >= mjMINVAL && other >= mjMINVAL) {
    share = weight / (weight + other);
  } else if (weight < mjMINVAL) {
    share = other < mjMINVAL ? 0.5 : 0;
  }
  const bool direct = m.geom_solref[mjNREF * a] <= 0 || m.geom_solref[mjNREF * b] <= 0;
  for (int i = 0; i < mjNREF; ++i) {
    const double of_a = m.geom_solref[mjNREF * a + i], of_b = m.geom_solref[mjNREF * b + i];
    solref_.push_back(stronger >= 0 ? m.geom_solref[mjNREF * stronger + i]
                      : direct      ? std::min(of_a, of_b)
                                    : share * of_a + (1 - share) * of_b);
  }
  for (int i = 0; i < mjNIMP; ++i) {
    solimp_.push_back(share * m.geom_solimp[mjNIMP * a + i] +
                      (1 - share) * m.geom_solimp[mjNIMP * b + i]);
  }
  const auto friction = [&](int i) {
    return stronger < 0 ? std::max(m.geom_friction[3 * a + i], m.geom_friction[3 * b + i])
                        : m.geom_friction[3 * stronger + i];
  };
  for (const int i : {0, 0, 1, 2, 2}) friction_.push_back(friction(i));
}

}  // namespace robostress
