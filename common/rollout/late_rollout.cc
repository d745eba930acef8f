#include "common/rollout/late_rollout.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/rollout/chunk_schedule.h"
#include "common/rollout/spec_checks.h"
#include "common/rollout/stop_watch.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr float kOpenGripper = -1;

// What is sent in a control step and what the policy asked for.
struct Commands {
  Eigen::VectorXf sent, policy, base;  // base: [action_dim] or empty
};

// All but the last entry, which is the gripper's and switches at once.
Eigen::VectorXf ArmDifference(const Eigen::VectorXf& a, const Eigen::VectorXf& b) {
  Eigen::VectorXf difference = a - b;
  difference[difference.size() - 1] = 0;
  return difference;
}

class LateEpisode {
 public:
  LateEpisode(const EpisodeKey& key, const RolloutOptions& options, Robot& robot,
              PolicyEndpoint& policy, uint64_t& sequence)
      : key_(key),
        options_(options),
        late_(options.late),
        robot_(robot),
        policy_(policy),
        sequence_(sequence),
        schedule_({.execute_steps = policy.spec().execute_steps,
                   .late_steps = late_.mode == LateChunks::kWaiting ? 0 : late_.late_steps,
                   .fade_steps = late_.mode == LateChunks::kCrossfade ? late_.fade_steps : 0}) {}

  absl::StatusOr<EpisodeRecord> Run() {
    if (policy_.spec().control_space == ControlSpace::kJoint) {
      return absl::InvalidArgumentError(absl::StrCat(
          "latency: policy '", policy_.spec().name,
          "' commands joint targets, and late answers are simulated for displacements of the end "
          "effector; for a Piper set client.latency_ticks"));
    }
    RS_RETURN_IF_ERROR(robot_.Reset(options_.initial_state));
    RS_RETURN_IF_ERROR(policy_.StartEpisode(key_));
    if (options_.on_step) options_.on_step(0);
    RS_ASSIGN_OR_RETURN(state_, robot_.Measure());
    record_.success = robot_.Success();
    while (!record_.success && record_.steps < robot_.horizon()) {
      if (asked_ && asked_->due <= record_.steps) RS_RETURN_IF_ERROR(Enter());
      if (IsToAsk()) RS_RETURN_IF_ERROR(Ask());
      RS_RETURN_IF_ERROR(schedule_.empty() ? Hold() : PlayRow());
    }
    RS_RETURN_IF_ERROR(Report(/*last=*/true));
    return std::move(record_);
  }

 private:
  // A prediction on its way.
  struct Asked {
    PredictedChunk answer;
    int chunk = 0;
    uint64_t played = 0;  // rows before its observation
    int due = 0;          // control step
  };

  bool IsToAsk() const {
    if (asked_) return false;
    if (schedule_.empty()) return true;
    return late_.mode != LateChunks::kWaiting &&
           schedule_.played() >=
               asked_played_ + static_cast<uint64_t>(policy_.spec().execute_steps);
  }

  absl::Status Ask() {
    const PolicySpec& spec = policy_.spec();
    absl::StatusOr<Observation> observation = absl::UnknownError("not observed");
    {
      const StopWatch watch(record_.observe_s);
      observation = robot_.Observe(spec);
    }
    RS_RETURN_IF_ERROR(observation.status());
    absl::StatusOr<PredictedChunk> answer = absl::UnknownError("not predicted");
    {
      const StopWatch watch(record_.predict_s);
      answer = late_.mode == LateChunks::kRtc && !schedule_.empty()
                   ? policy_.PredictAfter(*observation, next_chunk_, Running())
                   : policy_.Predict(*observation, next_chunk_);
    }
    RS_RETURN_IF_ERROR(answer.status());
    RS_RETURN_IF_ERROR(CheckExecutable(*answer, policy_.spec()));
    asked_played_ = schedule_.played();
    asked_ = {*std::move(answer), next_chunk_++, asked_played_, record_.steps + late_.delay_steps};
    return absl::OkStatus();
  }

  // What is left of the chunk that plays.
  RunningRows Running() const {
    RunningRows running;
    running.held = std::min(late_.delay_steps, schedule_.left());
    Eigen::Index rows = playing_.policy_actions.rows() - schedule_.row();
    if (late_.guide_rows > 0) rows = std::min(rows, Eigen::Index{running.held} + late_.guide_rows);
    running.actions = playing_.policy_actions.middleRows(schedule_.row(), rows);
    return running;
  }

  absl::Status Enter() {
    Asked asked = *std::exchange(asked_, std::nullopt);
    // Nothing is played of which not all is known.
    const PredictedChunk& answer = asked.answer;
    auto rows = static_cast<int>(std::min(answer.actions.rows(), answer.policy_actions.rows()));
    if (answer.base_actions.size() > 0)
      rows = std::min(rows, static_cast<int>(answer.base_actions.rows()));
    int row = 0;
    if (schedule_.Find(asked.chunk, asked.played, rows, row) != ChunkSchedule::Entry::kPossible)
      return absl::OkStatus();  // too late; another one is asked for when no row is left
    RS_RETURN_IF_ERROR(Report(/*last=*/false));
    const Commands before = schedule_.empty() ? HoldCommands() : RowCommands();
    playing_ = std::move(asked.answer);
    schedule_.Enter(asked.chunk, rows, row);
    sent_offset_ = ArmDifference(before.sent, playing_.actions.row(row).transpose());
    policy_offset_ = ArmDifference(before.policy, playing_.policy_actions.row(row).transpose());
    report_.emplace();
    report_->task = key_.task;
    report_->episode = key_.episode;
    report_->chunk = asked.chunk;
    report_->prediction_id = playing_.prediction_id;
    report_->first_step = row;
    return absl::OkStatus();
  }

  Commands HoldCommands() const {
    Commands hold;
    const int dim = policy_.spec().action_dim;
    hold.sent = Eigen::VectorXf::Zero(dim);
    hold.sent[dim - 1] = gripper_;
    hold.policy = hold.sent;
    if (playing_.base_actions.size() > 0) hold.base = hold.sent;
    return hold;
  }

  // Of the row that is due, faded.
  Commands RowCommands() const {
    Commands commands;
    const int row = schedule_.row();
    commands.sent = playing_.actions.row(row).transpose();
    commands.policy = playing_.policy_actions.row(row).transpose();
    if (playing_.base_actions.size() > 0)
      commands.base = playing_.base_actions.row(row).transpose();
    if (!schedule_.fading()) return commands;
    const auto share = static_cast<float>(schedule_.offset_share());
    commands.sent += share * sent_offset_;
    commands.policy += share * policy_offset_;
    return commands;
  }

  absl::Status PlayRow() {
    Commands commands = RowCommands();
    const Eigen::VectorXf own = playing_.policy_actions.row(schedule_.row()).transpose();
    const Eigen::VectorXf moved = commands.sent - playing_.actions.row(schedule_.row()).transpose();
    const bool masked = moved.cwiseAbs().maxCoeff() > late_.moved_bound;
    if (!masked) commands.policy = own;
    schedule_.Advance();
    return Step(std::move(commands), masked);
  }

  absl::Status Hold() { return Step(HoldCommands(), /*masked=*/true); }

  absl::Status Step(Commands commands, bool masked) {
    // A report has no more rows than its chunk; a hold that finds no room ends it.
    const bool reported = report_ && !report_full_ &&
                          report_->first_step + static_cast<Eigen::Index>(report_->steps.size()) <
                              playing_.actions.rows();
    report_full_ = report_ && !reported;
    RobotState before = std::exchange(state_, {});
    gripper_ = commands.sent[commands.sent.size() - 1];
    {
      const StopWatch watch(record_.step_s);
      RS_RETURN_IF_ERROR(robot_.Step(commands.sent));
    }
    RS_ASSIGN_OR_RETURN(state_, robot_.Measure());
    record_.success = robot_.Success();
    ++record_.steps;
    if (options_.on_step) options_.on_step(record_.steps);
    if (!reported) return absl::OkStatus();
    report_->steps.push_back({std::move(before), std::move(commands.policy),
                              std::move(commands.base), std::move(commands.sent)});
    report_->masked.push_back(masked);
    report_->final_state = state_;
    return absl::OkStatus();
  }

  // Of the chunk that the arm leaves, if it commanded anything.
  absl::Status Report(bool last) {
    report_full_ = false;
    if (!report_) return absl::OkStatus();
    ExecutedChunk executed = *std::exchange(report_, std::nullopt);
    if (executed.steps.empty()) return absl::OkStatus();
    executed.sequence = sequence_ + 1;
    executed.last_of_episode = last;
    if (std::find(executed.masked.begin(), executed.masked.end(), true) == executed.masked.end())
      executed.masked.clear();
    record_.chunks.push_back(executed);
    {
      const StopWatch watch(record_.feedback_s);
      RS_RETURN_IF_ERROR(policy_.SendFeedback(std::move(executed)));
    }
    ++sequence_;
    return absl::OkStatus();
  }

  const EpisodeKey key_;
  const RolloutOptions& options_;
  const LatePlay late_;
  Robot& robot_;
  PolicyEndpoint& policy_;
  uint64_t& sequence_;

  EpisodeRecord record_;
  RobotState state_;
  float gripper_ = kOpenGripper;  // last command
  ChunkSchedule schedule_;
  PredictedChunk playing_;
  Eigen::VectorXf sent_offset_, policy_offset_;  // at the entry [action_dim]
  std::optional<Asked> asked_;
  uint64_t asked_played_ = 0;
  int next_chunk_ = 0;
  std::optional<ExecutedChunk> report_;  // of `playing_`
  bool report_full_ = false;
};

}  // namespace

LatePlay LatePlayOf(const LatencyOptions& options, double control_period_s) {
  LatePlay play;
  // Rounding of the period must not add a step.
  play.delay_steps = static_cast<int>(std::ceil(options.ms / (1000 * control_period_s) - 1e-9));
  play.mode = options.mode;
  play.late_steps = options.late_steps;
  play.fade_steps = options.fade_steps;
  play.guide_rows = options.guide_rows;
  play.moved_bound = options.moved_bound;
  return play;
}

absl::StatusOr<EpisodeRecord> RunLateEpisode(const EpisodeKey& key, const RolloutOptions& options,
                                             Robot& robot, PolicyEndpoint& policy,
                                             uint64_t& sequence) {
  return LateEpisode(key, options, robot, policy, sequence).Run();
}

}  // namespace robostress
