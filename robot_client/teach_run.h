#pragma once

#include <future>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "robot_client/client_run.h"
#include "robot_client/demonstration/demonstration_writer.h"
#include "robot_client/teach/episode_tap.h"
#include "robot_client/teach/gamepad.h"
#include "robot_client/teach/jog_target.h"
#include "robot_client/teach/key_input.h"
#include "robot_client/teach/leader_arm.h"
#include "robot_client/teach/raw_terminal.h"

namespace robostress {

// How demonstrations are given and where they go.
struct TeachOptions {
  enum class By { kHand, kLeader, kKeyboard, kGamepad };
  By by = By::kHand;
  std::string source;          // the leader's bus, the gamepad's file
  std::string directory;       // of the data set; runs/NNN in it holds what the client records
  double tool_velocity = 0.1;  // [m/s] of a jog
  bool keep_failures = false;
};

// "hand", "leader:BUS", "keyboard", "gamepad[:FILE]" into `by` and `source`.
absl::Status ParseTeachBy(const std::string& text, TeachOptions* options);

// A run of the client in which a person demonstrates: the arm, its cameras, and what guides it,
// recorded as data sets (demonstration/). The control loop, its limits and its guards are those of
// any run. By hand the arm is never enabled and no command is ever sent. Console's thread.
class TeachRun {
 public:
  // Connects to everything; nothing moves. `console` outlives it.
  static absl::StatusOr<std::unique_ptr<TeachRun>> Create(ClientConfig config,
                                                          const TeachOptions& options,
                                                          OperatorConsole* console);
  ~TeachRun();

  void StartThreads();
  // As ClientRun's; saving an episode goes on behind it, so that a stop is always heard.
  absl::StatusOr<std::string> Act(const OperatorOrder& order);
  absl::StatusOr<std::string> Watch();
  bool busy() const { return run_->busy() || saving_.valid(); }
  void Say(std::string line) { run_->Say(std::move(line)); }
  std::string description() const;
  // Waits for an episode that is being saved, drops one under way, ends the run.
  absl::Status Finish(bool limp);

  ClientRun& run() { return *run_; }

 private:
  TeachRun(const ClientConfig& config, const TeachOptions& options, OperatorConsole* console)
      : config_(config), options_(options), console_(console) {}
  absl::Status Open();
  absl::Status OpenSource();
  absl::Status OpenWriter();
  bool by_hand() const { return options_.by == TeachOptions::By::kHand; }
  absl::StatusOr<std::string> Record();
  absl::StatusOr<std::string> End(bool success);
  absl::StatusOr<std::string> Discard();
  void WatchKeys();

  const ClientConfig config_;
  const TeachOptions options_;
  OperatorConsole* const console_;
  std::unique_ptr<ClientRun> run_;
  std::unique_ptr<LeaderArm> leader_;
  std::unique_ptr<Gamepad> gamepad_;
  std::unique_ptr<KeyInput> keys_;
  std::unique_ptr<RawTerminal> raw_;
  std::unique_ptr<LiveTarget> live_;
  std::unique_ptr<DemonstrationWriter> writer_;
  std::unique_ptr<EpisodeTap> tap_;
  bool following_ = false;  // the last way that was asked for is the live one
  bool recording_ = false;
  bool told_ = false;  // that the ticks of the episode have ended
  std::future<absl::StatusOr<DemonstrationSummary>> saving_;
};

}  // namespace robostress
