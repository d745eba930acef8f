// What one task of each LIBERO suite costs: control steps beside bare stepping, their parts, reset,
// views, memory. CPU times, medians of repeats; a quiet machine takes two minutes.
//   libero_bench --libero-root DIR --robosuite-root DIR
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "common/check.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "common/statistics.h"
#include "common/status_macros.h"
#include "sim_worker/bench/arm_parts.h"
#include "sim_worker/bench/bare_steps.h"
#include "sim_worker/bench/bare_view.h"
#include "sim_worker/bench/timing.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/libero/preprocess.h"

namespace robostress::libero {
namespace {

constexpr int kSubSteps = 25;  // of a control step

struct Options {
  UnitConfig unit;
  std::vector<std::string> suites = {"libero_spatial", "libero_object", "libero_goal", "libero_10"};
  int task = 0;
  int steps = 40, repeats = 3;
};

// What the project asks for, of one suite's task.
struct Figures {
  double fast_of_bare = 0, errors_share = 0, reset_s = 0, views_of_bare = 0,
         original_views_of_bare = 0;
};

absl::StatusOr<std::unique_ptr<LiberoSimTask>> MakeTask(const Options& options,
                                                        const std::string& suite,
                                                        const std::string& scenario,
                                                        Stepping stepping) {
  UnitConfig unit = options.unit;
  unit.suite = suite;
  unit.scenario = scenario;
  unit.sim.stepping = stepping;
  return LiberoSimTask::Create(unit, options.task);
}

StepCost MeasureTask(const Options& options, LiberoSimTask& task) {
  const TimedEpisode episode{.sim = &task.sim(),
                             .reset = [&] { RS_CHECK(task.Reset(0).ok()); },
                             .step = [&](int t) { RS_CHECK(task.Step(CircleCommand(t)).ok()); }};
  return MeasureSteps(episode, options.steps, options.repeats);
}

absl::Status PrintSteps(const Options& options, const std::string& suite, Figures& figures) {
  std::printf(
      "\n| control step | steps/s | CPU [ms] | 25 mj_step [ms] | speed of bare | contacts | "
      "largest "
      "replay difference |\n|---|---|---|---|---|---|---|\n");
  struct Row {
    const char *name, *scenario;
    Stepping stepping;
  };
  for (const Row& row : {Row{"fast, Clean", "clean", Stepping::kFast},
                         {"fast, nominal", "nominal", Stepping::kFast},
                         {"parity, Clean", "clean", Stepping::kParity}}) {
    RS_ASSIGN_OR_RETURN(const auto task, MakeTask(options, suite, row.scenario, row.stepping));
    const StepCost cost = MeasureTask(options, *task);
    std::printf("| %s | %.1f | %.2f | %.2f | %.3f | %.0f | %.1g |\n", row.name, 1 / cost.ours_s,
                1e3 * cost.ours_s, 1e3 * cost.bare_s, cost.of_bare(), cost.contacts,
                cost.replay_difference);
    std::fflush(stdout);
    if (figures.fast_of_bare == 0) figures.fast_of_bare = cost.of_bare();
  }
  return absl::OkStatus();
}

// The parts that are ours, alone on the task's state, and their share of `step_s` [s].
void PrintParts(LiberoSimTask& task, double step_s, Figures& figures) {
  ArmParts parts(task.sim());
  volatile double sink = 0;
  std::printf("\n| part of a sub-step | CPU [us] | of a control step |\n|---|---|---|\n");
  auto print = [&](const char* name, double seconds) {
    std::printf("| %s | %.3f | %.2f %% |\n", name, 1e6 * seconds,
                100 * kSubSteps * seconds / step_s);
    return seconds;
  };
  print("read the arm", TimeOfShort([&] { parts.Read(); }));
  print("operational-space control", TimeOfShort([&] { sink = parts.Torque()[0]; }));
  const double gravity = TimeOfShort([&] { sink = parts.Gravity()[0]; });
  print("gravity torque", gravity);
  for (const char* scenario : {"isolated_stribeck", "isolated_gravity", "isolated_backlash",
                               "isolated_compliance", "nominal"}) {
    JointChain errors = parts.Errors(scenario);
    const double seconds =
        print(scenario, TimeOfShort([&] { sink = parts.OffsetChange(errors)[0]; }));
    figures.errors_share = kSubSteps * (seconds + gravity) / step_s;  // the last one has all four
  }
  std::printf("(an error that uses gravity needs the gravity torque as well)\n");
}

void PrintResets(LiberoSimTask& task, int repeats, Figures& figures) {
  std::vector<double> resets, settles;
  const InitStates& states = task.init_states();
  const std::vector<double> rest(task.sim().model().nv, 0.0);
  for (int i = 0; i < 3 * repeats; ++i) {
    const absl::Span<const double> qpos(states.row(i % states.rows) + 1, task.sim().model().nq);
    resets.push_back(
        TimeOf([&] { RS_CHECK(task.ResetTo(qpos, rest, LiberoSimTask::HomePosture()).ok()); }));
    settles.push_back(TimeOf([&] { RS_CHECK(task.sim().Settle(task.settle_steps()).ok()); }));
  }
  figures.reset_s = UpperMedian(resets);
  std::printf("\nReset with the cached model: %.2f ms, and %.0f ms for %d settle steps.\n",
              1e3 * figures.reset_s, 1e3 * UpperMedian(settles), task.settle_steps());
}

struct ViewSettings {
  int size, supersample, samples;
  bool shadows;
};

// Both cameras with multisampling, mirrors and shadow maps, as the originals draw; whether the
// pictures are equal byte for byte.
absl::Status PrintOriginalViews(LiberoSimTask& task, const mjModel& model, Renderer& renderer,
                                int repeats, Figures& figures) {
  constexpr int kSize = 256;
  const RenderOptions options = RenderAsLibero(kSize, kSize);
  const mjData& data = task.sim().data();
  double ours_s = 0, bare_s = 0;
  std::printf(
      "\n| view of 256 px as the originals' | Render [ms] | mjr_render + read-back [ms] | ratio | "
      "equal pictures |\n|---|---|---|---|---|\n");
  for (const char* camera : {"agentview", "robot0_eye_in_hand"}) {
    BareView bare_view(model, camera,
                       {.size = kSize,
                        .shadows = options.shadows,
                        .reflections = options.reflections,
                        .samples = options.samples,
                        .shadow_size = options.shadow_size});
    RS_ASSIGN_OR_RETURN(const Image image, renderer.Render(data, camera, options));
    std::vector<double> ours, bare;
    for (int i = 0; i < 3 * repeats; ++i) {
      ours.push_back(TimeOf([&] { RS_CHECK(renderer.Render(data, camera, options).ok()); }));
      bare.push_back(bare_view.TimeOfDrawing(data));
    }
    bool equal = true;
    const size_t row = 3 * kSize;
    for (int y = 0; y < kSize; ++y) {
      equal &= std::equal(image.data.begin() + y * row, image.data.begin() + (y + 1) * row,
                          bare_view.pixels().begin() + (kSize - 1 - y) * row);
    }
    std::printf("| %s | %.1f | %.1f | %.2f | %s |\n", camera, 1e3 * UpperMedian(ours),
                1e3 * UpperMedian(bare), UpperMedian(ours) / UpperMedian(bare),
                equal ? "yes" : "no");
    ours_s += UpperMedian(ours);
    bare_s += UpperMedian(bare);
  }
  figures.original_views_of_bare = ours_s / bare_s;
  return absl::OkStatus();
}

// Renderer::Render beside mjr_render and mjr_readPixels of the same scene, interleaved; `samples`
// of multisampling are what MuJoCo offers where the Renderer supersamples.
absl::Status PrintViews(LiberoSimTask& task, int repeats, Figures& figures) {
  constexpr char kCamera[] = "agentview";
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<mjModel> model,
                      MakeRenderModel(task.scene(), task.placed_model()));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Renderer> renderer, Renderer::Create(model));
  std::printf(
      "\n| view [px] | averaged over | shadows | Render [ms] | mjr_render + read-back [ms] | ratio "
      "|\n|---|---|---|---|---|---|\n");
  for (const ViewSettings& view : {ViewSettings{64, 1, 0, false},
                                   {128, 1, 0, false},
                                   {224, 1, 0, false},
                                   {256, 1, 0, false},
                                   {256, 1, 0, true},
                                   {256, 2, 4, false}}) {
    const RenderOptions options{.width = view.size,
                                .height = view.size,
                                .supersample = view.supersample,
                                .shadows = view.shadows};
    std::vector<double> ours, bare;
    RS_CHECK(renderer->Render(task.sim().data(), kCamera, options).ok());
    BareView bare_view(*model, kCamera,
                       {.size = view.size, .shadows = view.shadows, .samples = view.samples});
    for (int i = 0; i < 3 * repeats; ++i) {
      ours.push_back(
          TimeOf([&] { RS_CHECK(renderer->Render(task.sim().data(), kCamera, options).ok()); }));
      bare.push_back(bare_view.TimeOfDrawing(task.sim().data()));
    }
    const double ratio = UpperMedian(ours) / UpperMedian(bare);
    const char* averaged = view.supersample == 1 ? "1" : "4 (supersampled; bare: multisampled)";
    std::printf("| %d | %s | %s | %.2f | %.2f | %.3f |\n", view.size, averaged,
                view.shadows ? "yes" : "no", 1e3 * UpperMedian(ours), 1e3 * UpperMedian(bare),
                ratio);
    if (view.size == 256 && view.supersample == 1 && !view.shadows) figures.views_of_bare = ratio;
  }
  RS_RETURN_IF_ERROR(PrintOriginalViews(task, *model, *renderer, repeats, figures));
  PolicySpec spec;
  spec.cameras = {kCamera, "robot0_eye_in_hand"};
  std::vector<double> observations;
  for (int i = 0; i < 3 * repeats; ++i)
    observations.push_back(TimeOf([&] { RS_CHECK(task.Observe(spec).ok()); }));
  std::printf("Observation of two views of 256 px, mirrored and resized to %d px: %.2f ms.\n",
              spec.image_width, 1e3 * UpperMedian(observations));
  return absl::OkStatus();
}

struct Memory {
  double resident_mb = 0, peak_mb = 0;
};

double ResidentMegabytes() {
  long pages = 0;
  std::FILE* file = std::fopen("/proc/self/statm", "r");
  if (file == nullptr) return 0;
  if (std::fscanf(file, "%*d %ld", &pages) != 1) pages = 0;
  std::fclose(file);
  return static_cast<double>(pages * sysconf(_SC_PAGESIZE)) / (1 << 20);
}

// Memory of a process that makes the task, steps it and observes it; zero where that fails. Called
// before this process has a rendering context, which a child must not inherit.
Memory MeasureMemory(const Options& options, const std::string& suite, Stepping stepping) {
  std::fflush(nullptr);
  int ends[2];
  RS_CHECK(pipe(ends) == 0);
  const pid_t child = fork();
  RS_CHECK(child >= 0);
  if (child == 0) {
    const auto task = MakeTask(options, suite, "nominal", stepping);
    PolicySpec spec;
    spec.cameras = {"agentview", "robot0_eye_in_hand"};
    const bool done = task.ok() && (*task)->Reset(0).ok() && (*task)->Step(CircleCommand(0)).ok() &&
                      (*task)->Observe(spec).ok();
    const double resident = ResidentMegabytes();
    const bool told = write(ends[1], &resident, sizeof(resident)) == sizeof(resident);
    _exit(done && told ? 0 : 1);
  }
  Memory memory;
  close(ends[1]);
  const bool heard = read(ends[0], &memory.resident_mb, sizeof(double)) == sizeof(double);
  close(ends[0]);
  int status = 0;
  rusage usage{};
  RS_CHECK(wait4(child, &status, 0, &usage) == child);
  if (!heard || status != 0) return {};
  memory.peak_mb = static_cast<double>(usage.ru_maxrss) / 1024;
  return memory;
}

absl::Status PrintMemory(const Options& options) {
  std::printf(
      "## Memory of a process with one task, stepped and seen\n\n| suite | fast [MB] | parity "
      "[MB] | peak, while the scene compiles [MB] |\n|---|---|---|---|\n");
  for (const std::string& suite : options.suites) {
    // Says what is wrong with the checkouts, which a child could not.
    RS_RETURN_IF_ERROR(MakeTask(options, suite, "clean", Stepping::kFast).status());
    const Memory fast = MeasureMemory(options, suite, Stepping::kFast);
    const Memory parity = MeasureMemory(options, suite, Stepping::kParity);
    std::printf("| %s | %.0f | %.0f | %.0f |\n", suite.c_str(), fast.resident_mb,
                parity.resident_mb, std::max(fast.peak_mb, parity.peak_mb));
  }
  return absl::OkStatus();
}

absl::StatusOr<Figures> MeasureSuite(const Options& options, const std::string& suite) {
  Figures figures;
  RS_ASSIGN_OR_RETURN(const auto task, MakeTask(options, suite, "clean", Stepping::kFast));
  const mjModel& m = task->sim().model();
  std::printf("\n## %s %d: %s\n\n%d degrees of freedom, %d geoms.\n", suite.c_str(), options.task,
              task->instruction().c_str(), m.nv, m.ngeom);
  RS_RETURN_IF_ERROR(PrintSteps(options, suite, figures));
  RS_CHECK(task->Reset(0).ok());
  std::vector<double> steps;
  for (int t = 0; t < options.steps; ++t)
    steps.push_back(TimeOf([&] { RS_CHECK(task->Step(CircleCommand(t)).ok()); }));
  PrintParts(*task, UpperMedian(steps), figures);
  PrintResets(*task, options.repeats, figures);
  RS_RETURN_IF_ERROR(PrintViews(*task, options.repeats, figures));
  return figures;
}

void PrintGoals(const std::vector<std::pair<std::string, Figures>>& rows) {
  std::printf(
      "\n## Goals\n\n| suite | fast of bare (>= 1) | all errors (<= 3 %%) | reset (<= 20 ms) | "
      "view of bare (<= 1.1) | two views as the originals' of bare |\n|---|---|---|---|---|---|\n");
  for (const auto& [suite, f] : rows) {
    std::printf("| %s | %.3f | %.2f %% | %.2f ms | %.3f | %.3f |\n", suite.c_str(), f.fast_of_bare,
                100 * f.errors_share, 1e3 * f.reset_s, f.views_of_bare, f.original_views_of_bare);
  }
}

absl::Status Run(const Options& options) {
  RS_RETURN_IF_ERROR(PrintMemory(options));
  std::vector<std::pair<std::string, Figures>> rows;
  for (const std::string& suite : options.suites) {
    RS_ASSIGN_OR_RETURN(const Figures figures, MeasureSuite(options, suite));
    rows.emplace_back(suite, figures);
  }
  PrintGoals(rows);
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::libero

int main(int argc, char** argv) {
  robostress::libero::Options options;
  robostress::cli::App app("Costs of LIBERO's scenes beside bare MuJoCo");
  app.add_option("--libero-root", options.unit.libero_root, "LIBERO checkout (or LIBERO_ROOT)");
  app.add_option("--robosuite-root", options.unit.robosuite_root,
                 "robosuite checkout (or ROBOSUITE_ROOT)");
  app.add_option("--suites", options.suites, "Suites to measure")->capture_default_str();
  app.add_option("--task", options.task, "Task of each suite")->capture_default_str();
  app.add_option("--steps", options.steps, "Control steps of an episode")
      ->check(robostress::cli::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--repeats", options.repeats, "Episodes whose median counts")
      ->check(robostress::cli::Range(1, 100))
      ->capture_default_str();
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  const absl::Status status = robostress::libero::Run(options);
  if (!status.ok())
    std::fprintf(stderr, "libero_bench: %s\n", std::string(status.message()).c_str());
  return status.ok() ? 0 : 1;
}
