#include "sim_worker/suites/initial_states.h"

#include "common/check.h"
#include "common/random.h"
#include "sim_worker/suites/shapes.h"

namespace robostress {
namespace {

constexpr double kJointNoise = 0.02;  // standard deviation [rad]
constexpr double kMinGap = 0.012;     // between footprints [m]
constexpr int kMaxDraws = 500;

int IndexOf(const SceneSpec& scene, const std::string& name) {
  for (size_t i = 0; i < scene.props.size(); ++i) {
    if (scene.props[i].name == name) return static_cast<int>(i);
  }
  RS_CHECK(false);
  return -1;
}

std::vector<Eigen::Vector3d> DrawPositions(const SceneSpec& scene, RandomStream& random) {
  std::vector<Eigen::Vector3d> positions;
  for (const Prop& prop : scene.props) {
    Eigen::Vector3d p(prop.position.x() + random.Uniform(-1, 1) * prop.jitter.x(),
                      prop.position.y() + random.Uniform(-1, 1) * prop.jitter.y(), 0);
    if (!prop.anchor.empty()) {
      const int anchor = IndexOf(scene, prop.anchor);
      p.head<2>() += positions[anchor].head<2>();
      if (prop.on_anchor)
        p.z() = positions[anchor].z() + ShapeOf(scene.props[anchor].kind).region.center.z();
    }
    positions.push_back(p);
  }
  return positions;
}

// Only what can be picked up must keep clear of the rest; landmarks have room by design.
bool KeepsClear(const SceneSpec& scene, const std::vector<Eigen::Vector3d>& positions) {
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!ShapeOf(scene.props[i].kind).graspable) continue;
    for (size_t j = 0; j < positions.size(); ++j) {
      if (i == j || (scene.props[i].on_anchor && scene.props[i].anchor == scene.props[j].name))
        continue;
      const double gap = (positions[i] - positions[j]).head<2>().norm() -
                         ShapeOf(scene.props[i].kind).radius - ShapeOf(scene.props[j].kind).radius;
      if (gap < kMinGap) return false;
    }
  }
  return true;
}

}  // namespace

Eigen::Matrix<double, 7, 1> EmbeddedHome() {
  // Inverse kinematics of the tool at (0.50, 0, 0.24) m, pointing straight down: q6 = q2 - q4.
  Eigen::Matrix<double, 7, 1> q;
  q << 0, -0.0142386, 0, -2.3507008, 0, 2.3364622, 0.7853981633974483;
  return q;
}

InitialState SampleInitialState(const SuiteSpec& suite, int task, int index) {
  const SceneSpec& scene = suite.scenes[suite.tasks[task].scene];
  RandomStream random(StreamKey("initial state").With(suite.name).With(task).With(index));
  InitialState state;
  state.q = EmbeddedHome();
  for (int j = 0; j < 7; ++j) state.q[j] += kJointNoise * random.Normal();
  for (int draw = 0; draw < kMaxDraws; ++draw) {
    state.positions = DrawPositions(scene, random);
    if (KeepsClear(scene, state.positions)) break;
  }
  return state;
}

}  // namespace robostress
