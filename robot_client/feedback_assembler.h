#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "common/types.h"
#include "robot_client/control/tick_record.h"

namespace robostress {

struct FeedbackOptions {
  // [rad] A step whose command the cross-fade or the limiter moved by more than this on any joint
  // is masked: its residual would be the client's doing. What the disturbance observer adds is not
  // counted.
  double moved_bound = 0.005;

  template <class V>
  void Visit(V& v) {
    v.Field("moved_bound", moved_bound,
            "steps that cross-fade or limiter moved by more are masked in feedback [rad]");
  }
};

struct FeedbackCounters {
  uint64_t steps = 0;         // played
  uint64_t steps_masked = 0;  // moved beyond the bound, or not measured one period later
  uint64_t chunks = 0;        // given out
  uint64_t chunks_empty = 0;  // every step masked: nothing to report
};

// Makes executed chunks of tick records (paper, sec:supp_real): per executed step the policy's
// joint target before any correction, what was sent, and the joints measured before it and one
// control step later, so that the server's joint-space residual is eta_t = q_{t+1} - q_ref_t.
//
// A chunk travels whole, with a mask over the steps whose residual says nothing about the arm; they
// keep their predicted targets, as rows that were never executed do. A chunk of which every step is
// masked is not reported.
//
// One thread; records in the order of their ticks.
class FeedbackAssembler {
 public:
  using ForwardKinematics = std::function<Pose(const ArmVector& position)>;

  // `forward` gives the measured tool pose; absent: an identity pose, which joint space ignores.
  FeedbackAssembler(const FeedbackOptions& options, double period_s, ForwardKinematics forward = {},
                    const ArmAxes& axes = {});

  // The chunk that this record completes, if it does. `sequence`, `task` and `episode` are the
  // caller's to fill in; ExecutedChunk::episode is TickRecord::episode.
  std::optional<ExecutedChunk> Add(const TickRecord& record);

  const FeedbackCounters& counters() const { return counters_; }

 private:
  struct Step {
    TickRecord record;
    bool masked = false;
    RobotState after;
  };

  void Complete(const TickRecord& next);
  std::optional<ExecutedChunk> Close(bool last_of_episode);
  RobotState StateOf(const TickRecord& record) const;
  Eigen::VectorXf Command(const ArmVector& v) const;  // [axes_.count()]

  const FeedbackOptions options_;
  const double period_s_;
  const ForwardKinematics forward_;
  const ArmAxes axes_;
  std::vector<Step> steps_;         // of the chunk that plays
  std::optional<TickRecord> open_;  // played, not yet measured one step later
  int episode_ = -1;
  int64_t episode_start_ns_ = 0;
  FeedbackCounters counters_;
};

}  // namespace robostress
