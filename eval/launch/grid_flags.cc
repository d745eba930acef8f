#include "eval/launch/grid_flags.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/libero/protocols.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/web_url.h"
#include "eval/launch/cluster_launchers.h"

namespace robostress {

void DeclareLaunchFlags(cli::App& app, LaunchOptions& launch) {
  app.add_option("--workers", launch.workers, "Worker processes")
      ->check(cli::Range(1, 256))
      ->capture_default_str();
  app.add_option("--server", launch.server,
                 "HOST:PORT of a policy server that runs already and holds the policies; absent: "
                 "one is started for each");
  app.add_option("--policy-url", launch.policy_urls,
                 "ws://HOST:PORT of somebody else's policy server (openpi, LeRobot, vLLM-Omni, "
                 "SGLang); several that serve the same model share the work. --policies names it")
      ->check(
          [](const std::string& url) { return std::string(ParseWebUrl(url).status().message()); })
      ->delimiter(',');
}

void DeclareClusterFlags(cli::App& app, LaunchOptions& launch) {
  ClusterOptions& cluster = launch.cluster;
  app.add_option("--launcher", launch.launcher, absl::StrJoin(LauncherNames(), ", "))
      ->check([](const std::string& name) {
        return std::string(MakeLauncher(name).status().message());
      })
      ->capture_default_str()
      ->group("Where it runs");
  const auto option = [&app](const char* name, auto& value, const char* help) {
    return app.add_option(name, value, help)->capture_default_str()->group("Where it runs");
  };
  option("--split-episodes", launch.part_episodes,
         "Methods that carry nothing over run in parts of N episodes; 0: undivided")
      ->check(cli::Range(0, 1000000));
  app.add_flag("--quiet", launch.quiet, "No progress; failures and the result only")
      ->group("Where it runs");
  if (ClusterLaunchers().empty()) return;  // what follows asks for one
  app.add_flag("--wait", cluster.wait, "Stay and show the progress until all jobs have left")
      ->group("Where it runs");
  option("--servers", cluster.servers, "Server jobs per policy")->check(cli::Range(1, 1000));
  option("--server-threads", cluster.server_threads,
         "Threads (and cores) of each; 0: one for each worker that uses it")
      ->check(cli::Range(0, 1024));
  option("--server-host", cluster.server_host,
         "Name or address that servers publish (default: of the machine they run on)");
  option("--max-tasks", cluster.max_tasks, "Tasks of the worker array (Slurm: MaxArraySize - 1)")
      ->check(cli::Range(1, 1000000));
  option("--workers-per-task", cluster.workers_per_task, "Worker processes of each task")
      ->check(cli::Range(1, 256));
  option("--poll-interval", cluster.poll_s, "Seconds between questions to the queue, with --wait")
      ->check(cli::Range(1, 3600));
  option("--slurm-server", cluster.slurm_server, "Further argument of sbatch for servers");
  option("--slurm-worker", cluster.slurm_worker, "The same for workers, such as --partition=cpu");
  option("--slurm-merge", cluster.slurm_merge, "The same for the merge");
  option("--image", cluster.image, "Container image with every program (kubernetes)");
  option("--claim", cluster.claim, "Volume claim that holds the run directory (kubernetes)");
  option("--claim-mount", cluster.claim_mount,
         "Where it is mounted, here and in pods (default: the run directory's parent)");
  option("--namespace", cluster.k8s_namespace, "Namespace (kubernetes)");
}

PolicyHome PolicyHomeOf(const LaunchOptions& launch) {
  return launch.server.empty() && launch.policy_urls.empty() ? PolicyHome::kHere
                                                             : PolicyHome::kElsewhere;
}

namespace {

// What --protocol sets, from the table itself.
std::string ProtocolHelp() {
  std::string help = "LIBERO's suites as somebody else evaluates them; other flags go before";
  for (const LiberoProtocol& p : LiberoProtocols()) {
    absl::StrAppend(
        &help, ". ", p.name, ": ", p.settle_steps, " settle steps, a prediction every ",
        p.execute_steps, " steps and views of ", p.image_size, " px (--policy-url), ", p.episodes,
        " episodes, seed ", p.seed, ", fixtures ", p.fixtures, ", step limits ",
        absl::StrJoin(p.step_limits, "/",
                      [](std::string* text, const auto& l) { absl::StrAppend(text, l.second); }));
  }
  return help;
}

}  // namespace

void DeclareGridFlags(cli::App& app, GridFlags& flags) {
  app.add_option("--grid", flags.grid_file,
                 "YAML file of a grid, such as a run's sweep.yaml; flags override it");
  app.add_option("--robot", flags.robot, "panda (default), piper");
  app.add_option("--suites,--suite", flags.suites, "See `robostress suites`")->delimiter(',');
  app.add_option("--tasks", flags.tasks, "2: the first two; 0,3,7 or 2-5: indices; all");
  app.add_option("--episodes", flags.episodes, "Consecutive episodes per task");
  app.add_option("--scenarios,--scenario", flags.scenarios,
                 "See `robostress scenarios`, or scenario files: FILE.yaml (default: clean and the "
                 "seven)")
      ->delimiter(',');
  app.add_option("--severities,--severity", flags.severities, "Levels 1 to 5")->delimiter(',');
  app.add_option(
         "--policies,--policy", flags.policies,
         "nano, nano-pi05, nano-libero, expert, replay, a weights file and so on (default: nano, "
         "nano-libero on LIBERO's tasks, nano-piper on a Piper's)")
      ->delimiter(',');
  app.add_option("--methods,--method", flags.methods, absl::StrJoin(MethodNames(), ", "))
      ->delimiter(',');
  app.add_option("--seeds,--seed", flags.seeds, "Seeds of the sampling noise")->delimiter(',');
  app.add_option("--repeats", flags.repeats,
                 "Episodes of each initial state, where the server of --policy-url takes neither "
                 "seed nor noise; else give --seeds")
      ->check(cli::Range(1, 1000));
  app.add_option("--first-initial-state", flags.first_initial_state,
                 "0-19 reporting split, 40-49 dev split");
  app.add_option("--set", flags.overrides,
                 "SECTION.KEY=VALUE, repeatable; sections: sim, method, client, remote, latency")
      ->allow_extra_args(false);
  app.add_option("--dialect", flags.dialect,
                 "Keys of the messages to --policy-url: libero (default), droid, aloha, vllm_omni, "
                 "sglang, lerobot, vla_eval, robostress, or a YAML file");
  app.add_option("--latency-ms", flags.latency_ms,
                 "An answer is there so long after its observation, in simulated time (default 0)")
      ->check(cli::Range(0, 10000));
  app.add_option("--late", flags.late,
                 "What the arm does meanwhile: waiting (it holds still), switch (it plays on and "
                 "enters the chunk at the row that is due; default), crossfade (the same, faded), "
                 "rtc (real-time chunking; nano and its kin)")
      ->check(cli::IsMember({"waiting", "switch", "crossfade", "rtc"}));
  app.add_option("--replay-file", flags.replay_file, "Actions for policy replay");
  app.add_option(
      "--libero-root", flags.libero_root,
      "LIBERO checkout, for suites libero_* (default: LIBERO_ROOT, else what `robostress libero "
      "setup` linked)");
  app.add_option("--robosuite-root", flags.robosuite_root,
                 "robosuite checkout, for suites libero_*");
  app.add_option("--libero-tasks", flags.libero_tasks,
                 "Folder of LIBERO tasks (.bddl) that no suite here has, such as LIBERO-90's or "
                 "LIBERO-PRO's; its name is the suite's. Repeatable")
      ->type_name("DIR")
      ->check(cli::ExistingDirectory())
      ->allow_extra_args(false);
  app.add_option("--libero-fixtures", flags.libero_fixtures,
                 "Where cabinets, stoves and racks of libero_* stand at each episode: centred "
                 "(default), sampled, numpy[:SEED] (the originals' draw, seed 7), numpy-each:SEED "
                 "(seeded anew for each episode), or a JSON table");
  app.add_option("--protocol", flags.protocol, ProtocolHelp());
}

namespace {

// Named, or read from a file. What is wrong is the command's.
absl::StatusOr<OpenpiDialect> DialectOf(const std::string& text) {
  const bool file = absl::EndsWith(text, ".yaml");
  absl::StatusOr<OpenpiDialect> dialect =
      file ? LoadConfig<OpenpiDialect>(text) : OpenpiDialectNamed(text.empty() ? "libero" : text);
  if (!dialect.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("--dialect: ", dialect.status().message(),
                                                   file ? "" : "; or a file of keys, NAME.yaml"));
  }
  if (dialect->name.empty())
    return absl::InvalidArgumentError(absl::StrCat(text, ": name is empty; give the dialect one"));
  return dialect;
}

void ApplyProtocol(const LiberoProtocol& protocol, SweepGrid& grid) {
  if (grid.suites.empty() && grid.libero_tasks.empty()) {
    for (const auto& [suite, limit] : protocol.step_limits) {
      if (FindSuite(suite) != nullptr) grid.suites.push_back(suite);  // not LIBERO-90's folder
    }
  }
  grid.step_limits = protocol.name;
  grid.episodes = protocol.episodes;
  grid.first_initial_state = 0;
  grid.seeds = {protocol.seed};
  grid.libero_fixtures = protocol.fixtures;
  // The originals' observations are of sub-step 24 of 25.
  grid.overrides.push_back(absl::StrCat("sim.settle_steps=", protocol.settle_steps));
  grid.overrides.push_back("sim.robosuite.late_observation=on");
  grid.remote.execute_steps = protocol.execute_steps;
  grid.remote.image_size = protocol.image_size;
}

// A repeat is what a seed is to a server that takes one: another number of the same unit. Nothing
// is drawn from it.
absl::Status ApplyRepeats(const cli::App& app, int repeats, SweepGrid& grid) {
  if (app.count("--seeds"))
    return absl::InvalidArgumentError("--repeats and --seeds both number repetitions; give one");
  if (!grid.remote.used() || grid.remote.dialect.PairsNoise()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--repeats ", repeats, ": this policy's sampling noise is drawn from a seed",
        grid.remote.used() ? absl::StrCat(" (dialect ", grid.remote.dialect.name, ")") : "",
        ", so that repetitions are seeds; give --seeds 0", repeats > 1 ? ",1" : "",
        repeats > 2 ? ",..." : ""));
  }
  grid.seeds.clear();
  for (int repeat = 0; repeat < repeats; ++repeat) grid.seeds.push_back(repeat);
  return absl::OkStatus();
}

}  // namespace

absl::Status ApplyGridFlags(const cli::App& app, const GridFlags& flags, SweepGrid& grid) {
  if (!flags.grid_file.empty()) {
    RS_ASSIGN_OR_RETURN(grid, LoadConfig<SweepGrid>(flags.grid_file));
  }
  if (app.count("--dialect") || (app.count("--policy-url") && !grid.remote.used())) {
    RS_ASSIGN_OR_RETURN(OpenpiDialect dialect, DialectOf(flags.dialect));
    UseDialect(std::move(dialect), grid.remote);
  }
  // What a policy of theirs can do: its weights are not ours to adapt.
  if (grid.remote.used() && flags.grid_file.empty()) grid.methods = {"base", "ours_following"};
  if (app.count("--suites")) grid.suites = flags.suites;
  if (app.count("--libero-tasks")) grid.libero_tasks = flags.libero_tasks;
  if (app.count("--protocol")) {
    RS_ASSIGN_OR_RETURN(const LiberoProtocol protocol, FindLiberoProtocol(flags.protocol));
    ApplyProtocol(protocol, grid);
  }
  if (app.count("--robot")) grid.robot = flags.robot;
  if (app.count("--scenarios")) grid.scenarios = flags.scenarios;
  if (app.count("--severities")) grid.severities = flags.severities;
  if (app.count("--policies")) grid.policies = flags.policies;
  if (app.count("--methods")) grid.methods = flags.methods;
  if (app.count("--seeds")) grid.seeds = flags.seeds;
  if (app.count("--repeats")) RS_RETURN_IF_ERROR(ApplyRepeats(app, flags.repeats, grid));
  if (app.count("--episodes")) grid.episodes = flags.episodes;
  if (app.count("--first-initial-state")) grid.first_initial_state = flags.first_initial_state;
  if (app.count("--set")) {
    grid.overrides.insert(grid.overrides.end(), flags.overrides.begin(), flags.overrides.end());
  }
  if (app.count("--replay-file")) grid.replay_file = flags.replay_file;
  if (app.count("--libero-root")) grid.libero_root = flags.libero_root;
  if (app.count("--robosuite-root")) grid.robosuite_root = flags.robosuite_root;
  if (app.count("--libero-fixtures")) grid.libero_fixtures = flags.libero_fixtures;
  if (app.count("--latency-ms")) grid.latency.ms = flags.latency_ms;
  if (app.count("--late")) {
    RS_RETURN_IF_ERROR(ApplyOverrides({absl::StrCat("mode=", flags.late)}, grid.latency));
    const bool later =
        std::any_of(flags.overrides.begin(), flags.overrides.end(),
                    [](const std::string& set) { return absl::StartsWith(set, "latency.ms="); });
    if (!grid.latency.late() && !later) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--late ", flags.late, " without --latency-ms: no answer is late; give --latency-ms N"));
    }
  }
  if (app.count("--tasks")) {
    RS_ASSIGN_OR_RETURN(grid.tasks, ParseTasks(flags.tasks));
  }
  return absl::OkStatus();
}

}  // namespace robostress
