#include "robot_client/bridge/chain_model.h"

#include <algorithm>
#include <limits>
#include <map>
#include <random>
#include <set>
#include <utility>
#include <variant>

#include "common/check.h"

namespace robostress::bridge {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kGravity = 9.81;         // [m/s^2]
constexpr size_t kFirstThatMayTouch = 1;  // the first link turns above its mounting
constexpr size_t kMostParts = 128;        // the control thread looks at most pairs of them
constexpr int kPoses = 1000;
constexpr int kNearlyAll = 950;   // of the poses
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

using Parts = std::array<std::variant<Capsule, Box>, kMostParts>;

// The chain's body in the base frame.
void PlaceBody(const ArmChain& chain, const LinkPoses& poses, Parts& parts) {
  for (size_t i = 0; i < chain.body.size(); ++i) {
    const auto& [link, shape] = chain.body[i];
    parts[i] = shape;
    if (link < 0) continue;
    auto& capsule = std::get<Capsule>(parts[i]);  // only the base has boxes
    const Eigen::Isometry3d& T = poses[static_cast<size_t>(link)];
    capsule.from = T * capsule.from;
    capsule.to = T * capsule.to;
  }
}

// The first may be the base's.
double Between(const Parts& parts, const std::pair<int, int>& pair) {
  const Capsule& second = std::get<Capsule>(parts[static_cast<size_t>(pair.second)]);
  return std::visit([&](const auto& first) { return Distance(first, second); },
                    parts[static_cast<size_t>(pair.first)]);
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

// How a pair's distance was over the poses [m].
struct Seen {
  std::pair<int, int> pair;
  LinkPair links;
  double least = std::numeric_limits<double>::infinity(), most = -least;
  int too_near = 0;
};

// Every pair of parts of links that no joint connects.
std::vector<Seen> PairsOf(const ArmChain& chain, const std::vector<LinkPair>& ignored) {
  std::vector<Seen> pairs;
  const int parts = static_cast<int>(chain.body.size());
  for (int a = 0; a < parts; ++a) {
    for (int b = 0; b < parts; ++b) {
      const LinkPair links{chain.body[a].link, chain.body[b].link};
      if (links.first + 2 <= links.second &&
          std::find(ignored.begin(), ignored.end(), links) == ignored.end())
        pairs.push_back({{a, b}, links});
    }
  }
  return pairs;
}

}  // namespace

void ChooseLinkPairs(const ArmLimits& limits, const std::vector<double>& home, double margin,
                     const std::vector<LinkPair>& ignored, ArmChain* chain) {
  chain->watched.clear();
  chain->too_near.clear();
  chain->ignored = ignored;
  chain->touching = 0;
  if (chain->body.size() > kMostParts) return;
  const size_t joints = chain->links.size();
  std::vector<ArmVector> poses = PosesWithin(limits, joints);
  LinkPoses placed;
  Parts parts;
  const auto place = [&](const ArmVector& pose) {
    Place(*chain, pose, placed);
    PlaceBody(*chain, placed, parts);
  };
  std::vector<Seen> pairs = PairsOf(*chain, ignored);
  const auto look = [&](const ArmVector& pose, int weight) {
    place(pose);
    for (Seen& s : pairs) {
      const double distance = Between(parts, s.pair);
      s.least = std::min(s.least, distance);
      s.most = std::max(s.most, distance);
      s.too_near += distance < margin ? weight : 0;
    }
  };
  for (const ArmVector& pose : poses) look(pose, 1);
  if (home.size() >= joints) {
    ArmVector pose{};
    std::copy_n(home.begin(), joints, pose.begin());
    look(pose, kPoses);
  }
  // A distance that does not change cannot be driven to 0, and as the least it would hide others.
  std::erase_if(pairs, [](const Seen& s) { return s.most - s.least < kStays; });
  std::set<LinkPair> watched, near;
  for (const Seen& s : pairs) (s.too_near < kNearlyAll ? watched : near).insert(s.links);
  for (const LinkPair& links : near)
    if (watched.count(links) == 0) chain->too_near.push_back(links);
  std::erase_if(pairs, [](const Seen& s) { return s.too_near >= kNearlyAll; });
  for (const Seen& s : pairs) chain->watched.push_back(s.pair);

  std::map<LinkPair, int> touches;
  int touched = 0, most = 0;
  for (const ArmVector& pose : poses) {
    place(pose);
    std::set<LinkPair> here;
    for (const Seen& s : pairs)
      if (Between(parts, s.pair) < margin) here.insert(s.links);
    touched += here.empty() ? 0 : 1;
    for (const LinkPair& links : here) {
      if (++touches[links] <= most) continue;
      most = touches[links];
      chain->touching_most = links;
    }
  }
  chain->touching = static_cast<double>(touched) / kPoses;
}

ChainModel::ChainModel(ArmChain chain, const WorkspaceOptions& workspace)
    : chain_(std::move(chain)),
      table_z_(workspace.table_z),
      margin_(workspace.margin),
      lower_(workspace.lower[0], workspace.lower[1], workspace.lower[2]),
      upper_(workspace.upper[0], workspace.upper[1], workspace.upper[2]) {
  RS_CHECK(chain_.links.size() <= kMostJoints);
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
  for (size_t i = kFirstThatMayTouch; i < chain_.links.size(); ++i) {
    for (const Ball& ball : chain_.links[i].shape) {
      const Vector3d p = poses[i] * ball.centre;
      const double inside = std::min((p - lower_).minCoeff(), (upper_ - p).minCoeff());
      clearance[kTable] = std::min(clearance[kTable], p.z() - ball.radius - table_z_ - margin_);
      clearance[kBox] = std::min(clearance[kBox], inside - ball.radius - margin_);
    }
  }
  if (chain_.watched.empty()) return clearance;
  Parts parts;
  PlaceBody(chain_, poses, parts);
  for (const auto& pair : chain_.watched)
    clearance[kItself] = std::min(clearance[kItself], Between(parts, pair) - margin_);
  return clearance;
}

std::string ChainModel::NearestParts(const ArmVector& position) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  Parts parts;
  PlaceBody(chain_, poses, parts);
  const auto nearer = [&](const auto& a, const auto& b) {
    return Between(parts, a) < Between(parts, b);
  };
  const auto nearest = std::min_element(chain_.watched.begin(), chain_.watched.end(), nearer);
  if (nearest == chain_.watched.end()) return "";
  return LinkPairName({chain_.body[nearest->first].link, chain_.body[nearest->second].link});
}

Vector3d ChainModel::ToolAt(const ArmVector& position) const {
  LinkPoses poses;
  Place(chain_, position, poses);
  return poses[chain_.links.size() - 1] * chain_.tool;
}

}  // namespace robostress::bridge
