#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "robot_client/client_config.h"
#include "robot_client/operator_console.h"
#include "robot_client/policy_link.h"
#include "robot_client/recorder.h"

namespace robostress {

// One run of the client: an arm, its cameras, one task on one session of a policy server, recorded
// in a directory. Owns every part and its threads: control, policy, recorder, and the cameras' own.
class ClientRun {
 public:
  // Connects to everything and opens the recording `directory`; nothing moves. The order is arm,
  // cameras, server: what a person must repair first fails first.
  static absl::StatusOr<std::unique_ptr<ClientRun>> Create(const ClientConfig& config,
                                                           const std::string& directory);
  ~ClientRun();  // stops the threads; the arm holds

  void StartThreads();
  // Acts on a command; the answer for the person, or an error that says why it was refused.
  absl::StatusOr<std::string> Act(OperatorCommand command);
  // Once per round of the console: ends an episode whose time is up.
  absl::Status Watch();
  // No episode runs and the configured ones are done.
  bool done() const { return !episode_running_ && next_episode_ >= config_.episodes; }
  ClientState state() const { return loop_->state(); }
  bool episode_running() const { return episode_running_; }
  std::string description() const;  // what it is connected to

  // Stops the threads, completes the recording and writes timing.json and DONE. With `limp` the arm
  // loses its power.
  absl::Status Finish(bool limp);

 private:
  explicit ClientRun(const ClientConfig& config, std::string directory)
      : config_(config), directory_(std::move(directory)) {}
  absl::Status Open();
  PolicyLink::Connect ConnectWithHome() const;
  void StopThreads();
  absl::StatusOr<std::string> StartEpisode();
  absl::StatusOr<std::string> GoHome();
  absl::StatusOr<std::string> EndEpisode(std::optional<bool> success);
  bool WaitForState(ClientState state, double seconds);

  const ClientConfig config_;
  const std::string directory_;
  MonotonicClock clock_;
  std::unique_ptr<RobotArm> arm_;
  std::vector<std::unique_ptr<FrameSource>> cameras_;
  std::unique_ptr<FrameStamps> stamps_;
  std::unique_ptr<ControlLoop> loop_;
  std::unique_ptr<PolicyLink> link_;
  std::unique_ptr<Recorder> recorder_;
  std::atomic<bool> stop_control_{false}, stop_others_{false}, control_ready_{false};
  std::thread control_, policy_, recording_;
  std::string realtime_;           // what the control thread was granted; written before it ticks
  absl::Status recording_status_;  // of the recorder's thread, read after it
  bool threads_ = false;

  int next_episode_ = 0;
  bool episode_running_ = false;
  int64_t episode_start_ns_ = 0;
  PolicyLinkCounters at_start_;
};

}  // namespace robostress
