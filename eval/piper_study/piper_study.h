#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

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

// One cell: consecutive episodes of one method on one session.
struct PiperUnit {
  std::string id;          // main_new_1_ours
  std::string experiment;  // main, dob, unseen
  std::string arm;
  int task = 1;        // 1 to 4
  std::string method;  // base, robust, ours, dob, dob_ours
};

// Tables need: main base, robust and ours on every arm and task; dob the two with the disturbance
// observer on the first arm's first task (base and ours are main's); unseen base, robust and ours
// there, five episodes of each object variant. Errors name field, value and remedy.
absl::StatusOr<std::vector<PiperUnit>> PlanPiperStudy(const PiperStudyOptions& options);
// What piper_study_worker is given; `policy` as the server names it.
absl::StatusOr<std::string> PiperUnitYaml(const PiperStudyOptions& options, const PiperUnit& unit,
                                          const std::string& policy);

// Tasks and object variants as the worker knows them, by the paper's number and from 0 (as
// demonstrated).
extern const char* const kPiperTasks[4];
extern const char* const kPiperVariants[6];

// How it is carried out; none of it changes a result.
struct PiperStudyLaunch {
  std::string out;
  std::vector<std::string> stages = {"record", "train", "evaluate", "report"};
  int workers = 1;
  bool real_time = false;  // processes over UDP in real time, in a folder of their own
  int udp_port = 43120;    // of the emulated arm's bus
};

// Runs the stages. Layout of `out`:
//   study.yaml demos/<arm>_<task>.safetensors train/{start,base,robust}/ units/<id>/ live/<id>/
//   logs/ episodes.csv report.json report.md
// FAILED_PRECONDITION when it holds a study with other options.
absl::Status RunPiperStudy(const PiperStudyOptions& options, const PiperStudyLaunch& launch);

}  // namespace robostress
