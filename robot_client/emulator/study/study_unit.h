#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/method_options.h"
#include "common/records/arm_episode.h"
#include "common/rollout/policy_endpoint.h"
#include "robot_client/emulator/study/table_tasks.h"
#include "robot_client/simulated_client.h"

namespace robostress::piper {

// One cell of the experiment: one arm, one task, one policy and method, consecutive episodes on one
// session. The struct is the unit's config.yaml.
struct StudyUnit {
  std::string arm = "new";                       // wear profile
  std::string task = kTableTasks[0].name;        // of kTableTasks
  std::vector<std::string> variants = {"gray"};  // equally many episodes of each, in this order
  int episodes = 25;                             // initial states 0, 1, 2 ...
  double episode_s = 15;                         // of RUN until an episode has failed [s]
  bool observer = false;                         // disturbance observer
  int64_t seed = 0;                              // of the sampling noise
  int latency_ticks = 0;                         // from an observation to its chunk
  // [rad] steps that limiter or cross-fade moved by more are masked. The paper's client had no
  // limiter, and ours allows what the arm's own planner does; a real arm's bound is tighter.
  double moved_bound = 0.1;
  std::string policy = "nano";  // as the server names it
  MethodOptions method;

  template <class V>
  void Visit(V& v) {
    v.Field("arm", arm, "wear profile: new, used_one_year");
    v.Field("task", task, "one of the four");
    v.Field("variants", variants, "objects, equally many episodes each, in this order");
    v.Field("episodes", episodes, "consecutive episodes; adaptation is kept over them");
    v.Field("episode_s", episode_s, "until an episode has failed [s]");
    v.Field("observer", observer, "correct commands by the disturbance observer");
    v.Field("seed", seed, "of the policy's sampling noise");
    v.Field("latency_ticks", latency_ticks, "control steps from an observation to its chunk");
    v.Field("moved_bound", moved_bound,
            "steps that limiter or cross-fade moved by more are masked in feedback [rad]");
    v.Field("policy", policy, "one that the server holds");
    v.Section("method", method, "what the server's session does");
  }
};

// The error names field, value and what there is.
absl::Status CheckStudyUnit(const StudyUnit& unit);

// Plays the unit in simulated time: the classes of robot_client against an emulated arm. Between
// episodes the arm drives home and the objects are put back. LoRA, Adam and buffer begin with the
// session and are kept over episodes and object variants (paper, sec:supp_real). What happens is a
// function of unit and policy alone when the session is in lockstep.
//
// `policy`: an open session. `report` gets every episode as it ends; its error ends the unit.
absl::Status RunStudyUnit(const StudyUnit& unit, PolicyEndpoint* policy,
                          const std::function<absl::Status(const ArmEpisode&)>& report);

// Plays the unit against the server and writes directory/config.yaml, policy.json, episodes.jsonl
// and DONE last. A directory without DONE is begun anew: a session ends with its client.
absl::Status RunStudyUnitTo(const StudyUnit& unit, const std::string& server,
                            const std::string& directory);

}  // namespace robostress::piper
