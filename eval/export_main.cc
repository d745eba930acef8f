// robostress-export: recorded episodes as data sets for training.

#include <cstdio>

#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/export/export_run.h"
#include "eval/launch/exit_code.h"

namespace {

constexpr char kExamples[] = R"(
Example
  robostress sweep --suites tabletop_goal --policies nano --methods base,ours_following --scenarios heavy_payload \
    --record-episodes 128 --out runs/worn
  robostress export runs/worn --lerobot data/worn --libero data/worn_hdf5 --successes
  robostress export runs/worn --mcap data/worn_mcap   # then open a file in Foxglove
  robostress export runs/tuesday --mcap data/tuesday  # a run of robot_client

In all forms the commanded action, the sent one and the measured motion are separate columns: action, action.sent and
action.measured; in HDF5 actions, actions_sent and actions_measured; in MCAP topics /action/commanded, /action/sent and /action/measured,
beside /joint_states, /tool_pose and a /camera/NAME each. Of an arm's run: /joint_states, /client, and as /joints/... what
the policy asked for, what was sent, what was measured.

Exit code: 0 written; 1 an episode was not recorded, or another error; 2 the command is wrong.
)";

void PrintEpisodes(const robostress::ExportSummary& summary) {
  std::printf("%lld episodes, %lld steps", static_cast<long long>(summary.episodes),
              static_cast<long long>(summary.steps));
  if (summary.failures_left_out > 0)
    std::printf(" (%lld failures left out)", static_cast<long long>(summary.failures_left_out));
  if (summary.unfinished > 0)
    std::printf("; %lld units of the run are unfinished and left out",
                static_cast<long long>(summary.unfinished));
  std::printf("\n");
}

}  // namespace

int main(int argc, char** argv) {
  robostress::cli::App app("Writes a run's recorded episodes as data sets for training.",
                           "robostress export");
  app.footer(kExamples);
  robostress::ExportOptions options;
  app.add_option("RUN", options.run,
                 "Run directory: the --out of a sweep that recorded episodes, or of robot_client")
      ->required();
  app.add_option("--lerobot", options.lerobot, "Folder for a LeRobot v3.0 data set");
  app.add_option("--libero", options.libero, "Folder for LIBERO's HDF5 files, one a task");
  app.add_option("--mcap", options.mcap,
                 "Folder for MCAP files, one an episode: Foxglove opens them");
  app.add_option("--methods", options.methods, "Only episodes of these methods")->delimiter(',');
  app.add_option("--scenarios", options.scenarios, "Only episodes under these scenarios")
      ->delimiter(',');
  app.add_flag("--successes", options.successes_only, "Only episodes that succeeded");
  const auto run = [&]() -> absl::Status {
    RS_ASSIGN_OR_RETURN(const robostress::ExportSummary summary, robostress::ExportRun(options));
    if (summary.ticks > 0) {
      std::printf("%lld ticks, %lld samples of the arm, %lld pictures\n",
                  static_cast<long long>(summary.ticks), static_cast<long long>(summary.samples),
                  static_cast<long long>(summary.pictures));
      if (summary.pictures_missing > 0)
        std::printf("%lld pictures that frames.csv names are not there\n",
                    static_cast<long long>(summary.pictures_missing));
    } else {
      PrintEpisodes(summary);
    }
    for (const std::string& path : summary.written) std::printf("  %s\n", path.c_str());
    return absl::OkStatus();
  };
  return robostress::RunMain(app, argc, argv, run, robostress::ExitCodeOfError);
}
