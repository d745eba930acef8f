// Sub-steps per second of the one-joint kernel beside bare mj_step on the same pendulum with the
// same step, in one run and CPU time. Run alone on a core:
//   calibration_kernel_benchmark
// "of_bare" is the kernel's speed relative to MuJoCo's.
#include <benchmark/benchmark.h>
#include <mujoco/mujoco.h>

#include <cmath>
#include <ctime>
#include <filesystem>

#include "calibration/model/joint_simulation.h"
#include "common/atomic_file.h"
#include "common/check.h"

namespace robostress::calibration {
namespace {

constexpr double kStep = 1e-3;  // [s] of both
constexpr int kRowsPerSecond = 200, kRows = 2000;
constexpr double kKp = 60, kKd = 2.5;

std::string Mjcf(bool dry) {
  return std::string(
             "<mujoco><option timestep=\"0.001\"/><worldbody><body><joint name=\"hinge\" "
             "axis=\"0 1 0\" armature=\"0.01\" damping=\"0.1\"") +
         (dry ? " frictionloss=\"0.3\"" : "") +
         "/><inertial pos=\"0 0 -0.2\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/>"
         "</body></worldbody></mujoco>";
}

double Command(double t) { return 0.8 * std::sin(2 * M_PI * 0.7 * t); }

double CpuSeconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// The pendulum with the servo's torque as an applied force.
double BareSeconds(const mjModel* model, mjData* data) {
  mj_resetData(model, data);
  const double begin = CpuSeconds();
  const int sub_steps = static_cast<int>(std::lround(1.0 / kRowsPerSecond / kStep));
  for (int row = 0; row < kRows; ++row) {
    const double command = Command(static_cast<double>(row) / kRowsPerSecond);
    for (int i = 0; i < sub_steps; ++i) {
      data->qfrc_applied[0] = kKp * (command - data->qpos[0]) - kKd * data->qvel[0];
      mj_step(model, data);
    }
  }
  benchmark::DoNotOptimize(data->qpos[0]);
  return CpuSeconds() - begin;
}

// dry: with dry friction; every_effect: with one effect of the library per stage beside it.
void Kernel(benchmark::State& state, bool dry, bool every_stage) {
  const std::string file =
      (std::filesystem::temp_directory_path() / "calibration_kernel_benchmark.xml").string();
  RS_CHECK(WriteFileAtomically(file, Mjcf(dry)).ok());
  Rig rig;
  rig.model = file;
  RigJoint joint;
  joint.name = "hinge";
  joint.servo.kp = kKp, joint.servo.kd = kKd;
  rig.joints = {joint};
  const auto plant = Plant::Load(rig);
  RS_CHECK(plant.ok());

  MeasuredLog log;
  log.dt = 1.0 / kRowsPerSecond, log.rows = kRows;
  JointRecord record;
  for (int row = 0; row < kRows; ++row) {
    const double t = row * log.dt;
    record.command.push_back(Command(t));
    record.q.push_back(Command(t));
    record.q_smooth.push_back(Command(t));
    record.dq.push_back((Command(t + 1e-4) - Command(t - 1e-4)) / 2e-4);
    record.ddq.push_back(0);
  }
  log.joints = {record};
  JointTrack track;
  track.log = &log;
  track.single = true;
  track.rows = (*plant)->Rows(0, log);
  auto model = DeclaredModel(rig, **plant, 0);
  RS_CHECK(model.ok());
  if (every_stage) {
    const auto add = [&](const char* type, std::vector<double> values) {
      EffectInstance instance;
      instance.info = *FindEffect(type);
      instance.values = std::move(values);
      model->effects.push_back(std::move(instance));
    };
    add("servo_lag", {0.01});
    add("deadzone", {0.05});
    add("stribeck_friction", {0.3, 0.5, 0.1, 0.2});
    add("backlash", {0.005});
    add("encoder_gain", {0.01});
  }

  char error[1000] = "";
  mjModel* bare = mj_loadXML(file.c_str(), nullptr, error, sizeof error);
  RS_CHECK(bare != nullptr);
  mjData* data = mj_makeData(bare);
  JointSimulation simulation(track);
  std::vector<double> predicted(kRows);
  double ours = 0, theirs = 0;
  for ([[maybe_unused]] auto _ : state) {
    const double begin = CpuSeconds();
    simulation.Predict(*model, 0, {}, {}, absl::MakeSpan(predicted));
    benchmark::DoNotOptimize(predicted.data());
    const double taken = CpuSeconds() - begin;
    ours += taken;
    theirs += BareSeconds(bare, data);
    state.SetIterationTime(taken);
  }
  const double steps = static_cast<double>(state.iterations()) * kRows / kRowsPerSecond / kStep;
  state.counters["steps/s"] = steps / ours;
  state.counters["bare/s"] = steps / theirs;
  state.counters["of_bare"] = theirs / ours;
  mj_deleteData(data);
  mj_deleteModel(bare);
  std::filesystem::remove(file);
}

BENCHMARK_CAPTURE(Kernel, smooth, false, false)->UseManualTime()->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Kernel, dry_friction, true, false)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Kernel, an_effect_per_stage, true, true)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress::calibration

BENCHMARK_MAIN();
