// What a control step costs and what of it is ours. Run alone on a core:
//   sim_bench [--benchmark_filter=...]
// "of_bare" is the speed of a control step relative to 25 bare mj_step over the same states,
// interleaved, in CPU time. LIBERO's scenes: libero_bench.
#include <benchmark/benchmark.h>

#include <string>

#include "common/check.h"
#include "sim_worker/bench/arm_parts.h"
#include "sim_worker/bench/bare_steps.h"
#include "sim_worker/panda_mjcf.h"
#include "sim_worker/panda_sim.h"
#include "sim_worker/renderer.h"

namespace robostress {
namespace {

// As light as an embedded suite: a table, a static cabinet with a drawer, three free objects.
constexpr char kWorld[] = R"(
<light pos="0.5 0 2" dir="0 0 -1" directional="true"/>
<camera name="agentview" pos="1.3 0 0.8" xyaxes="0 1 0 -0.6 0 0.8" fovy="45"/>
<geom name="table" type="box" size="0.4 0.6 0.02" pos="0.55 0 -0.02" rgba="0.7 0.55 0.4 1"/>
<body name="cabinet" pos="0.6 0.4 0.1"><geom type="box" size="0.1 0.1 0.1" rgba="0.5 0.4 0.3 1"/>
  <body name="drawer" pos="0 -0.02 0.12"><joint name="drawer" type="slide" axis="0 1 0" range="-0.16 0.01" limited="true"
    damping="20"/><geom type="box" size="0.09 0.1 0.02" mass="0.3" contype="0" conaffinity="0"/></body></body>
<body name="a" pos="0.45 -0.1 0.025"><freejoint/><geom type="box" size="0.02 0.02 0.025" mass="0.1" rgba="0.8 0.2 0.2 1"/></body>
<body name="b" pos="0.55 0.1 0.03"><freejoint/><geom type="cylinder" size="0.03 0.03" mass="0.1" rgba="0.2 0.2 0.8 1"/></body>
<body name="c" pos="0.6 -0.2 0.02"><freejoint/><geom type="box" size="0.03 0.03 0.02" mass="0.1" rgba="0.2 0.7 0.2 1"/></body>)";

PandaScene Scene() {
  PandaScene scene;
  scene.base_position.setZero();
  scene.world_xml = kWorld;
  return scene;
}

std::unique_ptr<PandaSim> MakeSim(const std::string& scenario, SimOptions options = {},
                                  const PandaScene& scene = Scene()) {
  auto sim =
      PandaSim::Create(CompileModel("bench", ComposePandaScene(scene)).value(), options).value();
  sim->SetScenario(MakeScenario(scenario, 5).value(), 220);
  return sim;
}

void Start(PandaSim& sim) {
  const mjModel& m = sim.model();
  std::vector<double> qpos(m.qpos0, m.qpos0 + m.nq);
  const auto home = PandaHome();
  std::copy(home.data(), home.data() + 7, qpos.begin());
  RS_CHECK(sim.Reset(qpos, home).ok());
  RS_CHECK(sim.Settle(10).ok());
}

void RunControlSteps(benchmark::State& state, PandaSim& sim) {
  Start(sim);
  int step = 0;
  double contacts = 0;
  int64_t done = 0;
  for ([[maybe_unused]] auto _ : state) {
    RS_CHECK(sim.Step(CircleCommand(step)).ok());
    contacts += sim.data().ncon;
    ++done;
    if (++step == 200) {
      state.PauseTiming();
      Start(sim);
      step = 0;
      state.ResumeTiming();
    }
  }
  state.counters["control_steps/s"] =
      benchmark::Counter(static_cast<double>(done), benchmark::Counter::kIsRate);
  state.counters["contacts"] = contacts / done;
}

void BM_ControlStep(benchmark::State& state, const char* scenario) {
  auto sim = MakeSim(scenario);
  RunControlSteps(state, *sim);
}
BENCHMARK_CAPTURE(BM_ControlStep, clean, "clean")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, nominal, "nominal")->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, isolated_stribeck, "isolated_stribeck")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, isolated_gravity, "isolated_gravity")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, isolated_backlash, "isolated_backlash")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, isolated_compliance, "isolated_compliance")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStep, thermal_drift_stribeck, "thermal_drift_stribeck")
    ->Unit(benchmark::kMicrosecond);

void BM_ControlStepVelocityOffsets(benchmark::State& state) {
  SimOptions options;
  options.joint_errors.offset_mode = OffsetMode::kVelocity;
  auto sim = MakeSim("nominal", options);
  RunControlSteps(state, *sim);
}
BENCHMARK(BM_ControlStepVelocityOffsets)->Unit(benchmark::kMicrosecond);

void BM_ControlStepStickFriction(benchmark::State& state) {
  SimOptions options;
  options.joint_errors.friction_law = FrictionLaw::kStick;
  auto sim = MakeSim("nominal", options);
  RunControlSteps(state, *sim);
}
BENCHMARK(BM_ControlStepStickFriction)->Unit(benchmark::kMicrosecond);

void BM_ControlStepReferenceOrder(benchmark::State& state) {
  SimOptions options;
  options.stepping = Stepping::kReference;
  auto sim = MakeSim("nominal", options);
  RunControlSteps(state, *sim);
}
BENCHMARK(BM_ControlStepReferenceOrder)->Unit(benchmark::kMicrosecond);

// Same scene with other solver settings: cone, iterations.
void BM_ControlStepSolver(benchmark::State& state, bool elliptic, double impratio, int iterations,
                          double tolerance) {
  PandaScene scene = Scene();
  scene.elliptic_cone = elliptic;
  scene.impratio = impratio;
  scene.iterations = iterations;
  scene.tolerance = tolerance;
  auto sim = MakeSim("nominal", {}, scene);
  RunControlSteps(state, *sim);
}
BENCHMARK_CAPTURE(BM_ControlStepSolver, elliptic_100_1e8, true, 20, 100, 1e-8)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStepSolver, elliptic_20_1e7, true, 10, 20, 1e-7)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStepSolver, elliptic_10_1e6, true, 10, 10, 1e-6)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(BM_ControlStepSolver, pyramidal_20_1e7, false, 10, 20, 1e-7)
    ->Unit(benchmark::kMicrosecond);

void BM_RatioToBareStepping(benchmark::State& state, const char* scenario) {
  auto sim = MakeSim(scenario);
  const TimedEpisode episode{.sim = sim.get(),
                             .reset = [&] { Start(*sim); },
                             .step = [&](int t) { RS_CHECK(sim->Step(CircleCommand(t)).ok()); }};
  StepCost cost;
  for ([[maybe_unused]] auto _ : state) cost = MeasureSteps(episode, /*steps=*/200, /*repeats=*/5);
  state.counters["of_bare"] = cost.of_bare();
  state.counters["bare_us"] = 1e6 * cost.bare_s;
  state.counters["ours_us"] = 1e6 * cost.ours_s;
  state.counters["replay_difference"] = cost.replay_difference;
}
BENCHMARK_CAPTURE(BM_RatioToBareStepping, clean, "clean")
    ->Unit(benchmark::kMillisecond)
    ->Iterations(1);
BENCHMARK_CAPTURE(BM_RatioToBareStepping, nominal, "nominal")
    ->Unit(benchmark::kMillisecond)
    ->Iterations(1);
BENCHMARK_CAPTURE(BM_RatioToBareStepping, aged_joint_uniform, "aged_joint_uniform")
    ->Unit(benchmark::kMillisecond)
    ->Iterations(1);

// The parts of one sub-step.
struct Parts {
  Parts() : sim(Started()), arm(*sim) {}
  static std::unique_ptr<PandaSim> Started() {
    auto sim = MakeSim("nominal");
    Start(*sim);
    return sim;
  }
  std::unique_ptr<PandaSim> sim;
  ArmParts arm;
};

void BM_ReadArm(benchmark::State& state) {
  Parts parts;
  for ([[maybe_unused]] auto _ : state) {
    parts.arm.Read();
    benchmark::ClobberMemory();
  }
}
BENCHMARK(BM_ReadArm);

void BM_OscTorque(benchmark::State& state) {
  Parts parts;
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(parts.arm.Torque());
}
BENCHMARK(BM_OscTorque);

void BM_GravityTorque(benchmark::State& state) {
  Parts parts;
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(parts.arm.Gravity());
}
BENCHMARK(BM_GravityTorque);

void BM_JointErrors(benchmark::State& state, const char* scenario) {
  Parts parts;
  JointChain errors = parts.arm.Errors(scenario);
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(parts.arm.OffsetChange(errors));
}
BENCHMARK_CAPTURE(BM_JointErrors, all_four, "nominal");
BENCHMARK_CAPTURE(BM_JointErrors, all_four_ramp, "thermal_drift_stribeck");
BENCHMARK_CAPTURE(BM_JointErrors, friction, "isolated_stribeck");
BENCHMARK_CAPTURE(BM_JointErrors, gravity, "isolated_gravity");
BENCHMARK_CAPTURE(BM_JointErrors, backlash, "isolated_backlash");
BENCHMARK_CAPTURE(BM_JointErrors, compliance, "isolated_compliance");

// A pair of views (agentview and wrist), as an observation needs it.
void BM_RenderPair(benchmark::State& state) {
  auto sim = MakeSim("clean");
  Start(*sim);
  auto renderer =
      Renderer::Create(CompileModel("bench", ComposePandaScene(Scene())).value()).value();
  const int size = static_cast<int>(state.range(0));
  const RenderOptions options{.width = size,
                              .height = size,
                              .supersample = static_cast<int>(state.range(1)),
                              .shadows = state.range(2) != 0};
  for ([[maybe_unused]] auto _ : state) {
    benchmark::DoNotOptimize(renderer->Render(sim->data(), "agentview", options).value());
    benchmark::DoNotOptimize(renderer->Render(sim->data(), "robot0_eye_in_hand", options).value());
  }
}
BENCHMARK(BM_RenderPair)
    ->ArgNames({"size", "supersample", "shadows"})
    ->ArgsProduct({{64, 128, 224}, {1, 2}, {0}})
    ->Args({224, 1, 1})
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
