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
#include "robot_client/arm_model.h"
#include "robot_client/control/chunk_player.h"
#include "robot_client/control/command_limiter.h"
#include "robot_client/control/control_options.h"
#include "robot_client/control/delay_estimator.h"
#include "robot_client/control/held_arm.h"
#include "robot_client/control/live_target.h"
#include "robot_client/control/press_watch.h"
#include "robot_client/control/spsc_ring.h"
#include "robot_client/control/state_machine.h"
#include "robot_client/control/tick_record.h"
#include "robot_client/control/tick_timing.h"
#include "robot_client/control/watchdogs.h"
#include "robot_client/robot_arm.h"
#include "robot_client/snapshot_cell.h"

namespace robostress {

// What a prediction is asked about: the measurement at the start of a tick.
struct PredictionRequest {
  uint64_t id = 0;  // 1, 2, 3 ...
  int32_t episode = 0;
  int32_t chunk = 0;     // index within the episode
  uint64_t played = 0;   // rows played before
  int64_t asked_ns = 0;  // the tick's start
  int32_t running = -1;  // chunk that plays; -1: none
  int32_t row = 0;       // of it, next
  ArmVector position{};  // joints [rad], gripper [m]
};

// A way of the client's own: home, a jog, a demonstration.
struct ArmPath {
  std::vector<ArmVector> rows;  // one per tick, the first near where the arm stands
};

// Why a request was not obeyed.
enum class Refusal : uint8_t {
  kNone,
  kStale,    // the newest sample is old: nobody knows where the arm is
  kMoving,   // a joint moves
  kApart,    // the arm is not where it is sent
  kFaults,   // the arm still reports a fault
  kLost,     // its connection is gone, and could not be made again: reconnect_status
  kHeld,     // a watchdog would hold it at once
  kOutside,  // a policy's run: a part of it is beyond a bound of the workspace
};

// The control loop of one arm. A tick polls the arm, asks the watchdogs, decides the state, picks
// the row that is due, corrects it (disturbance observer), limits it, sends it and records all of
// that. It allocates nothing, takes no lock and never waits for a network, a camera or a disk:
// whatever comes and goes passes through bounded rings. Only a requested Enable blocks, in IDLE,
// and a lost connection that is made again there or at a requested clear, in FAULT.
//
// Threads: Tick and Run belong to the control thread; the receiving end of prediction_requests and
// AnswerPrediction to one other; each reader's ring to its reader; Ask and state to anyone.
class ControlLoop {
 public:
  // `arm`, `clock` and `cameras` outlive the loop; `arm` is connected. FAILED_PRECONDITION for
  // limits that leave no room, INVALID_ARGUMENT for options out of range, or with which the arm
  // brakes for longer than is looked ahead.
  // `model`: null, or outlives the loop; without one torques and workspace are not watched.
  static absl::StatusOr<std::unique_ptr<ControlLoop>> Create(const ControlOptions& options,
                                                             RobotArm* arm, Clock* clock,
                                                             const CameraStamps* cameras,
                                                             const ArmModel* model = nullptr);

  // Before the first tick: every record goes to `ring` too; a full ring loses records, and the next
  // one that fits says so (kTickLost).
  void AddReader(SpscRing<TickRecord>* ring) { readers_.push_back({ring, false}); }
  // Before the first tick: a count of presses on a stop key, raised by anyone, a signal handler for
  // one. A press holds; another one within kStopWindow_s is the quick stop. Read every tick, so
  // that no other thread's trouble delays a stop. `gentle`: presses that only ever hold.
  static constexpr double kStopWindow_s = 3;
  void ObeyStops(const std::atomic<int>* presses, const std::atomic<int>* gentle = nullptr) {
    stop_presses_ = presses;
    gentle_presses_ = gentle;
  }
  // Before the first tick, in simulated time: called in the control thread where a prediction has
  // been asked for and before this tick's row is picked.
  void OnPredictionRequested(std::function<void()> call) { on_request_ = std::move(call); }

  // Before the first tick: called in the control thread at the end of every tick; it must neither
  // wait nor allocate.
  void OnTick(std::function<void(const TickRecord&)> call) { on_tick_ = std::move(call); }

  void Ask(uint32_t requests) { asked_.fetch_or(requests, std::memory_order_acq_rel); }
  // Asks for the way to be played from ENABLED; it outlives the loop. In the order of calls.
  void Play(const ArmPath* path) {
    next_live_.store(nullptr, std::memory_order_release);
    path_.store(path, std::memory_order_release);
    Ask(kRequestMove);
  }
  // The same for targets that come in live, until the arm is held or stopped.
  void Follow(LiveTarget* live) {
    next_live_.store(live, std::memory_order_release);
    Ask(kRequestMove);
  }
  ClientState state() const { return state_.load(std::memory_order_acquire); }
  StateCause cause() const { return cause_.load(std::memory_order_acquire); }
  // Why the last clear, start, resume or move was not obeyed; kNone: it was.
  Refusal refusal() const { return refusal_.load(std::memory_order_acquire); }
  // Requests to clear, start, resume or move, and to enable, that were decided so far, obeyed or
  // not.
  uint64_t decided() const { return decided_.load(std::memory_order_acquire); }
  // The arm as the last tick saw it.
  ArmSnapshot seen() const { return seen_.Load(); }
  // All that was asked for is decided, and command and arm stand, or nothing is commanded.
  bool settled() const {
    return asked_.load(std::memory_order_acquire) == 0 && settled_.load(std::memory_order_acquire);
  }
  // Of the gripper, as last commanded [m]; one that holds something stands further open.
  double opening() const { return opening_.load(std::memory_order_acquire); }
  // The bound that stopped the last command that was stopped, or that refused kOutside, and then by
  // how much [m] the arm is beyond it.
  ArmModel::Bound crossed() const { return crossed_.load(std::memory_order_acquire); }
  double outside_m() const { return outside_m_.load(std::memory_order_acquire); }
  // The run can no longer be recorded: RUN and MOVE end in HOLD, and do not begin.
  void NoteRecordFailed() { record_failed_.store(true, std::memory_order_release); }
  int episode() const { return episode_.load(std::memory_order_acquire); }
  absl::Status enable_status() const ABSL_LOCKS_EXCLUDED(mu_);     // of the last Enable
  absl::Status reconnect_status() const ABSL_LOCKS_EXCLUDED(mu_);  // of the last Reconnect

  SpscRing<PredictionRequest>& prediction_requests() { return prediction_requests_; }
  bool AnswerPrediction(const ArmChunk& chunk) { return chunks_.Push(chunk); }

  void Tick(int64_t due_ns);
  // Ticks at absolute deadlines until `stop`; deadlines that pass during a tick are skipped, never
  // made up for.
  void Run(const std::atomic<bool>& stop);
  const TickTiming& timing() const { return timing_; }  // when Run has returned
  double period_s() const { return 1 / options_.rate_hz; }
  ArmAxes axes() const { return record_.axes; }
  const TickRecord& last_record() const { return record_; }  // control thread

 private:
  static constexpr double kNsPerSecond = 1e9;
  static constexpr uint32_t kGoing = kRequestClear | kRequestStart | kRequestMove;

  struct Reader {
    SpscRing<TickRecord>* ring;
    bool lost;
  };

  ControlLoop(const ControlOptions& options, RobotArm* arm, Clock* clock,
              const CameraStamps* cameras, const ArmModel* model);
  bool guards_workspace() const;
  absl::Status CheckLookAhead() const;
  uint32_t StopRequests(int64_t now_ns);
  bool StopAsked() const;
  void EnableArm();
  absl::Status ReconnectArm();
  Refusal WhyNot(const ArmSnapshot& arm, int64_t now_ns) const;
  uint32_t Granted(uint32_t requests, ArmSnapshot& arm, const WatchdogVerdict& verdict,
                   int64_t now_ns);
  bool Outside();
  void WatchContact(const ArmSnapshot& arm);
  void TakeChunks(int64_t now_ns);
  void AskForPrediction(int64_t now_ns);
  void OnStateChange(ClientState before, int64_t now_ns);
  void PickTarget(int64_t now_ns);
  bool PlayRow(int64_t now_ns);
  bool PlayPath();
  bool PlayLive(int64_t now_ns);
  ArmVector Advance(const ArmVector& target);
  ArmVector Stand();
  double Apart(const ArmSnapshot& arm) const;
  void StopPressing(const ArmSnapshot& arm);
  void LetGo(const ArmSnapshot& arm);
  void KeepOpening(ArmVector& position) const;
  void Correct();
  void SendCommand();
  bool Settled() const;
  void Publish();

  const ControlOptions options_;
  RobotArm* const arm_;
  Clock* const clock_;
  const CameraStamps* const cameras_;
  const ArmModel* const model_;
  const int joints_;
  CommandLimiter limiter_;
  ChunkPlayer player_;
  Watchdogs watchdogs_;
  StateMachine machine_;
  DisturbanceObserver observer_;
  PressWatch press_;
  HeldArm held_;
  DelayEstimator delay_;
  std::vector<Reader> readers_;
  std::function<void()> on_request_;
  std::function<void(const TickRecord&)> on_tick_;

  std::atomic<uint32_t> asked_{0};
  std::atomic<ClientState> state_{ClientState::kIdle};
  std::atomic<int> episode_{-1};
  std::atomic<StateCause> cause_{StateCause::kNone};
  std::atomic<Refusal> refusal_{Refusal::kNone};
  std::atomic<uint64_t> decided_{0};
  SnapshotCell<ArmSnapshot> seen_;
  std::atomic<double> opening_{0};
  std::atomic<bool> settled_{true};
  std::atomic<ArmModel::Bound> crossed_{ArmModel::kBounds};
  std::atomic<double> outside_m_{0};
  std::atomic<const ArmPath*> path_{nullptr};
  std::atomic<LiveTarget*> next_live_{nullptr};
  std::atomic<bool> record_failed_{false};
  SpscRing<PredictionRequest> prediction_requests_{4};
  SpscRing<ArmChunk> chunks_{4};

  const std::atomic<int>* stop_presses_ = nullptr;
  const std::atomic<int>* gentle_presses_ = nullptr;

  // The control thread's own.
  int seen_presses_ = 0, seen_gentle_ = 0;
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
  int64_t observed_ns_ = 0;       // time of the observer's last call
  bool enabling_ = false;         // this tick blocked for a person's Enable or Reconnect
  bool policy_invalid_ = false;   // since the last tick
  bool grips_ = false;            // the joints have had power since the gripper was commanded
  const ArmPath* way_ = nullptr;  // in MOVE; or
  LiveTarget* live_ = nullptr;    // in MOVE
  size_t way_row_ = 0;
  int guarded_ticks_ = 0;  // for which the workspace has stopped the command
  TickTiming timing_;

  mutable absl::Mutex mu_;
  absl::Status enable_status_ ABSL_GUARDED_BY(mu_);
  absl::Status reconnect_status_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
