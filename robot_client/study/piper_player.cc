#include "robot_client/study/piper_player.h"

#include <chrono>
#include <limits>
#include <utility>

#include "adapter/method_options.h"
#include "common/status_macros.h"
#include "robot_client/homing_endpoint.h"
#include "robot_client/simulated_client.h"
#include "robot_client/study/client_method.h"
#include "robot_client/study/table_expert.h"

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

}  // namespace

// The arm, what stands before it and the client, with the session that outlives them.
class PiperPlayer::Table {
 public:
  static absl::StatusOr<std::unique_ptr<Table>> Create(const UnitConfig& unit,
                                                       std::unique_ptr<PolicyEndpoint> policy) {
    std::unique_ptr<Table> table(new Table(unit, std::move(policy)));
    RS_ASSIGN_OR_RETURN(table->suite_, FindTableSuite(unit.suite));
    RS_ASSIGN_OR_RETURN(table->home_, TableExpert::Home());
    return table;
  }
  const PolicyEndpoint& policy() const { return *policy_; }

  absl::StatusOr<EpisodeRow> Play(const PlannedEpisode& planned) {
    const int variant = suite_.variants.at(static_cast<size_t>(planned.task));
    if (variant != variant_) {
      variant_ = variant;
      RS_RETURN_IF_ERROR(SetUp());
    }
    RS_RETURN_IF_ERROR(GoHome());
    return RunEpisode(planned.initial_state);
  }

 private:
  Table(const UnitConfig& unit, std::unique_ptr<PolicyEndpoint> policy)
      : unit_(unit), policy_(std::move(policy)) {}

  // Arm, table, cameras and client from their beginnings; the session goes on.
  absl::Status SetUp() {
    client_.reset();
    StudyBenchOptions options;
    options.arm = unit_.scenario;
    options.task = suite_.task;
    options.variant = variant_;
    options.image_size = policy_->spec().image_width;
    if (unit_.client.direct) options.follow = Follow::kDirect;
    RS_ASSIGN_OR_RETURN(bench_, StudyBench::Create(options));
    SimulatedClientOptions client;
    UseMethod(*unit_.method, options.follow, client.control);
    client.control.guards = false;  // as the committed study was made
    client.control.limits.joint_jerk = std::numeric_limits<double>::infinity();
    client.link.feedback.moved_bound = unit_.client.moved_bound;
    client.link.instruction = InstructionOf(suite_, variant_);
    client.latency_ticks = unit_.client.latency_ticks;
    const double period_s = 1 / client.control.rate_hz;
    RS_ASSIGN_OR_RETURN(client_,
                        SimulatedClient::Create(
                            client, &bench_->arm(), &bench_->time(), bench_->cameras(),
                            [this, period_s]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
                              return std::make_unique<HomingEndpoint>(
                                  std::make_unique<LentEndpoint>(policy_.get(), &sequence_),
                                  ArmAxes(), home_, period_s);
                            }));
    counted_ = {};
    return client_->Enable();
  }

  absl::Status GoHome() {
    if (client_->loop().state() == ClientState::kEnabled) {
      RS_ASSIGN_OR_RETURN(const SimulatedEpisode way,
                          client_->RunEpisode({suite_.task, kHomingEpisode}, kHomingMost_s,
                                              [this](const TickRecord& record) {
                                                return IsHome(record.axes, record.position, home_);
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

  absl::StatusOr<EpisodeRow> RunEpisode(int state) {
    bench_->scene().Place(state);
    client_->Wait(kSettle_s);
    int done_ticks = 0;
    RS_ASSIGN_OR_RETURN(
        const SimulatedEpisode played,
        client_->RunEpisode({suite_.task, state}, unit_.client.episode_s, [&](const TickRecord&) {
          const bool done = bench_->scene().Done(bench_->scene().Look());
          done_ticks = done ? done_ticks + 1 : 0;
          return done_ticks >= kDoneTicks;
        }));
    RS_ASSIGN_OR_RETURN(const SessionStats stats, policy_->Stats());
    EpisodeRow row;
    row.instruction = InstructionOf(suite_, variant_);
    row.success = played.ended_by_caller;
    row.steps = played.ticks;
    row.seconds = played.ticks * client_->loop().period_s();
    row.state = StateName(played.state);
    row.cause = CauseName(played.cause);
    row.residual = played.link.residual.value();
    row.eta_sq = played.link.residual.eta_sq;
    row.a_sq = played.link.residual.displacement_sq;
    row.chunks = static_cast<int>(sequence_ - sent_before_);
    sent_before_ = sequence_;
    row.measured_steps = played.link.feedback.steps - counted_.steps;
    row.masked_steps = played.link.feedback.steps_masked - counted_.steps_masked;
    counted_ = played.link.feedback;
    row.updates = static_cast<int>(played.link.adapter_version);
    row.adapter_distance = stats.adapter_distance;
    row.power_cycles = power_cycles_;
    return row;
  }

  const UnitConfig& unit_;
  const std::unique_ptr<PolicyEndpoint> policy_;
  TableSuite suite_{};
  ArmVector home_{};
  int variant_ = -1;
  std::unique_ptr<StudyBench> bench_;
  std::unique_ptr<SimulatedClient> client_;
  FeedbackCounters counted_;
  uint64_t sequence_ = 0, sent_before_ = 0;
  int power_cycles_ = 0;
};

PiperPlayer::PiperPlayer(const UnitConfig& unit, PolicyLink::Connect connect)
    : unit_(unit), connect_(std::move(connect)) {}

PiperPlayer::~PiperPlayer() = default;

absl::StatusOr<std::string> PiperPlayer::Open() {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<PolicyEndpoint> policy, connect_());
  RS_ASSIGN_OR_RETURN(table_, Table::Create(unit_, std::move(policy)));
  return table_->policy().spec().model_hash;
}

absl::StatusOr<PlayedEpisode> PiperPlayer::Play(const PlannedEpisode& planned,
                                                UnitDirectory& /*directory*/) {
  const auto start = std::chrono::steady_clock::now();
  PlayedEpisode played;
  RS_ASSIGN_OR_RETURN(played.row, table_->Play(planned));
  played.timing.wall_s =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return played;
}

}  // namespace robostress::piper
