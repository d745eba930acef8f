#include "server/sessions/session.h"

#include <torch/types.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/monotonic_wait.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "server/inference/torch_threads.h"
#include "server/sessions/journal/session_events.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/session_checks.h"

namespace robostress {
namespace {

PolicySpec SpecOf(const SessionResources& resources) {
  PolicySpec spec = resources.policy->spec();
  if (resources.max_view_side != 0) spec.max_view_side = resources.max_view_side;
  return spec;
}

}  // namespace

Session::Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner)
    : spec_(spec),
      resources_(resources),
      policy_spec_(SpecOf(resources)),
      owner_(owner),
      residual_options_(ResidualOf(spec, *spec.method)),
      rules_(&spec_, resources_.policy.get()),
      correction_(*spec.method, residual_options_, NominalArmOf(spec, *spec.method)) {}

Session::~Session() = default;

absl::StatusOr<std::shared_ptr<Session>> Session::Create(SessionSpec spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner,
                                                         const GuardOptions& guard) {
  UseOneTorchThread();
  RS_ASSIGN_OR_RETURN(spec.control_space, ControlSpaceOf(spec, resources.policy->spec()));
  RS_RETURN_IF_ERROR(CheckSessionSpec(spec, resources.policy->spec()));
  auto session = std::shared_ptr<Session>(new Session(spec, resources, owner));
  RS_ASSIGN_OR_RETURN(session->learner_, Learner::Create(&session->spec_, resources.policy,
                                                         resources.prefixes, guard));
  return session;
}

void Session::Cancel() {
  {
    absl::MutexLock lock(&mu_);
    cancelled_ = true;
  }
  resources_.inference->Cancel(owner_);
}

absl::Status Session::CheckAlive() const {
  if (cancelled_) return absl::CancelledError("the session was closed");
  return failure_;
}

absl::Status Session::AwaitLearned(uint64_t sequence) {
  const auto learned = [this, sequence] {
    mu_.AssertHeld();
    return cancelled_ || !failure_.ok() ||
           (feedback_sequence_ >= sequence && learner_->pending() == 0);
  };
  const bool in_time = AwaitFor(mu_, learned, resources_.lockstep_timeout);
  RS_RETURN_IF_ERROR(CheckAlive());
  if (!in_time) {
    return absl::DeadlineExceededError(absl::StrCat(
        "lockstep: feedback ", sequence, " was announced and is not in after ",
        absl::FormatDuration(resources_.lockstep_timeout), "; the last one received is ",
        feedback_sequence_, ". Send it on the Feedback stream, or open the session in async mode"));
  }
  return absl::OkStatus();
}

// --------------------------------------------------------------------------------------- episodes

absl::Status Session::StartEpisode(const EpisodeKey& key, uint64_t last_sequence) {
  if (spec_.mode == ExecutionMode::kLockstep) {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(last_sequence));
  }
  absl::MutexLock order(&order_mu_);
  RS_RETURN_IF_ERROR(StateRules::CheckEpisode(key.task, key.episode));
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(learner_->CheckBoundary(last_sequence, feedback_sequence_));
  }
  const EpisodeStarted started{key, last_sequence};
  RS_RETURN_IF_ERROR(Journal(EncodeEvent(started)));
  absl::MutexLock lock(&mu_);
  if (cancelled_) return absl::CancelledError("the session was closed");
  ApplyEpisode(started);
  return absl::OkStatus();
}

void Session::ApplyEpisode(const EpisodeStarted& started) {
  if (episode_ && episode_->task != started.key.task)
    learner_->AddBoundary(started.last_sequence, feedback_sequence_);
  episode_ = started.key;
  next_chunk_ = 0;
  correction_.StartEpisode();
}

// ------------------------------------------------------------------------------------ predictions

PredictionJob Session::JobOf(std::shared_ptr<const Observation> observation,
                             const PredictOptions& options) const {
  PredictionJob job;
  job.policy = resources_.policy;
  job.observation = std::move(observation);
  if (learner_->adapts()) job.adapter = [this] { return learner_->published(); };
  const bool async = spec_.mode == ExecutionMode::kAsync;
  job.exact = !async;
  job.replaceable = async;
  job.session = owner_;
  job.priority = options.priority;
  if (job.priority == Priority::kUnspecified)
    job.priority = async ? Priority::kRobot : Priority::kSimulation;
  if (async) job.deadline = options.deadline;
  job.cancelled = options.cancelled;
  job.running = options.running;
  return job;
}

absl::StatusOr<PredictedChunk> Session::Predict(std::shared_ptr<const Observation> observation,
                                                const ChunkKey& key, uint64_t last_sequence,
                                                const PredictOptions& options) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(CheckObservation(*observation, policy_spec()));
  RS_RETURN_IF_ERROR(StateRules::CheckKey(key));
  if (options.running) RS_RETURN_IF_ERROR(CheckRunningRows(*options.running, policy_spec()));

  auto answer = std::make_shared<PredictedChunk>();
  Eigen::VectorXd correction;
  {
    absl::MutexLock lock(&mu_);
    if (episode_ != key.episode) {
      const std::string open = episode_ ? absl::StrCat("task ", episode_->task, " episode ",
                                                       episode_->episode, " is open")
                                        : "no episode is open";
      return absl::FailedPreconditionError(absl::StrCat("prediction for task ", key.episode.task,
                                                        " episode ", key.episode.episode, ", but ",
                                                        open, "; call StartEpisode first"));
    }
    if (spec_.mode == ExecutionMode::kLockstep) RS_RETURN_IF_ERROR(AwaitLearned(last_sequence));
    RS_RETURN_IF_ERROR(CheckAlive());
    RS_ASSIGN_OR_RETURN(answer->prediction_id, outstanding_.Next());
    correction = correction_.Value();
  }
  RS_ASSIGN_OR_RETURN(
      SampledPrediction sampled,
      ComputePrediction(*resources_.inference, JobOf(observation, options), spec_, key, *answer));
  CorrectCommands(*spec_.method, policy_spec(), correction, *answer);

  Prediction prediction{.id = answer->prediction_id, .key = key};
  prediction.answered = answer;
  if (learner_->adapts()) {
    prediction.raw = sampled.raw;
    prediction.state = sampled.context.state;
    prediction.observation = std::move(observation);
    prediction.prefix = resources_.prefixes->Add(resources_.policy, prediction.observation,
                                                 std::move(sampled.context));
    if (NeedsBase(spec_.method->target)) prediction.base = answer->base_actions;
  }
  const std::string record = durable() ? EncodeEvent(prediction) : std::string();
  std::shared_ptr<RecordWriter> writer;
  {
    absl::MutexLock lock(&mu_);
    if (durable()) AppendPrediction(record, prediction);
    if (prediction.journaled && resources_.sync_predictions) writer = journal_->writer();
    Remember(std::move(prediction));
    if (durable() && SnapshotsDue() > 0) PostSnapshot();
  }
  if (writer != nullptr) RS_RETURN_IF_ERROR(writer->Sync());
  return *answer;
}

void Session::Remember(Prediction prediction) {
  if (episode_ == prediction.key.episode)
    next_chunk_ = std::min(prediction.key.chunk + 1, WireLimits::kIndex);
  outstanding_.Keep(std::move(prediction));
}

absl::StatusOr<Prediction> Session::Recall(uint64_t prediction_id) {
  absl::MutexLock lock(&mu_);
  RS_ASSIGN_OR_RETURN(const Prediction* const found, outstanding_.Find(prediction_id));
  return *found;
}

// ------------------------------------------------------------------------------------------ state

FeedbackResult Session::Acknowledge(bool duplicate) const {
  FeedbackResult result{feedback_sequence_, learner_->updates_applied(), durable(), duplicate, {}};
  result.adapter_distance = learner_->distance();
  result.last_loss = learner_->last_loss();
  return result;
}

std::optional<FeedbackResult> Session::Repeated(uint64_t sequence) {
  absl::MutexLock lock(&mu_);
  if (sequence > feedback_sequence_) return std::nullopt;
  ++counted_.duplicates;
  return Acknowledge(true);
}

SessionPosition Session::Position() {
  absl::MutexLock lock(&mu_);
  return {feedback_sequence_, outstanding_.last(), learner_->updates_applied(), episode_,
          next_chunk_};
}

void Session::CountResume() {
  absl::MutexLock lock(&mu_);
  ++counted_.resumes;
}

absl::Status Session::failure() {
  absl::MutexLock lock(&mu_);
  return failure_;
}

absl::StatusOr<SessionCounters> Session::Counters() {
  if (spec_.mode == ExecutionMode::kLockstep) {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(0));
  }
  return CountersNow();
}

SessionCounters Session::CountersNow() {
  absl::MutexLock lock(&mu_);
  SessionCounters counters = counted_;
  counters.stats.updates_applied = learner_->updates_applied();
  counters.stats.adapter_distance = learner_->distance();
  counters.stats.last_loss = learner_->last_loss();
  counters.buffered_chunks = learner_->buffered();
  counters.updates_refused = learner_->counters().refused;
  counters.updates_guarded = learner_->counters().guarded;
  counters.rollbacks = learner_->counters().rollbacks;
  counters.predictions = outstanding_.made();
  counters.predictions_dropped = outstanding_.dropped();
  if (durable()) counters.journal_bytes = journal_->bytes();
  counters.prefixes = resources_.prefixes->counters();
  return counters;
}

}  // namespace robostress
