#include "robot_client/emulator/study/study_unit.h"

#include <filesystem>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robot_client/emulator/study/study_bench.h"
#include "robot_client/emulator/study/table_expert.h"
#include "robot_client/homing_endpoint.h"
#include "robot_client/policy_connection.h"

namespace robostress::piper {
namespace {

constexpr double kHomingMost_s = 8;
constexpr double kSettle_s = 0.4;
constexpr int kDoneTicks = 10;  // for so long the task must stay done

// The session of a unit, lent to one client after another: an arm that was power-cycled, or a table
// with other objects, has a client of its own.
class LentEndpoint : public PolicyEndpoint {
 public:
  LentEndpoint(PolicyEndpoint* policy, uint64_t* sequence) : policy_(policy), sequence_(sequence) {}
  const PolicySpec& spec() const override { return policy_->spec(); }
  absl::Status StartEpisode(const EpisodeKey& key) override { return policy_->StartEpisode(key); }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override {
    return policy_->Predict(observation, chunk);
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    executed.sequence = *sequence_ + 1;
    const absl::Status status = policy_->SendFeedback(std::move(executed));
    if (status.ok()) ++*sequence_;
    return status;
  }
  absl::StatusOr<SessionStats> Stats() override { return policy_->Stats(); }

 private:
  PolicyEndpoint* const policy_;
  uint64_t* const sequence_;
};

class UnitRun {
 public:
  UnitRun(const StudyUnit& unit, PolicyEndpoint* policy) : unit_(unit), policy_(policy) {}

  absl::Status Run(const std::function<absl::Status(const ArmEpisode&)>& report) {
    RS_ASSIGN_OR_RETURN(task_, FindTableTask(unit_.task));
    RS_ASSIGN_OR_RETURN(home_, TableExpert::Home());
    const int each = unit_.episodes / static_cast<int>(unit_.variants.size());
    for (int episode = 0; episode < unit_.episodes; ++episode) {
      const std::string& variant = unit_.variants[static_cast<size_t>(episode / each)];
      if (variant != variant_) {
        variant_ = variant;
        RS_RETURN_IF_ERROR(SetUp());
      }
      RS_RETURN_IF_ERROR(GoHome());
      RS_ASSIGN_OR_RETURN(const ArmEpisode row, RunEpisode(episode));
      RS_RETURN_IF_ERROR(report(row));
    }
    return absl::OkStatus();
  }

 private:
  // Arm, table, cameras and client from their beginnings; the session goes on.
  absl::Status SetUp() {
    client_.reset();
    StudyBenchOptions options;
    options.arm = unit_.arm;
    options.task = task_;
    RS_ASSIGN_OR_RETURN(options.variant, FindObjectVariant(variant_));
    options.image_size = policy_->spec().image_width;
    RS_ASSIGN_OR_RETURN(bench_, StudyBench::Create(options));
    SimulatedClientOptions client;
    client.control.observer = unit_.observer;
    client.control.guards = false;  // as the committed study was made
    client.control.limits.joint_jerk = std::numeric_limits<double>::infinity();
    client.link.feedback.moved_bound = unit_.moved_bound;
    client.link.instruction = Instruction(options.variant);
    client.latency_ticks = unit_.latency_ticks;
    const double period_s = 1 / client.control.rate_hz;
    RS_ASSIGN_OR_RETURN(
        client_, SimulatedClient::Create(
                     client, &bench_->arm(), &bench_->time(), bench_->cameras(),
                     [this, period_s]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
                       return std::make_unique<HomingEndpoint>(
                           std::make_unique<LentEndpoint>(policy_, &sequence_), home_, period_s);
                     }));
    counted_ = {};
    return client_->Enable();
  }

  std::string Instruction(int variant) const {
    const TableTask& task = kTableTasks.at(static_cast<size_t>(task_));
    return variant == 0 ? task.instruction
                        : kObjectVariants.at(static_cast<size_t>(variant)).instruction;
  }

  absl::Status GoHome() {
    if (client_->loop().state() == ClientState::kEnabled) {
      RS_ASSIGN_OR_RETURN(const SimulatedEpisode way,
                          client_->RunEpisode({task_, kHomingEpisode}, kHomingMost_s,
                                              [this](const TickRecord& record) {
                                                return IsHome(record.position, home_);
                                              }));
      counted_ = way.link.feedback;
      if (way.ended_by_caller && client_->loop().state() == ClientState::kEnabled)
        return absl::OkStatus();
    }
    // What a person does with an arm that is stuck or has a fault: takes the power off, puts it
    // back by hand, and starts again.
    ++power_cycles_;
    return SetUp();
  }

  absl::StatusOr<ArmEpisode> RunEpisode(int episode) {
    bench_->scene().Place(episode);
    client_->Wait(kSettle_s);
    int done_ticks = 0;
    RS_ASSIGN_OR_RETURN(
        const SimulatedEpisode played,
        client_->RunEpisode({task_, episode}, unit_.episode_s, [&](const TickRecord&) {
          const bool done = bench_->scene().Done(bench_->scene().Look());
          done_ticks = done ? done_ticks + 1 : 0;
          return done_ticks >= kDoneTicks;
        }));
    ArmEpisode row;
    row.episode = episode;
    row.variant = variant_;
    RS_ASSIGN_OR_RETURN(const int variant, FindObjectVariant(variant_));
    row.instruction = Instruction(variant);
    row.success = played.ended_by_caller;
    row.seconds = played.ticks * client_->loop().period_s();
    row.state = StateName(played.state);
    row.cause = CauseName(played.cause);
    row.residual = played.link.residual.value();
    row.eta_sq = played.link.residual.eta_sq;
    row.displacement_sq = played.link.residual.displacement_sq;
    const uint64_t sent = sequence_;
    row.feedback_chunks = sent - sent_before_;
    sent_before_ = sent;
    row.steps = played.link.feedback.steps - counted_.steps;
    row.steps_masked = played.link.feedback.steps_masked - counted_.steps_masked;
    counted_ = played.link.feedback;
    row.adapter_version = played.link.adapter_version;
    row.power_cycles = power_cycles_;
    return row;
  }

  const StudyUnit& unit_;
  PolicyEndpoint* const policy_;
  int task_ = 0;
  ArmVector home_{};
  std::string variant_;
  std::unique_ptr<StudyBench> bench_;
  std::unique_ptr<SimulatedClient> client_;
  FeedbackCounters counted_;
  uint64_t sequence_ = 0, sent_before_ = 0;
  int power_cycles_ = 0;
};

}  // namespace

absl::Status CheckStudyUnit(const StudyUnit& unit) {
  RS_RETURN_IF_ERROR(FindTableTask(unit.task).status());
  RS_RETURN_IF_ERROR(MakeWearProfile(unit.arm).status());
  for (const std::string& variant : unit.variants) {
    RS_RETURN_IF_ERROR(FindObjectVariant(variant).status());
    if (variant != kObjectVariants[0].name && unit.task != kTableTasks[0].name) {
      return absl::InvalidArgumentError(absl::StrCat("variants: '", variant,
                                                     "' is worded for task ", kTableTasks[0].name,
                                                     " only, the unit's is ", unit.task));
    }
  }
  const int variants = static_cast<int>(unit.variants.size());
  if (variants == 0 || unit.episodes < 1 || unit.episodes % variants != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "episodes: ", unit.episodes, " cannot be shared out equally to ", variants, " variants"));
  }
  if (!(unit.episode_s > 0 && unit.episode_s <= 600)) {
    return absl::InvalidArgumentError(
        absl::StrCat("episode_s is ", unit.episode_s, ", must be above 0 and at most 600"));
  }
  if (!(unit.moved_bound > 0 && unit.moved_bound <= 1)) {
    return absl::InvalidArgumentError(
        absl::StrCat("moved_bound is ", unit.moved_bound, ", must be above 0 and at most 1"));
  }
  if (unit.latency_ticks < 0 || unit.latency_ticks > 30) {
    return absl::InvalidArgumentError(
        absl::StrCat("latency_ticks is ", unit.latency_ticks, ", must be 0 to 30"));
  }
  return absl::OkStatus();
}

absl::Status RunStudyUnit(const StudyUnit& unit, PolicyEndpoint* policy,
                          const std::function<absl::Status(const ArmEpisode&)>& report) {
  RS_RETURN_IF_ERROR(CheckStudyUnit(unit));
  return UnitRun(unit, policy).Run(report);
}

absl::Status RunStudyUnitTo(const StudyUnit& unit, const std::string& server,
                            const std::string& directory) {
  RS_RETURN_IF_ERROR(CheckStudyUnit(unit));
  PolicyConnectionOptions connection;
  connection.server = server;
  connection.policy = unit.policy;
  connection.robot = absl::StrCat("piper_", unit.arm);
  connection.scenario = unit.arm;
  connection.suite = "piper_table";
  connection.seed = unit.seed;
  connection.connect_timeout_s = 60;
  connection.call_timeout_s = 300;
  connection.method = unit.method;
  connection.mode = ExecutionMode::kLockstep;
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<PolicyEndpoint> policy,
                      ConnectTo(connection, 1 / ControlOptions().rate_hz)());
  RS_RETURN_IF_ERROR(MakeDirectories(directory));
  const std::string rows = directory + "/episodes.jsonl";
  std::error_code absent;
  std::filesystem::remove(rows, absent);  // of a call that was cut off
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory + "/config.yaml", DumpConfig(unit)));
  const nlohmann::ordered_json held = {{"policy", policy->spec().name},
                                       {"model_hash", policy->spec().model_hash}};
  RS_RETURN_IF_ERROR(WriteFileAtomically(directory + "/policy.json", held.dump(2) + "\n"));
  RS_RETURN_IF_ERROR(RunStudyUnit(unit, policy.get(), [&](const ArmEpisode& episode) {
    return AppendLine(rows, ArmEpisodeLine(episode));
  }));
  return WriteFileAtomically(directory + "/DONE", "");
}

}  // namespace robostress::piper
