#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/paper/paper_table.h"
#include "eval/plan/plan.h"

namespace robostress {

// The paper's real-arm experiments (sec:real, sec:supp_real) on emulated Pipers; this struct is
// DIR/study.yaml. Stages: record -> train -> evaluate -> report, each skips what it finds done.
struct PiperStudyOptions {
  std::vector<std::string> arms = {"new", "used_one_year"};  // Robot A, Robot B
  std::vector<int> tasks = {1, 2, 3, 4};                     // the paper's numbers
  int demonstrations = 30;                                   // per task and arm
  int episodes = 25;                                         // per arm, task and method
  double episode_s = 15;                                     // until an episode has failed [s]
  std::vector<std::string> experiments = {"main", "dob", "unseen"};
  double moved_bound = 0.1;    // steps that the client moved by more are masked in feedback [rad]
  int64_t seed = 0;            // of the sampling noise
  int64_t train_steps = 1600;  // of the policy that base and RobustVLA go on from
  int64_t tune_steps = 150;    // of each of the two
  std::vector<std::string> overrides;        // of the method options of ours: KEY=VALUE
  std::string base_weights, robust_weights;  // given: nothing is recorded or trained
  std::string recipe;  // of the training; empty: server/training/nano_piper.yaml

  template <class V>
  void Visit(V& v) {
    v.Field("arms", arms, "wear profiles of the emulator; the first is the paper's Robot A");
    v.Field("tasks", tasks, "1 to 4, as the paper numbers them");
    v.Field("demonstrations", demonstrations, "of each task on each arm");
    v.Field("episodes", episodes, "of each arm, task and method");
    v.Field("episode_s", episode_s, "until an episode has failed [s]");
    v.Field("experiments", experiments, "main, dob, unseen");
    v.Field("seed", seed, "of the sampling noise");
    v.Field("moved_bound", moved_bound,
            "steps that limiter or cross-fade moved by more are masked in feedback [rad]");
    v.Field("train_steps", train_steps, "of the policy that base and RobustVLA go on from");
    v.Field("tune_steps", tune_steps, "of base and of RobustVLA, from that policy");
    v.Field("overrides", overrides, "KEY=VALUE of the method that adapts");
    v.Field("base_weights", base_weights, "a trained policy; nothing is recorded or trained");
    v.Field("robust_weights", robust_weights, "its counterpart of RobustVLA's objective");
    v.Field("recipe", recipe, "of the training; empty: server/training/nano_piper.yaml");
  }
};

// Thin enough for a test: one arm, one task, two demonstrations, a few steps of training.
PiperStudyOptions QuickPiperStudy();

// A table of the paper with the grids that hold its units.
struct PiperTablePlan {
  PaperTable table;
  std::vector<SweepGrid> grids;  // resolved
};

// What the study evaluates: the real-arm table (experiment main), the observer's (dob) and the one
// of unseen objects (unseen) of the study's arms and tasks. `overrides` change units that adapt,
// and no others. Errors name field, value and remedy.
absl::StatusOr<std::vector<PiperTablePlan>> PlanPiperStudy(const PiperStudyOptions& options,
                                                           const PaperProtocol& protocol,
                                                           PolicyHome home);
// The study's protocol over the weights in `out`, or those that are given.
PaperProtocol ProtocolOf(const PiperStudyOptions& options, const std::string& out);

// Names of the four tasks as the worker knows them, by the paper's number less one.
extern const char* const kPiperTasks[4];

// How it is carried out; none of it changes a result.
struct PiperStudyLaunch {
  std::string out;
  std::vector<std::string> stages = {"record", "train", "evaluate", "report"};
  int workers = 1;
  bool real_time = false;  // processes over UDP in real time, in a run directory of their own
  int udp_port = 43120;    // of the emulated arm's bus

  std::string RunFolder() const { return real_time ? out + "/live" : out; }
};

// Runs the stages; the exit code of the units. `out` is a run directory (eval/README.md), beside
//   study.yaml demos/<arm>_<task>.safetensors train/{start,base,robust}/ live/ tables/ report.md
// where live/ is another one. FAILED_PRECONDITION when it holds a study with other options.
absl::StatusOr<int> RunPiperStudy(const PiperStudyOptions& options, const PiperStudyLaunch& launch);
// The plan of a launch: in real time its units say so.
absl::StatusOr<std::vector<PiperTablePlan>> PlanOf(const PiperStudyOptions& options,
                                                   const PiperStudyLaunch& launch, PolicyHome home);

}  // namespace robostress
