// Random episodes under every scenario on the embedded suites' scenes: is every state finite, does
// MuJoCo warn, do the error laws keep their bounds, how fast does the arm get? Prints the table of
// docs/results/joint-error-stability.md; exits with 1 if anything is violated.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "common/command_line.h"
#include "common/joint_errors/joint_chain.h"
#include "common/random.h"
#include "common/run_main.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {
namespace {

struct CommandLine {
  int episodes = 1000, steps = 60, settle = 10, level = 5, seed = 0;
  std::vector<std::string> scenarios;
};

constexpr const char* kSuites[] = {"tabletop_spatial", "tabletop_object", "tabletop_goal",
                                   "tabletop_long"};
constexpr int kTasks = 10;  // of each suite

// Of a second-order system with damping ratio 0.70 under a load within +-L, |eta| <= G L / K with
// G = (1 + r) / (1 - r), r = exp(-pi zeta / sqrt(1 - zeta^2)) the overshoot: the integral of the
// impulse response's magnitude.
double DeflectionGain() {
  const double zeta = 0.70, r = std::exp(-M_PI * zeta / std::sqrt(1 - zeta * zeta));
  return (1 + r) / (1 - r);
}

// What was seen over the episodes of a scenario. Shares are of their bounds.
struct Extremes {
  double joint_speed = 0;     // [rad/s]
  double kinetic_energy = 0;  // of the arm [J]
  double potential_low = std::numeric_limits<double>::infinity(), potential_high = -potential_low;
  double torque_share = 0, backlash_share = 0, deflection_share = 0;
  int not_finite = 0, warnings = 0, failed_steps = 0;
  int held_episodes = 0;
  int64_t control_steps = 0;

  bool Violated() const {
    constexpr double kRounding = 1e-9;
    return not_finite > 0 || warnings > 0 || failed_steps > 0 || torque_share > 1 + kRounding ||
           backlash_share > 1 + kRounding || deflection_share > 1 + kRounding;
  }
};

// Looks at one simulator after every sub-step.
class Watch {
 public:
  explicit Watch(PandaSim& sim) : sim_(sim), panda_(PandaModel::Find(sim.model()).value()) {
    sim.OnSubStep([this] { Look(); });
  }
  void StartEpisode(Extremes* extremes) {
    extremes_ = extremes;
    softest_.setConstant(std::numeric_limits<double>::infinity());
  }
  void EndEpisode() {
    for (const mjWarningStat& warning : sim_.data().warning) extremes_->warnings += warning.number;
  }

 private:
  void Look() {
    const mjModel& m = sim_.model();
    const mjData& d = sim_.data();
    const auto finite = [](const double* x, int n) {
      return std::all_of(x, x + n, [](double value) { return std::isfinite(value); });
    };
    extremes_->not_finite +=
        !(finite(d.qpos, m.nq) && finite(d.qvel, m.nv) && finite(d.ctrl, m.nu));
    LookAtEnergy(m, d);
    LookAtBounds(d);
  }

  void LookAtEnergy(const mjModel& m, const mjData& d) {
    ReadArm(m, d, panda_, arm_);
    Extremes& e = *extremes_;
    e.joint_speed = std::max(e.joint_speed, arm_.dq.cwiseAbs().maxCoeff());
    e.kinetic_energy = std::max(e.kinetic_energy, 0.5 * arm_.dq.dot(arm_.M * arm_.dq));
    const int link1 = m.jnt_bodyid[panda_.joint[0]];
    const double potential =
        -m.body_subtreemass[link1] * mju_dot3(m.opt.gravity, d.subtree_com + 3 * link1);
    e.potential_low = std::min(e.potential_low, potential);
    e.potential_high = std::max(e.potential_high, potential);
  }

  void LookAtBounds(const mjData& d) {
    const JointChain& errors = sim_.joint_chain();
    Extremes& e = *extremes_;
    for (int j = 0; j < 7; ++j) {
      const JointErrorParameters& p = errors.severity().parameters()[j];
      const double limit = panda_.torque_limit[j];
      // Stiffness returns at once when an object is let go; a deflection then decays from what the
      // softest spring of the episode allowed.
      softest_[j] = std::min(softest_[j], p.K);
      e.torque_share = std::max(e.torque_share, std::abs(d.ctrl[panda_.motor[j]]) / limit);
      e.backlash_share =
          std::max(e.backlash_share, std::abs(errors.error_offset(kPaperBacklash, j)) / p.B);
      e.deflection_share =
          std::max(e.deflection_share, std::abs(errors.error_offset(kPaperCompliance, j)) *
                                           softest_[j] / (DeflectionGain() * limit));
    }
  }

  PandaSim& sim_;
  const PandaModel panda_;
  ArmState arm_;
  Extremes* extremes_ = nullptr;
  Vector7d softest_;  // [Nm/rad], so far in the episode
};

// Smooth wandering in +-1, two sines per axis, and a gripper that toggles at random times.
class RandomCommand {
 public:
  explicit RandomCommand(const StreamKey& key) : random_(key) {
    for (int i = 0; i < 6; ++i) {
      for (Sine& sine : axes_[i]) {
        sine = {random_.Uniform(0, 0.5), random_.Uniform(0.2, 3), random_.Uniform(0, 2 * M_PI)};
      }
    }
  }
  Eigen::VectorXf At(int step) {
    Eigen::VectorXf command(7);
    for (int i = 0; i < 6; ++i) {
      double value = 0;
      for (const Sine& s : axes_[i]) {
        value += s.amplitude * std::sin(2 * M_PI * s.frequency * 0.05 * step + s.phase);
      }
      command[i] = static_cast<float>(value);
    }
    if (step >= next_toggle_) {
      closed_ = !closed_;
      next_toggle_ = step + 5 + random_.UniformInt(25);
    }
    command[6] = closed_ ? 1 : -1;
    return command;
  }

 private:
  struct Sine {
    double amplitude, frequency, phase;  // [1], [Hz], [rad]
  };
  RandomStream random_;
  Sine axes_[6][2];
  int next_toggle_ = 0;
  bool closed_ = true;
};

// Every second episode follows the scripted expert, disturbed, so that objects are reached and
// held.
Eigen::VectorXf NextCommand(const EmbeddedTask& task, RandomCommand& random, bool expert,
                            int step) {
  const Eigen::VectorXf wander = random.At(step);
  if (!expert) return wander;
  Eigen::VectorXf command = task.Decide().command;
  command.head<3>() += 0.3F * wander.head<3>();
  return command;
}

void RunEpisode(const CommandLine& line, const Scenario& scenario, int episode, EmbeddedTask& task,
                Watch& watch, Extremes& extremes) {
  RandomCommand random(
      StreamKey("error_stability").With(line.seed).With(scenario.name).With(episode));
  task.sim().SetScenario(scenario, line.steps);
  watch.StartEpisode(&extremes);
  absl::Status status = task.Reset(kFirstTrainingDraw + episode);
  bool held = false;
  for (int step = 0; status.ok() && step < line.steps; ++step) {
    status = task.Step(NextCommand(task, random, episode % 2 == 1, step));
    ++extremes.control_steps;
    held |= task.sim().GraspDetected();
  }
  extremes.held_episodes += held;
  if (!status.ok()) {
    ++extremes.failed_steps;
    std::fprintf(stderr, "%s, episode %d: %s\n", scenario.name.c_str(), episode,
                 std::string(status.message()).c_str());
  }
  watch.EndEpisode();
}

void PrintRow(const Scenario& scenario, const Extremes& e) {
  const auto share = [](bool on, double value) {
    return on ? absl::StrFormat("%.3f", value) : std::string("–");
  };
  absl::PrintF("| %s | %d | %d | %.2f | %.2f | %.1f | %.3f | %s | %s | %d | %d |\n", scenario.name,
               e.control_steps, e.held_episodes, e.joint_speed, e.kinetic_energy,
               e.potential_high - e.potential_low, e.torque_share,
               share(scenario.backlash_on, e.backlash_share),
               share(scenario.compliance_on, e.deflection_share), e.not_finite,
               e.warnings + e.failed_steps);
  std::fflush(stdout);
}

// The forty tasks of the embedded suites, each compiled when it is first asked for.
class Tasks {
 public:
  struct Entry {
    std::unique_ptr<EmbeddedTask> task;
    std::unique_ptr<Watch> watch;
  };
  explicit Tasks(int settle_steps) : settle_steps_(settle_steps) {}
  // Every task twice, wandering and with the expert, then the next.
  Entry& OfEpisode(int episode) {
    constexpr int kCount = kTasks * static_cast<int>(std::size(kSuites));
    const int index = episode / 2 % kCount;
    Entry& entry = entries_[index];
    if (entry.task == nullptr) {
      UnitConfig unit;
      unit.suite = kSuites[index / kTasks];
      unit.sim.settle_steps = settle_steps_;
      entry.task = EmbeddedTask::Create(unit, index % kTasks).value();
      entry.watch = std::make_unique<Watch>(entry.task->sim());
    }
    return entry;
  }

 private:
  int settle_steps_;
  std::map<int, Entry> entries_;
};

int Run(const CommandLine& line) {
  Tasks tasks(line.settle);
  std::printf(
      "%d episodes of %d + %d control steps each, severity L%d, seed %d\n\n"
      "| scenario | control steps | episodes with an object held | joint speed [rad/s] | kinetic "
      "energy [J] | potential energy, range [J] | torque / limit | backlash / B | deflection / "
      "bound | not finite | warnings |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
      line.episodes, line.settle, line.steps, line.level, line.seed);
  bool violated = false;
  for (const std::string& name : line.scenarios) {
    const absl::StatusOr<Scenario> scenario = MakeScenario(name, line.level);
    if (!scenario.ok()) {
      std::fprintf(stderr, "error_stability: %s\n",
                   std::string(scenario.status().message()).c_str());
      return 2;
    }
    Extremes extremes;
    for (int episode = 0; episode < line.episodes; ++episode) {
      Tasks::Entry& entry = tasks.OfEpisode(episode);
      RunEpisode(line, *scenario, episode, *entry.task, *entry.watch, extremes);
    }
    PrintRow(*scenario, extremes);
    violated |= extremes.Violated();
  }
  return violated ? 1 : 0;
}

int Main(int argc, char** argv) {
  cli::App app(
      "Runs random episodes under every scenario and reports what the arm and the error laws did.\n"
      "Example:\n  error_stability --episodes 1000 --steps 60");
  CommandLine line;
  for (const std::string& name : ScenarioNames()) {
    if (name != "dev_mixed") line.scenarios.push_back(name);
  }
  app.add_option("--episodes", line.episodes, "episodes per scenario")->capture_default_str();
  app.add_option("--steps", line.steps, "control steps per episode, also the length of a ramp")
      ->check(cli::PositiveNumber())
      ->capture_default_str();
  app.add_option("--settle", line.settle, "control steps with a zero command before an episode")
      ->check(cli::NonNegativeNumber())
      ->capture_default_str();
  app.add_option("--level", line.level, "severity level, 1 (mild) to 5 (full)")
      ->capture_default_str();
  app.add_option("--seed", line.seed, "of the commands")->capture_default_str();
  app.add_option("--scenarios", line.scenarios, "names as printed by robostress scenarios");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  return Run(line);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
