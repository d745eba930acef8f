// What the error laws do at 2 ms sub-steps, as a Markdown table: the figures of
// docs/results/literal-laws.md.
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "common/check.h"
#include "sim_worker/panda_mjcf.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/panda_sim.h"

namespace robostress {
namespace {

constexpr char kWorld[] = R"(
<geom name="table" type="box" size="0.4 0.6 0.02" pos="0.55 0 -0.02"/>
<body name="cube" pos="0.4515 0 0.025"><freejoint name="cube"/>
  <geom name="cube" type="box" size="0.02 0.02 0.025" mass="0.1" friction="0.95 0.3 0.1"/></body>)";

SharedModel Model() {
  PandaScene scene;
  scene.base_position.setZero();
  scene.world_xml = kWorld;
  return CompileModel("consequences", ComposePandaScene(scene)).value();
}

std::unique_ptr<PandaSim> Start(const std::string& scenario, const JointErrorOptions& errors,
                                Stepping stepping = Stepping::kFast,
                                GoalReference reference = GoalReference::kAchieved,
                                int settle = 10) {
  SimOptions options;
  options.joint_errors = errors;
  options.stepping = stepping;
  options.goal_reference = reference;
  static const SharedModel& model = *new SharedModel(Model());
  auto sim = PandaSim::Create(model, options).value();
  sim->SetScenario(MakeScenario(scenario, 5).value(), 220);
  std::vector<double> qpos(model->qpos0, model->qpos0 + model->nq);
  const auto home = PandaHome();
  std::copy(home.data(), home.data() + 7, qpos.begin());
  RS_CHECK(sim->Reset(qpos, home).ok());
  RS_CHECK(sim->Settle(settle).ok());
  return sim;
}

Eigen::VectorXf Command(double x, double y, double z, double gripper) {
  Eigen::VectorXf command = Eigen::VectorXf::Zero(7);
  command[0] = static_cast<float>(x);
  command[1] = static_cast<float>(y);
  command[2] = static_cast<float>(z);
  command[6] = static_cast<float>(gripper);
  return command;
}

Eigen::Vector3d Tool(const PandaSim& sim) { return sim.Measure().tool.p_base_tool; }

// Zero command for 5 s: drift of the tool, largest joint speed at the end of a control step (mean).
void Hold(PandaSim& sim, double* dz_mm, double* dxy_mm, double* speed) {
  const Eigen::Vector3d before = Tool(sim);
  double sum = 0;
  for (int i = 0; i < 100; ++i) {
    RS_CHECK(sim.Step(Command(0, 0, 0, -1)).ok());
    sum += sim.Measure().dq.cwiseAbs().maxCoeff();
  }
  const Eigen::Vector3d moved = 1000 * (Tool(sim) - before);
  *dz_mm = moved.z();
  *dxy_mm = std::hypot(moved.x(), moved.y());
  *speed = sum / 100;
}

// Achieved over commanded displacement along +y over 16 control steps of one constant command.
double Gain(PandaSim& sim, double size) {
  const Eigen::Vector3d before = Tool(sim);
  for (int i = 0; i < 16; ++i) RS_CHECK(sim.Step(Command(0, size, 0, -1)).ok());
  return (Tool(sim) - before).y() / (16 * 0.05 * size);
}

// Grasp the cube, lift it and carry it to and fro for 60 steps: how far it has slipped in the hand
// [mm], or a negative number when it is lost.
double Slip(PandaSim& sim) {
  const mjModel& m = sim.model();
  const int cube = mj_name2id(&m, mjOBJ_BODY, "cube");
  const int hand = mj_name2id(&m, mjOBJ_SITE, "gripper0_grip_site");
  const auto cube_in_hand = [&] {
    using Map = Eigen::Map<const Eigen::Vector3d>;
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(sim.data().site_xmat +
                                                                           9 * hand);
    return Eigen::Vector3d(
        R.transpose() * (Map(sim.data().xpos + 3 * cube) - Map(sim.data().site_xpos + 3 * hand)));
  };
  // A closed loop to a height, strong enough for stiction and for the literal gravity error.
  const auto go_to = [&](const Eigen::Vector3d& target, double gripper, int steps) {
    for (int i = 0; i < steps; ++i) {
      const Eigen::Vector3d u = (20 * (target - Tool(sim))).cwiseMax(-1).cwiseMin(1);
      RS_CHECK(sim.Step(Command(u.x(), u.y(), u.z(), gripper)).ok());
    }
  };
  const Eigen::Vector3d start(0.4515, 0, 0.03);
  go_to(start, -1, 60);
  go_to(start, 1, 12);
  if (!sim.GraspDetected()) return -1;
  const Eigen::Vector3d before = cube_in_hand();
  for (int k = 0; k < 6; ++k) go_to({0.4515, k % 2 ? -0.1 : 0.1, 0.15 + 0.02 * k}, 1, 15);
  if (!sim.GraspDetected()) return -2;
  return 1000 * (cube_in_hand() - before).norm();
}

void Row(const std::string& title, const std::string& scenario, const JointErrorOptions& errors) {
  double dz, dxy, speed;
  Hold(*Start(scenario, errors), &dz, &dxy, &speed);
  std::printf("| %s | %+.1f | %.1f | %.4f |", title.c_str(), dz, dxy, speed);
  for (const double size : {0.05, 0.1, 0.2, 0.5, 1.0})
    std::printf(" %.3f |", Gain(*Start(scenario, errors), size));
  const double slip = Slip(*Start(scenario, errors));
  if (slip == -1) {
    std::printf(" not grasped |\n");
  } else if (slip == -2) {
    std::printf(" lost |\n");
  } else {
    std::printf(" %.1f mm |\n", slip);
  }
}

// Largest tool distance between two steppings over 200 control steps of a varied command [mm].
double SteppingDifference(const std::string& scenario, const JointErrorOptions& errors) {
  auto fast = Start(scenario, errors, Stepping::kFast),
       reference = Start(scenario, errors, Stepping::kReference);
  double worst = 0;
  for (int i = 0; i < 200; ++i) {
    const Eigen::VectorXf u = Command(0.4 * std::sin(0.07 * i), 0.6 * std::cos(0.05 * i),
                                      0.3 * std::sin(0.11 * i), i / 50 % 2 ? 1 : -1);
    RS_CHECK(fast->Step(u).ok() && reference->Step(u).ok());
    worst = std::max(worst, (Tool(*fast) - Tool(*reference)).norm());
  }
  return 1000 * worst;
}

int Main() {
  JointErrorOptions literal, tanh, stick, velocity, payload, equilibrium;
  tanh.friction_law = FrictionLaw::kTanh;
  stick.friction_law = FrictionLaw::kStick;
  velocity.offset_mode = OffsetMode::kVelocity;
  payload.gravity_sign = GravitySign::kPayload;
  equilibrium.offset_start = OffsetStart::kEquilibrium;

  std::printf(
      "| setting (severity 5) | dz after 5 s [mm] | dxy [mm] | joint speed [rad/s] | gain c=0.05 | "
      "0.1 | 0.2 | "
      "0.5 | 1.0 | slip of a held cube |\n|---|---|---|---|---|---|---|---|---|---|\n");
  Row("clean", "clean", literal);
  Row("nominal", "nominal", literal);
  Row("isolated_stribeck, sgn", "isolated_stribeck", literal);
  Row("isolated_stribeck, tanh", "isolated_stribeck", tanh);
  Row("isolated_stribeck, stick", "isolated_stribeck", stick);
  Row("isolated_backlash, teleport", "isolated_backlash", literal);
  Row("isolated_backlash, velocity", "isolated_backlash", velocity);
  Row("isolated_compliance, teleport", "isolated_compliance", literal);
  Row("isolated_compliance, velocity", "isolated_compliance", velocity);
  Row("isolated_compliance, equilibrium", "isolated_compliance", equilibrium);
  Row("isolated_gravity, literal", "isolated_gravity", literal);
  Row("isolated_gravity, payload", "isolated_gravity", payload);
  for (const std::string& name : ScenarioNames()) {
    if (!MakeScenario(name, 5)->deployment) continue;
    Row(name, name, literal);
    Row(name + ", velocity", name, velocity);
  }

  std::printf(
      "\n| fast against reference stepping, 200 control steps | largest tool distance [mm] "
      "|\n|---|---|\n");
  for (const char* name :
       {"clean", "nominal", "isolated_stribeck", "isolated_backlash", "isolated_compliance",
        "isolated_gravity", "thermal_drift_backlash", "aged_transmission", "aged_joint_uniform"}) {
    std::printf("| %s | %.4f |\n", name, SteppingDifference(name, literal));
  }
  std::printf("| aged_joint_uniform, velocity, stick | ");
  JointErrorOptions smooth = velocity;
  smooth.friction_law = FrictionLaw::kStick;
  std::printf("%.4f |\n", SteppingDifference("aged_joint_uniform", smooth));

  std::printf("\n| goal reference | gain c=0.1 | 0.5 | 1.0 |\n|---|---|---|---|\n");
  for (const GoalReference reference : {GoalReference::kAchieved, GoalReference::kDesired}) {
    std::printf("| %s |", reference == GoalReference::kAchieved ? "achieved" : "desired");
    for (const double size : {0.1, 0.5, 1.0}) {
      std::printf(" %.3f |", Gain(*Start("clean", literal, Stepping::kFast, reference), size));
    }
    std::printf("\n");
  }
  return 0;
}

}  // namespace
}  // namespace robostress

int main() { return robostress::Main(); }
