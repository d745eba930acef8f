#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "robot_client/control/control_loop.h"
#include "robot_client/policy_link.h"

namespace robostress {

struct SimulatedClientOptions {
  ControlOptions control;
  PolicyLinkOptions link;
  int latency_ticks = 0;  // from a tick's observation to its chunk; 0: the same tick
};

struct SimulatedEpisode {
  bool ended_by_caller = false;            // false: its time was up, or the client left RUN
  int ticks = 0;                           // in RUN
  ClientState state = ClientState::kIdle;  // when it ended
  StateCause cause = StateCause::kNone;
  PolicyLinkCounters link;  // since the client began; `residual` is this episode's
};

// The client in simulated time: control loop, policy link and feedback of robot_client in one
// thread on a clock that moves when it is slept on. What happens is a function of the policy's
// answers alone, however long they take; a chunk arrives latency_ticks after its observation.
class SimulatedClient {
 public:
  // `arm` (connected), `clock` and cameras outlive it. Opens a session.
  static absl::StatusOr<std::unique_ptr<SimulatedClient>> Create(
      const SimulatedClientOptions& options, RobotArm* arm, Clock* clock,
      std::vector<FrameSource*> cameras, PolicyLink::Connect connect,
      FeedbackAssembler::ForwardKinematics forward = {});

  absl::Status Enable();  // IDLE -> ENABLED
  // Ticks without an episode: the arm holds.
  void Wait(double seconds);
  // One episode of at most `seconds`. `after_tick` sees every tick and ends the episode by true.
  // FAILED_PRECONDITION unless the client is ENABLED and arm and cameras are fresh.
  absl::StatusOr<SimulatedEpisode> RunEpisode(
      const EpisodeKey& key, double seconds,
      const std::function<bool(const TickRecord&)>& after_tick);
  ControlLoop& loop() { return *loop_; }

 private:
  SimulatedClient(const SimulatedClientOptions& options, Clock* clock,
                  const std::vector<FrameSource*>& cameras)
      : options_(options), clock_(clock), stamps_(cameras) {}
  void Tick();

  const SimulatedClientOptions options_;
  Clock* const clock_;
  FrameStamps stamps_;
  std::unique_ptr<ControlLoop> loop_;
  std::unique_ptr<PolicyLink> link_;
  std::deque<std::pair<uint64_t, ArmChunk>> on_the_way_;  // due tick, answer
  uint64_t ticks_ = 0;
  int64_t start_ns_ = 0;
};

}  // namespace robostress
