#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "robot_client/client_config.h"
#include "robot_client/motion/motion.h"
#include "robot_client/operator_console.h"
#include "robot_client/own_ways.h"
#include "robot_client/policy_link.h"
#include "robot_client/recorder.h"
#include "robot_client/state_reporter.h"

namespace robostress {

// One run of the client: an arm, its cameras, one task on one session of a policy server, recorded
// in a directory. Owns every part and its threads: control, policy, recorder, reporter, and the
// cameras' own. Without a server the arm can be enabled, jogged and driven home.
class ClientRun {
 public:
  // Connects to everything and opens the recording `directory`; nothing moves. The order is arm,
  // cameras, server: what a person must repair first fails first.
  // `motion`, where given, makes the motion that `play` plays, once the arm's limits are known.
  using MotionMaker = std::function<absl::StatusOr<Motion>(const ArmLimits&, const ArmModel*)>;
  static absl::StatusOr<std::unique_ptr<ClientRun>> Create(const ClientConfig& config,
                                                           const std::string& directory,
                                                           const MotionMaker& motion = nullptr);
  ~ClientRun();  // brakes and stops the threads; the arm holds

  void StartThreads();
  // Acts on an order at once, and never waits: what takes time goes on in Watch. The answer for the
  // person, empty while it is not known, or an error that says why it was refused.
  absl::StatusOr<std::string> Act(const OperatorOrder& order);
  // Once per round of the console: answers what Act began, and ends an episode whose time is up.
  // Empty: nothing to say.
  absl::StatusOr<std::string> Watch();
  // Something that Act began goes on.
  bool busy() const { return pending_.has_value(); }
  // No episode runs and the configured ones are done.
  bool done() const { return !episode_running_ && next_episode_ >= config_.episodes; }
  ClientState state() const { return loop_->state(); }
  bool episode_running() const { return episode_running_; }
  // The fastest that the motion was played to its end in this run; 0: not yet.
  double fastest_played() const { return ways_->fastest_played(); }
  // The arm follows what comes in live, from ENABLED until it is held. `live` outlives the run.
  absl::StatusOr<std::string> FollowLive(LiveTarget* live);
  std::string description() const;  // what it is connected to
  // Before StartThreads, for what is put on top of a run.
  ControlLoop& loop() { return *loop_; }
  const RobotArm& arm() const { return *arm_; }
  Clock& clock() { return clock_; }
  std::vector<FrameSource*> cameras() const;
  void Say(std::string line) { reporter_.Say(std::move(line)); }

  // With `limp` the arm loses its power, first of all and whatever fails afterwards. Stops the
  // threads, completes the recording and writes timing.json and DONE.
  absl::Status Finish(bool limp);
  void StopThreads();  // once the arm has braked, where it has power; nothing is completed

 private:
  explicit ClientRun(const ClientConfig& config, std::string directory)
      : config_(config), directory_(std::move(directory)) {}
  absl::Status Open(const MotionMaker& motion);
  absl::Status CheckCollisionProtection();
  absl::StatusOr<std::string> Enable();
  absl::StatusOr<std::string> Clear();
  absl::StatusOr<std::string> StartEpisode();
  absl::StatusOr<std::string> StartWay(const OperatorOrder& order);  // home, jog, play
  absl::StatusOr<std::string> EndEpisode(std::optional<bool> success);
  absl::StatusOr<std::string> CountEpisode(std::optional<bool> success);
  void TellServersError();
  void Brake();

  const ClientConfig config_;
  const std::string directory_;
  MonotonicClock clock_;
  std::unique_ptr<RobotArm> arm_;
  std::unique_ptr<ArmModel> model_;
  std::vector<std::unique_ptr<FrameSource>> cameras_;
  std::unique_ptr<FrameStamps> stamps_;
  std::unique_ptr<ControlLoop> loop_;
  std::unique_ptr<PolicyLink> link_;  // null: no policy server
  std::unique_ptr<Recorder> recorder_;
  StateReporter reporter_{1};
  std::atomic<bool> stop_control_{false}, stop_others_{false}, control_ready_{false};
  std::thread control_, policy_, recording_, reporting_;
  std::string realtime_;           // what the control thread was granted; written before it ticks
  absl::Status recording_status_;  // of the recorder's thread, read after it
  bool threads_ = false;

  std::unique_ptr<OwnWays> ways_;
  std::optional<PendingAnswer> pending_;
  std::string told_error_;
  int next_episode_ = 0;
  bool episode_running_ = false;
  int64_t episode_start_ns_ = 0;
  PolicyLinkCounters at_start_;
};

}  // namespace robostress
