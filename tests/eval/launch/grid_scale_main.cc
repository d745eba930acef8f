// grid_scale FOLDER UNITS: what planning, checking and reporting of that many units takes. Makes a
// run directory of finished units with invented episodes in FOLDER/run (kept, so that a second call
// measures at once).

#include <sys/resource.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "common/records/episode_row.h"
#include "eval/launch/merged_sweep.h"
#include "eval/plan/unit_text.h"
#include "eval/report/report.h"
#include "eval/store/store_check.h"
#include "eval/store/store_index.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kEpisodes = 4;  // per unit

// Prints how long a step took, and the most memory so far.
template <class F>
auto Timed(const char* what, F&& step) {
  const auto start = Clock::now();
  std::clock_t cpu = std::clock();
  auto result = step();
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::printf("%-58s %7.2f s  cpu %7.2f s  peak %5ld MB\n", what,
              std::chrono::duration<double>(Clock::now() - start).count(),
              static_cast<double>(std::clock() - cpu) / CLOCKS_PER_SEC, usage.ru_maxrss / 1024);
  std::fflush(stdout);
  return result;
}

SweepGrid GridOf(int units) {
  SweepGrid grid;
  grid.suites = {"tabletop_spatial", "tabletop_object", "tabletop_goal", "tabletop_long"};
  grid.severities = {1, 2, 3, 4, 5};
  grid.methods = {"base", "ours", "gain", "null"};
  grid.tasks = {0, 1};
  grid.episodes = kEpisodes / 2;
  grid.seeds.clear();
  // Clean has one level, seven scenarios have five.
  const int per_seed = 4 * (1 + 7 * 5) * 4;
  for (int seed = 0; seed * per_seed < units; ++seed) grid.seeds.push_back(seed);
  return grid;
}

// Files without fsync: what is measured is reading.
void WriteFast(const std::string& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

void MakeUnit(const RunDirectory& run, const PlannedUnit& unit, const std::string& config) {
  const std::string folder = run.Unit(unit.id);
  std::filesystem::create_directories(folder);
  RandomStream random(StreamKey("scale").With(unit.id));
  std::string rows;
  for (const int task : unit.config.tasks) {
    for (int episode = 0; episode < unit.config.episodes; ++episode) {
      const double residual = 0.4 + 0.05 * random.Normal();
      EpisodeRow row;
      row.success = random.Uniform() < 0.6;
      row.steps = 120;
      row.chunks = 24;
      row.updates = unit.config.method->adapts() ? 2 : 0;
      row.residual = row.residual_tracking = residual;
      row.eta_sq = residual * residual * 20;
      row.a_sq = 20.0;
      row.mean_abs_action = 0.2;
      row.clipped_share = 0.01;
      row.adapter_distance = 0.0;
      absl::StrAppend(&rows,
                      EpisodeLine({.suite = unit.config.suite,
                                   .scenario = unit.config.scenario,
                                   .policy = unit.config.policy,
                                   .method = unit.config.method->method,
                                   .severity = unit.config.severity,
                                   .seed = unit.config.seed,
                                   .task = task,
                                   .episode = episode,
                                   .initial_state = episode},
                                  row),
                      "\n");
    }
  }
  WriteFast(folder + "/config.yaml", config);
  WriteFast(folder + "/episodes.jsonl", rows);
  const std::string timing = TimingLine({0, 0, 1.0}) + "\n";
  WriteFast(folder + "/timing.jsonl", timing + timing);
  WriteFast(folder + "/machines.jsonl", "{\"server\":\"CPU\",\"worker\":\"CPU\"}\n");
  WriteFast(folder + "/provenance.json", R"({"model_hash":"m","policy":"nano","version":"0"})");
  WriteFast(folder + "/DONE", absl::StrCat(R"({"episodes":)", unit.EpisodeCount(),
                                           R"(,"episodes_sha256":")", Sha256Hex(rows), "\"}\n"));
  WriteFast(run.PlanFile(unit.id), config);
}

absl::Status MakeRun(const RunDirectory& run, const SweepGrid& grid,
                     const std::vector<PlannedUnit>& units) {
  if (run.Done(units.back().id)) return absl::OkStatus();
  if (const absl::Status status = run.Prepare(grid, {}); !status.ok()) return status;
  UnitTexts texts;
  for (const PlannedUnit& unit : units) MakeUnit(run, unit, texts.Of(unit));
  return absl::OkStatus();
}

int Main(const std::string& folder, int count) {
  const absl::StatusOr<SweepGrid> grid =
      Timed("resolve the grid", [&] { return ResolveGrid(GridOf(count)); });
  const auto units = Timed("expand it to units", [&] { return ExpandUnits(*grid); });
  if (!units.ok()) return 1;
  std::printf("%zu units of %d episodes\n", units->size(), kEpisodes);
  const RunDirectory fresh(folder + "/fresh"), run(folder + "/run");
  Timed("plan: check and list what is missing, nothing done", [&] {
    const absl::Status status = fresh.Prepare(*grid, *units);
    return status.ok() ? PendingItems(fresh, *units, 0).size() : 0;
  });
  if (!Timed("(make the units' files)", [&] { return MakeRun(run, *grid, *units); }).ok()) return 1;
  Timed("plan: check and list what is missing, everything done", [&] {
    const absl::Status status = run.Prepare(*grid, *units);
    return status.ok() ? PendingItems(run, *units, 0).size() : 0;
  });
  Timed("verify the store", [&] { return CheckStores({run.path()}).ok(); });
  Timed("index it, from nothing", [&] {
    std::filesystem::remove(folder + "/index.sqlite");
    return UpdateIndex(folder + "/index.sqlite", {run.path()}).ok();
  });
  Timed("index it again", [&] { return UpdateIndex(folder + "/index.sqlite", {run.path()}).ok(); });
  const auto data = Timed("load the run", [&] { return LoadRun(run.path()); });
  if (!data.ok()) return std::fprintf(stderr, "%s\n", data.status().ToString().c_str()), 1;
  Timed("write episodes.csv and timings.csv", [&] { return WriteTables(*data).ok(); });
  ReportOptions options;
  options.print = false;
  options.bootstrap_replicates = 200;
  Timed("report with 200 bootstrap replicates", [&] { return WriteReport(*data, options).ok(); });
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: %s FOLDER UNITS\n", argv[0]), 2;
  return robostress::Main(argv[1], std::atoi(argv[2]));
}
