#include "robot_client/bridge/chain_model.h"

#include <algorithm>
#include <bitset>
#include <limits>
#include <map>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/status_macros.h"

namespace robostress::bridge {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kGravity = 9.81;      // [m/s^2]
constexpr int kFirstThatMayTouch = 1;  // the first link turns above its mounting
constexpr size_t kMostParts = 256;     // the control thread looks at most pairs of them
constexpr int kPoses = 1000;
constexpr size_t kMostly = 500;  // of the poses
constexpr int kNearlyAll = 950;
constexpr double kStays = 0.001;  // [m]

using LinkPoses = std::array<Eigen::Isometry3d, kMostJoints>;  // in the base frame, by joint

void Place(const ArmChain& chain, const ArmVector& position, LinkPoses& poses) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (size_t i = 0; i < chain.links.size(); ++i) {
    const ChainLink& link = chain.links[i];
    T = T * link.T_before_joint * Eigen::AngleAxisd(position[i], link.axis);
    poses[i] = T;
  }
}

// What turns with a link, -1: the base, in the base frame.
Eigen::Isometry3d Of(const LinkPoses& poses, int link) {
  return link < 0 ? Eigen::Isometry3d::Identity() : poses[static_cast<size_t>(link)];
}

double Between(const ArmChain& chain, const LinkPoses& poses, const std::pair<int, int>& pair,
               double enough = std::numeric_limits<double>::infinity()) {
  const LinkPart& a = chain.body[static_cast<size_t>(pair.first)];
  const LinkPart& b = chain.body[static_cast<size_t>(pair.second)];
  return Distance(a.shape, b.shape, Of(poses, a.link).inverse(Eigen::Isometry) * Of(poses, b.link),
                  enough);
}

double LowestOf(const Hull& shape, const Eigen::Isometry3d& T_base_link) {
  const Vector3d down = T_base_link.linear().row(2);
  double lowest = std::numeric_limits<double>::infinity();
  for (const Vector3d& corner : shape.corners) lowest = std::min(lowest, down.dot(corner));
  return lowest + T_base_link.translation().z() - shape.radius;
}

// Within the limits, by a fixed stream.
std::vector<ArmVector> PosesWithin(const ArmLimits& limits, size_t joints) {
  std::vector<ArmVector> poses(kPoses);
  std::mt19937_64 random(32);  // its numbers are the standard's
  for (ArmVector& pose : poses) {
    for (size_t j = 0; j < joints; ++j) {
      const double share = static_cast<double>(random() >> 11) * 0x1p-53;
      pose[j] = limits.lower[j] + share * (limits.upper[j] - limits.lower[j]);
    }
  }
  return poses;
}

// In which poses something is nearer than the margin; the last is home.
using Near = std::bitset<kPoses + 1>;

// How a pair's distance was over the poses [m].
struct Seen {
  std::pair<int, int> pair;
  LinkPair links;
  double least = std::numeric_limits<double>::infinity(), most = -least;
  Near near;
};

// Of one pair of links: leaves out those that are near at home, and while they are in most poses
// the one that is most often. In which poses one that is left is near.
Near LeaveNearOut(std::vector<Seen>* pairs) {
  std::erase_if(*pairs, [](const Seen& s) { return s.near[kPoses]; });
  while (true) {
    Near any;
    for (const Seen& s : *pairs) any |= s.near;
    if (any.count() <= kMostly) return any;
    pairs->erase(std::max_element(pairs->begin(), pairs->end(), [](const Seen& x, const Seen& y) {
      return x.near.count() < y.near.count();
    }));
  }
}

// Every pair of parts of links that no joint connects.
std::vector<Seen> PairsOf(const ArmChain& chain, const std::vector<LinkPair>& ignored) {
  std::vector<Seen> pairs;
  const int parts = static_cast<int>(chain.body.size());
  for (int a = 0; a < parts; ++a) {
    for (int b = 0; b < parts; ++b) {
      const LinkPair links{chain.body[a].link, chain.body[b].link};
      if (links.first + 2 <= links.second && chain.body[a].against_itself &&
          chain.body[b].against_itself &&
          std::find(ignored.begin(), ignored.end(), links) == ignored.end())
        pairs.push_back({{a, b}, links});
    }
  }
  return pairs;
}

// Leaves out of what is `against` a bound the parts that keep a link below `height` [m] in nearly
// all poses. False: the last link is.
bool LeaveOutBelow(double height, bool LinkPart::*against, const std::vector<LinkPoses>& poses,
                   ArmChain* chain, std::vector<LeftOut>* left_out) {
  left_out->clear();
  const int last = static_cast<int>(chain->links.size()) - 1;
  for (int link = kFirstThatMayTouch; link <= last; ++link) {
    std::vector<LinkPart*> parts;
    for (LinkPart& part : chain->body)
      if (part.link == link && part.*against) parts.push_back(&part);
    const auto low = [&](const LinkPart* part, const LinkPoses& pose) {
      return LowestOf(part->shape, Of(pose, link)) < height;
    };
    const auto times = [&](const LinkPart* part) {
      return std::count_if(poses.begin(), poses.end(),
                           [&](const LinkPoses& pose) { return low(part, pose); });
    };
    const auto any = [&](const LinkPoses& pose) {
      return std::any_of(parts.begin(), parts.end(),
                         [&](const LinkPart* part) { return low(part, pose); });
    };
    const size_t all = parts.size();
    while (std::count_if(poses.begin(), poses.end(), any) >= kNearlyAll) {
      if (link == last) return false;
      const auto lowest = std::max_element(
          parts.begin(), parts.end(),
          [&](const LinkPart* a, const LinkPart* b) { return times(a) < times(b); });
      (*lowest)->*against = false;
      parts.erase(lowest);
    }
    if (parts.size() < all) left_out->push_back({link, parts.empty()});
  }
  return true;
}

}  // namespace

void ChooseLinkPairs(const ArmLimits& limits, const std::vector<double>& home, double margin,
                     const std::vector<LinkPair>& ignored, ArmChain* chain) {
  chain->watched.clear();
  chain->too_near.clear();
  chain->partly_near.clear();
  chain->ignored = ignored;
  chain->touching = 0;
  if (chain->body.size() > kMostParts) return;
  const size_t joints = chain->links.size();
  std::vector<ArmVector> poses = PosesWithin(limits, joints);
  if (home.size() >= joints) std::copy_n(home.begin(), joints, poses.emplace_back().begin());
  std::vector<Seen> pairs = PairsOf(*chain, ignored);
  LinkPoses placed;
  for (size_t k = 0; k < poses.size(); ++k) {
    Place(*chain, poses[k], placed);
    for (Seen& s : pairs) {
      const double distance = Between(*chain, placed, s.pair);
      s.least = std::min(s.least, distance);
      s.most = std::max(s.most, distance);
      s.near[k] = distance < margin;
    }
  }
  std::map<LinkPair, std::vector<Seen>> by_links;
  // A distance that does not change cannot be driven to 0, and as the least it would hide others.
  for (Seen& s : pairs)
    if (s.most - s.least >= kStays) by_links[s.links].push_back(std::move(s));
  Near touching;
  size_t most = 0;
  for (auto& [links, parts] : by_links) {
    const size_t all = parts.size();
    const Near near = LeaveNearOut(&parts);
    if (parts.size() < all) (parts.empty() ? chain->too_near : chain->partly_near).push_back(links);
    for (const Seen& s : parts) chain->watched.push_back(s.pair);
    touching |= near;
    if (near.count() <= most) continue;
    most = near.count();
    chain->touching_most = links;
  }
  chain->touching = static_cast<double>(touching.count()) / kPoses;
}

absl::Status LeaveLowPartsOut(const ArmLimits& limits, const WorkspaceOptions& workspace,
                              ArmChain* chain) {
  std::vector<LinkPoses> poses(kPoses);
  size_t next = 0;
  for (const ArmVector& pose : PosesWithin(limits, chain->links.size()))
    Place(*chain, pose, poses[next++]);
  const auto watched = [&](const char* field, double z, bool LinkPart::*against,
                           std::vector<LeftOut>* left_out) {
    if (LeaveOutBelow(z + workspace.margin, against, poses, chain, left_out))
      return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("workspace.", field, " is ", z, " m and margin ", workspace.margin,
                     " m in the base frame: J", chain->links.size(),
                     ", which carries the tool, is below that in nearly all poses, so "
                     "nothing would keep it above; correct the height, or the margin"));
  };
  RS_RETURN_IF_ERROR(
      watched("table_z", workspace.table_z, &LinkPart::against_table, &chain->below_table));
  return watched("lower[2]", workspace.lower[2], &LinkPart::against_box, &chain->below_box);
}

ChainModel::ChainModel(ArmChain chain, const WorkspaceOptions& workspace)
    : chain_(std::move(chain)),
      table_z_(workspace.table_z),
      margin_(workspace.margin),
      lower_(workspace.lower[0], workspace.lower[1], workspace.lower[2]),
      upper_(workspace.upper[0], workspace.upper[1], workspace.upper[2]) {
  RS_CHECK(chain_.links.size() <= kMostJoints);
  RS_CHECK(chain_.watched.empty() || chain_.body.size() <= kMostParts);
  for (const LinkPart& part : chain_.body) {
    Vector3d low = part.shape.corners.front(), high = low;
    for (const Vector3d& corner : part.shape.corners)
      low = low.cwiseMin(corner), high = high.cwiseMax(corner);
    Reach reach{(low + high) / 2, 0};
    for (const Vector3d& corner : part.shape.corners)
      reach.radius = std::max(reach.radius, (corner - reach.centre).norm());
    reach.radius += part.shape.radius;
    reaches_.push_back(reach);
  }
}

ArmVector ChainModel::Torque(const ArmVector& position, const ArmVector& velocity,
                             const ArmVector& acceleration, double payload_kg) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  const size_t n = chain_.links.size();
  std::array<Vector3d, kMostJoints> force, moment;  // on a link, about its frame's origin
  std::array<Vector3d, kMostJoints> axes;           // in the base frame
  Vector3d w = Vector3d::Zero(), dw = Vector3d::Zero(), origin = Vector3d::Zero();
  Vector3d dv(0, 0, kGravity);  // the base falls upwards: gravity
  for (size_t i = 0; i < n; ++i) {
    const ChainLink& link = chain_.links[i];
    const Matrix3d R = poses[i].linear();
    const Vector3d axis = axes[i] = R * link.axis;
    const Vector3d r = poses[i].translation() - origin;
    dv += dw.cross(r) + w.cross(w.cross(r));
    dw += axis * acceleration[i] + w.cross(axis * velocity[i]);
    w += axis * velocity[i];
    origin = poses[i].translation();
    const auto inertial = [&](double mass, const Vector3d& c) -> Vector3d {
      return mass * (dv + dw.cross(c) + w.cross(w.cross(c)));
    };
    const Vector3d c = R * link.centre;
    const Matrix3d I = R * link.inertia * R.transpose();
    force[i] = inertial(link.mass, c);
    moment[i] = c.cross(force[i]) + I * dw + w.cross(I * w);
    if (i + 1 < n) continue;
    const Vector3d tool = R * chain_.tool;
    const Vector3d carried = inertial(payload_kg, tool);
    force[i] += carried;
    moment[i] += tool.cross(carried);
  }
  ArmVector torque{};
  Vector3d f = Vector3d::Zero(), m = Vector3d::Zero();
  for (size_t i = n; i-- > 0;) {
    if (i + 1 < n) m += (poses[i + 1].translation() - poses[i].translation()).cross(f);
    f += force[i];
    m += moment[i];
    torque[i] = axes[i].dot(m);
  }
  return torque;
}

ArmModel::Clearance ChainModel::ClearanceAt(const ArmVector& position) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  Clearance clearance;
  clearance.fill(std::numeric_limits<double>::infinity());
  double table = std::numeric_limits<double>::infinity();
  for (const LinkPart& part : chain_.body) {
    if (part.link < kFirstThatMayTouch || !(part.against_table || part.against_box)) continue;
    const Eigen::Isometry3d& T = poses[static_cast<size_t>(part.link)];
    Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity()), high = -low;
    for (const Vector3d& corner : part.shape.corners) {
      const Vector3d p = T * corner;
      low = low.cwiseMin(p), high = high.cwiseMax(p);
    }
    if (part.against_table) table = std::min(table, low.z() - part.shape.radius);
    for (int axis = 0; axis < 3 && part.against_box; ++axis) {
      double &below = clearance[kBox + axis], &above = clearance[kBox + 3 + axis];
      below = std::min(below, low[axis] - lower_[axis] - part.shape.radius - margin_);
      above = std::min(above, upper_[axis] - high[axis] - part.shape.radius - margin_);
    }
  }
  clearance[kTable] = table - table_z_ - margin_;
  clearance[kItself] = Nearest(poses, nullptr) - margin_;
  return clearance;
}

std::string ChainModel::NearestParts(const ArmVector& position) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  if (chain_.watched.empty()) return "";
  std::pair<int, int> nearest;
  Nearest(poses, &nearest);
  return LinkPairName({chain_.body[nearest.first].link, chain_.body[nearest.second].link});
}

double ChainModel::Nearest(const LinkPoses& poses, std::pair<int, int>* pair) const {
  if (chain_.watched.empty()) return std::numeric_limits<double>::infinity();
  std::array<Vector3d, kMostParts> centres;
  for (size_t i = 0; i < reaches_.size(); ++i)
    centres[i] = Of(poses, chain_.body[i].link) * reaches_[i].centre;
  // The parts themselves are no nearer than the balls that hold them.
  const auto at_least = [&](const std::pair<int, int>& p) {
    return (centres[p.first] - centres[p.second]).norm() - reaches_[p.first].radius -
           reaches_[p.second].radius;
  };
  double nearest = std::numeric_limits<double>::infinity();
  const auto look = [&](const std::pair<int, int>& p) {
    const double distance = Between(chain_, poses, p, nearest);
    if (distance >= nearest) return;
    nearest = distance;
    if (pair != nullptr) *pair = p;
  };
  const auto first =
      std::min_element(chain_.watched.begin(), chain_.watched.end(),
                       [&](const auto& a, const auto& b) { return at_least(a) < at_least(b); });
  look(*first);
  for (const auto& p : chain_.watched)
    if (at_least(p) < nearest) look(p);
  return nearest;
}

Vector3d ChainModel::ToolAt(const ArmVector& position) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  return poses[chain_.links.size() - 1] * chain_.tool;
}

}  // namespace robostress::bridge
