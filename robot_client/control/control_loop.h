#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "adapter/disturbance_observer.h"
#include "common/clock.h"
#include "robot_client/control/chunk_player.h"
#include "robot_client/control/command_limiter.h"
#include "robot_client/control/spsc_ring.h"
#include "robot_client/control/state_machine.h"
#include "robot_client/control/tick_record.h"
#include "robot_client/control/tick_timing.h"
#include "robot_client/control/watchdogs.h"
#include "robot_client/robot_arm.h"

namespace robostress {

struct ControlOptions {
  double rate_hz = 30;          // control ticks per second
  double gripper_effort = 1.0;  // [Nm]
  double retry_s = 0.2;         // after a failed prediction, until the next is asked for
  bool observer = false;        // disturbance observer
  DisturbanceObserverOptions disturbance_observer;
  PlayerOptions player;
  LimiterOptions limits;
  WatchdogOptions watchdogs;

  template <class V>
  void Visit(V& v) {
    v.Field("rate_hz", rate_hz, "control ticks per second");
    v.Field("gripper_effort", gripper_effort, "most torque of the gripper [Nm]");
    v.Field("retry_s", retry_s, "after a failed prediction, until the next is asked for [s]");
    v.Field("observer", observer, "correct commands by the disturbance observer");
    v.Section("disturbance_observer", disturbance_observer, "the DOB baseline");
    v.Section("player", player, "how chunks are played");
    v.Section("limits", limits, "bounds on what is sent");
    v.Section("watchdogs", watchdogs, "when the arm is held");
  }
};

// What a prediction is asked about: the measurement at the start of a tick.
struct PredictionRequest {
  uint64_t id = 0;  // 1, 2, 3 ...
  int32_t episode = 0;
  int32_t chunk = 0;     // index within the episode
  uint64_t played = 0;   // rows played before
  int64_t asked_ns = 0;  // the tick's start
  ArmVector position{};  // joints [rad], gripper [m]
};

// The control loop of one arm. A tick polls the arm, asks the watchdogs, decides the state, picks
// the row that is due, corrects it (disturbance observer), limits it, sends it and records all of
// that. It allocates nothing, takes no lock and never waits for a network, a camera or a disk:
// whatever comes and goes passes through bounded rings. Only a requested Enable blocks, in IDLE.
//
// Threads: Tick and Run belong to the control thread; the receiving end of prediction_requests and
// AnswerPrediction to one other; each reader's ring to its reader; Ask and state to anyone.
class ControlLoop {
 public:
  // `arm`, `clock` and `cameras` outlive the loop; `arm` is connected. FAILED_PRECONDITION for
  // limits that leave no room, INVALID_ARGUMENT for options out of range.
  static absl::StatusOr<std::unique_ptr<ControlLoop>> Create(const ControlOptions& options,
                                                             RobotArm* arm, Clock* clock,
                                                             const CameraStamps* cameras);

  // Before the first tick: every record goes to `ring` too; a full ring loses records, and the next
  // one that fits says so (kTickLost).
  void AddReader(SpscRing<TickRecord>* ring) { readers_.push_back({ring, false}); }
  // Before the first tick: a count of presses on a stop key, raised by anyone, a signal handler for
  // one. A press holds; another one within kStopWindow_s is the quick stop. Read every tick, so
  // that no other thread's trouble delays a stop.
  static constexpr double kStopWindow_s = 3;
  void ObeyStops(const std::atomic<int>* presses) { stop_presses_ = presses; }
  // Before the first tick, in simulated time: called in the control thread where a prediction has
  // been asked for and before this tick's row is picked.
  void OnPredictionRequested(std::function<void()> call) { on_request_ = std::move(call); }

  void Ask(uint32_t requests) { asked_.fetch_or(requests, std::memory_order_acq_rel); }
  ClientState state() const { return state_.load(std::memory_order_acquire); }
  int episode() const { return episode_.load(std::memory_order_acquire); }
  absl::Status enable_status() const ABSL_LOCKS_EXCLUDED(mu_);  // of the last Enable

  SpscRing<PredictionRequest>& prediction_requests() { return prediction_requests_; }
  bool AnswerPrediction(const ArmChunk& chunk) { return chunks_.Push(chunk); }

  void Tick(int64_t due_ns);
  // Ticks at absolute deadlines until `stop`; deadlines that pass during a tick are skipped, never
  // made up for.
  void Run(const std::atomic<bool>& stop);
  const TickTiming& timing() const { return timing_; }  // when Run has returned
  double period_s() const { return 1 / options_.rate_hz; }
  const TickRecord& last_record() const { return record_; }  // control thread

 private:
  struct Reader {
    SpscRing<TickRecord>* ring;
    bool lost;
  };

  ControlLoop(const ControlOptions& options, RobotArm* arm, Clock* clock,
              const CameraStamps* cameras);
  uint32_t StopRequests(int64_t now_ns);
  void EnableArm();
  void TakeChunks(int64_t now_ns);
  void AskForPrediction(int64_t now_ns);
  void OnStateChange(ClientState before, int64_t now_ns);
  void PickTarget(int64_t now_ns);
  void Correct();
  void SendCommand();
  void Publish();
  bool streaming() const;

  const ControlOptions options_;
  RobotArm* const arm_;
  Clock* const clock_;
  const CameraStamps* const cameras_;
  CommandLimiter limiter_;
  ChunkPlayer player_;
  Watchdogs watchdogs_;
  StateMachine machine_;
  DisturbanceObserver observer_;
  std::vector<Reader> readers_;
  std::function<void()> on_request_;

  std::atomic<uint32_t> asked_{0};
  std::atomic<ClientState> state_{ClientState::kIdle};
  std::atomic<int> episode_{-1};
  SpscRing<PredictionRequest> prediction_requests_{4};
  SpscRing<ArmChunk> chunks_{4};

  const std::atomic<int>* stop_presses_ = nullptr;

  // The control thread's own.
  int seen_presses_ = 0;
  int64_t last_press_ns_ = 0;
  TickRecord record_;
  ArmChunk incoming_;
  uint64_t last_sequence_ = 0;
  uint64_t request_id_ = 0;    // of the newest request
  bool waiting_ = false;       // for its answer
  uint64_t asked_played_ = 0;  // rows played when it was made
  bool asked_before_ = false;  // in this stretch of RUN
  int64_t retry_after_ns_ = 0;
  int32_t next_chunk_ = 0;
  int64_t observed_ns_ = 0;  // time of the observer's last call
  bool enabling_ = false;    // this tick blocked for a person's Enable
  TickTiming timing_;

  mutable absl::Mutex mu_;
  absl::Status enable_status_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
