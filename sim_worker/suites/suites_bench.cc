// What a control step, a decision and a pair of views of an embedded scene cost, beside the bare
// physics of the same 25 sub-steps.

#include "benchmark/benchmark.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {
namespace {

constexpr int kSubSteps = 25;
constexpr const char* kSuites[] = {"tabletop_spatial", "tabletop_object", "tabletop_goal",
                                   "tabletop_long"};

std::unique_ptr<EmbeddedTask> TaskOf(const benchmark::State& state) {
  UnitConfig unit;
  unit.suite = kSuites[state.range(0)];
  std::unique_ptr<EmbeddedTask> task = EmbeddedTask::Create(unit, 1).value();
  (void)task->Reset(0);
  return task;
}

// Episodes of the expert, resets included in neither time nor count.
void ControlStep(benchmark::State& state) {
  const auto task = TaskOf(state);
  int index = 0;
  for ([[maybe_unused]] auto _ : state) {
    benchmark::DoNotOptimize(task->Step(task->Decide().command));
    if (task->Success() || task->sim().steps_taken() >= task->horizon()) {
      state.PauseTiming();
      (void)task->Reset(++index % 50);
      state.ResumeTiming();
    }
  }
  state.SetItemsProcessed(state.iterations());
  state.SetLabel(kSuites[state.range(0)]);
}
BENCHMARK(ControlStep)->DenseRange(0, 3)->Unit(benchmark::kMicrosecond);

// The same episodes; only the bare mj_step calls count: a copy of the state takes 25 of them per
// control step.
void BarePhysics(benchmark::State& state) {
  const auto task = TaskOf(state);
  const mjModel& model = task->sim().model();
  mjData* bare = mj_makeData(&model);
  int index = 0;
  for ([[maybe_unused]] auto _ : state) {
    state.PauseTiming();
    mj_copyData(bare, &model, &task->sim().data());
    (void)task->Step(task->Decide().command);
    if (task->Success() || task->sim().steps_taken() >= task->horizon()) {
      (void)task->Reset(++index % 50);
    }
    state.ResumeTiming();
    for (int i = 0; i < kSubSteps; ++i) mj_step(&model, bare);
  }
  mj_deleteData(bare);
  state.SetItemsProcessed(state.iterations());
  state.SetLabel(kSuites[state.range(0)]);
}
BENCHMARK(BarePhysics)->DenseRange(0, 3)->Unit(benchmark::kMicrosecond);

void PairOfViews(benchmark::State& state) {
  const auto task = TaskOf(state);
  const int size = static_cast<int>(state.range(1));
  for ([[maybe_unused]] auto _ : state) {
    for (const char* camera : {"agentview", "robot0_eye_in_hand"}) {
      if (!task->RenderView(camera, size, size).ok()) state.SkipWithError("no EGL");
    }
  }
  state.SetLabel(kSuites[state.range(0)]);
}
BENCHMARK(PairOfViews)->ArgsProduct({{2}, {64, 224}})->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
