#include "server/sessions/session.h"

#include <torch/types.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/monotonic_wait.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/inference/torch_threads.h"
#include "server/sessions/command_bounds.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/session_checks.h"

namespace robostress {
namespace {

NominalArmOptions ArmOptions(const SessionSpec& spec) {
  NominalArmOptions options;
  options.goal_reference = spec.goal_reference;
  options.control_period_s = spec.control_period_s;
  return options;
}

ResidualOptions ScaledResidualOptions(const SessionSpec& spec) {
  ResidualOptions options = ResidualOptionsOf(
      *spec.method, ActsInJointSpace(spec) ? ResidualSpace::kJoint : ResidualSpace::kEndEffector);
  options.translation_scale = spec.translation_scale;
  options.rotation_scale = spec.rotation_scale;
  return options;
}

// Of a method that does not adapt, the defaults: nothing comes into its buffer.
LoraOptions LoraOf(const SessionSpec& spec) {
  const LoraOptions* lora = spec.method->Find<LoraOptions>();
  return lora == nullptr ? LoraOptions() : *lora;
}

PolicySpec SpecOf(const SessionResources& resources) {
  PolicySpec spec = resources.policy->spec();
  if (resources.max_view_side != 0) spec.max_view_side = resources.max_view_side;
  return spec;
}

// What a policy may answer and a session may keep: numbers, and actions that are commands. (Keys
// and values that are none show in the actions.)
absl::Status CheckComputed(const ComputedPrediction& computed) {
  // Written so that what is not a number is refused too.
  const auto commands = [](const Eigen::MatrixXf& actions) {
    return actions.size() == 0 || (actions.array().abs() <= kWidestCommand).all();
  };
  if (commands(computed.policy_actions) && commands(computed.base_actions) &&
      torch::isfinite(computed.raw).all().item<bool>() &&
      torch::isfinite(computed.context.state).all().item<bool>())
    return absl::OkStatus();
  return absl::InternalError(
      absl::StrCat("the policy predicted a value that is not finite, or above ", kWidestCommand,
                   ", with adapter version ", computed.adapter_version,
                   "; check the observation, lower the learning rate or roll the adapter back"));
}

}  // namespace

Session::Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner,
                 const GuardOptions& guard)
    : spec_(spec),
      resources_(resources),
      policy_spec_(SpecOf(resources)),
      owner_(owner),
      guard_(guard),
      key_(StreamKey("session").With(SessionIdentity(spec))),
      residual_options_(ScaledResidualOptions(spec)),
      rules_(&spec_, resources_.policy.get()),
      correction_(*spec.method, residual_options_, ArmOptions(spec)),
      buffer_(LoraOf(spec).buffer_chunks),
      schedule_(LoraOf(spec).buffer_chunks, LoraOf(spec).update_interval),
      arm_(ArmOptions(spec)) {}

Session::~Session() = default;

absl::StatusOr<std::shared_ptr<Session>> Session::Create(SessionSpec spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner,
                                                         const GuardOptions& guard) {
  UseOneTorchThread();
  RS_ASSIGN_OR_RETURN(spec.control_space, ControlSpaceOf(spec, resources.policy->spec()));
  RS_RETURN_IF_ERROR(CheckSessionSpec(spec, resources.policy->spec()));
  auto session = std::shared_ptr<Session>(new Session(spec, resources, owner, guard));
  if (const LoraOptions* lora = spec.method->Find<LoraOptions>()) {
    RS_ASSIGN_OR_RETURN(session->adapter_,
                        LoraAdapter::Create(resources.policy.get(), *lora, session->key_));
  }
  return session;
}

void Session::Cancel() {
  {
    absl::MutexLock lock(&mu_);
    cancelled_ = true;
  }
  resources_.inference->Cancel(owner_);
}

absl::Status Session::AwaitLearned(uint64_t sequence) {
  const auto learned = [this, sequence] {
    mu_.AssertHeld();
    return cancelled_ || !failure_.ok() ||
           (feedback_sequence_ >= sequence && pending_updates_ == 0);
  };
  const bool in_time = AwaitFor(mu_, learned, resources_.lockstep_timeout);
  if (cancelled_) return absl::CancelledError("the session was closed");
  RS_RETURN_IF_ERROR(failure_);
  if (!in_time) {
    return absl::DeadlineExceededError(absl::StrCat(
        "lockstep: feedback ", sequence, " was announced and is not in after ",
        absl::FormatDuration(resources_.lockstep_timeout), "; the last one received is ",
        feedback_sequence_, ". Send it on the Feedback stream, or open the session in async mode"));
  }
  return absl::OkStatus();
}

void Session::ClearBuffer() {
  buffer_.Clear();
  schedule_.Clear();
}

absl::Status Session::RequireAdapter(const char* purpose) const {
  if (adapter_ != nullptr) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("method ", spec_.method->method, " has no adapter to ", purpose));
}

absl::Status Session::StartEpisode(int task, int episode, uint64_t last_sequence) {
  if (spec_.mode == ExecutionMode::kLockstep) {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(AwaitLearned(last_sequence));
  }
  absl::MutexLock order(&order_mu_);
  RS_RETURN_IF_ERROR(StateRules::CheckEpisode(task, episode));
  {
    absl::MutexLock lock(&mu_);
    RS_RETURN_IF_ERROR(CheckBoundary(last_sequence));
  }
  v1::StateRecord record;
  record.mutable_episode()->set_task(static_cast<uint32_t>(task));
  record.mutable_episode()->set_episode(static_cast<uint32_t>(episode));
  record.mutable_episode()->set_last_feedback_sequence(last_sequence);
  RS_RETURN_IF_ERROR(Journal(record));
  absl::MutexLock lock(&mu_);
  if (cancelled_) return absl::CancelledError("the session was closed");
  ApplyEpisode(task, episode, last_sequence);
  return absl::OkStatus();
}

absl::Status Session::CheckBoundary(uint64_t last_sequence) {
  RS_RETURN_IF_ERROR(StateRules::CheckCount("last_feedback_sequence", last_sequence));
  if (last_sequence <= feedback_sequence_ || boundaries_.size() < StateRules::kMaxBoundaries)
    return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("the last feedback of ", boundaries_.size(),
                                                    " tasks is still missing; ", feedback_sequence_,
                                                    " is in: send what comes after it"));
}

void Session::ApplyEpisode(int task, int episode, uint64_t last_sequence) {
  if (episode_ && episode_->first != task) {
    if (feedback_sequence_ >= last_sequence) {
      ClearBuffer();
    } else {
      boundaries_.insert(last_sequence);
    }
  }
  episode_ = {task, episode};
  next_chunk_ = 0;
  correction_.StartEpisode();
}

absl::StatusOr<PredictedChunk> Session::Predict(const Observation& observation, int task,
                                                int episode, int chunk, uint64_t last_sequence,
                                                const PredictOptions& options) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(CheckObservation(observation, policy_spec()));

  PredictedChunk result;
  Eigen::VectorXd correction;
  {
    absl::MutexLock lock(&mu_);
    if (!episode_ || *episode_ != std::pair(task, episode)) {
      return absl::FailedPreconditionError(absl::StrCat(
          "prediction for task ", task, " episode ", episode, ", but ",
          episode_
              ? absl::StrCat("task ", episode_->first, " episode ", episode_->second, " is open")
              : "no episode is open",
          "; call StartEpisode first"));
    }
    if (spec_.mode == ExecutionMode::kLockstep) RS_RETURN_IF_ERROR(AwaitLearned(last_sequence));
    if (cancelled_) return absl::CancelledError("the session was closed");
    RS_RETURN_IF_ERROR(failure_);
    RS_RETURN_IF_ERROR(StateRules::CheckCount("prediction", next_prediction_ + 1));
    result.prediction_id = next_prediction_++;
    correction = correction_.Value();
  }
  PredictionJob job;
  job.policy = resources_.policy;
  if (adapter_ != nullptr) job.adapter = [this] { return adapter_->snapshot(); };
  const bool async = spec_.mode == ExecutionMode::kAsync;
  job.exact = !async;
  job.replaceable = async;
  job.session = owner_;
  job.priority = options.priority;
  if (job.priority == Priority::kUnspecified)
    job.priority = async ? Priority::kRobot : Priority::kSimulation;
  if (async) job.deadline = options.deadline;
  job.cancelled = options.cancelled;
  absl::StatusOr<ComputedPrediction> computed = ComputePrediction(
      *resources_.inference, std::move(job), spec_, observation, task, episode, chunk);
  RS_RETURN_IF_ERROR(computed.status());
  result.adapter_version = computed->adapter_version;
  result.queue_ms = computed->queue_ms;
  result.compute_ms = computed->compute_ms;
  result.batch_size = computed->batch_size;
  RS_RETURN_IF_ERROR(CheckComputed(*computed));
  result.policy_actions = std::move(computed->policy_actions);
  result.base_actions = std::move(computed->base_actions);
  result.actions = result.policy_actions;
  const Eigen::Index arm = result.actions.cols() - 1;
  if (spec_.method->gain != 1.0) {
    result.actions.leftCols(arm) *= static_cast<float>(spec_.method->gain);
  }
  if (correction.size() > 0) {
    constexpr double kWidest = kWidestCommand;  // what does not fit in a float would be undefined
    result.actions.leftCols(arm).rowwise() +=
        correction.head(arm).cwiseMax(-kWidest).cwiseMin(kWidest).cast<float>().transpose();
  }
  // After the last stage, whatever it was.
  if (spec_.method->gain != 1.0 || correction.size() > 0)
    BoundCommands(policy_spec(), result.policy_actions, result.actions);

  Prediction prediction{result.prediction_id, task, episode, chunk};
  prediction.answered = std::make_shared<const PredictedChunk>(result);
  if (adapter_ != nullptr) {
    prediction.raw = computed->raw;
    prediction.state = computed->context.state;
    prediction.observation = std::make_shared<const Observation>(observation);
    prediction.prefix = resources_.prefixes->Add(resources_.policy, prediction.observation,
                                                 std::move(computed->context));
    if (spec_.method->target == TargetReference::kIntent) prediction.base = result.base_actions;
  }
  const std::string record = PredictionRecord(prediction);
  std::shared_ptr<RecordWriter> writer;
  {
    absl::MutexLock lock(&mu_);
    if (!record.empty()) JournalPrediction(record, prediction);
    if (prediction.journaled && resources_.sync_predictions) writer = journal_->writer();
    Remember(std::move(prediction));
  }
  if (writer != nullptr) RS_RETURN_IF_ERROR(writer->Sync());
  return result;
}

void Session::Remember(Prediction prediction) {
  ++predictions_;
  if (episode_ == std::pair(prediction.task, prediction.episode))
    next_chunk_ = prediction.chunk + 1;
  const uint64_t id = prediction.id;
  outstanding_.emplace(id, std::move(prediction));
  while (outstanding_.size() > kMaxOutstanding) {
    outstanding_.erase(outstanding_.begin());
    ++predictions_dropped_;
  }
}

absl::StatusOr<Prediction> Session::Recall(uint64_t prediction_id) {
  absl::MutexLock lock(&mu_);
  if (prediction_id == 0 && !outstanding_.empty()) return outstanding_.rbegin()->second;
  const auto found = outstanding_.find(prediction_id);
  if (found != outstanding_.end()) return found->second;
  return absl::FailedPreconditionError(
      absl::StrCat("prediction ", prediction_id, " is not one that this session holds; it made ",
                   next_prediction_ - 1, ", keeps the last ", kMaxOutstanding,
                   " and none that is older than one already reported"));
}

std::optional<FeedbackResult> Session::Repeated(uint64_t sequence) {
  absl::MutexLock lock(&mu_);
  if (sequence > feedback_sequence_) return std::nullopt;
  ++duplicates_;
  return FeedbackResult{feedback_sequence_, updates_applied(), durable(), true};
}

SessionPosition Session::Position() {
  absl::MutexLock lock(&mu_);
  return {feedback_sequence_, next_prediction_ - 1, updates_applied(), episode_, next_chunk_};
}

void Session::CountResume() {
  absl::MutexLock lock(&mu_);
  ++resumes_;
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
  SessionCounters counters;
  counters.stats.feedback_chunks = feedback_chunks_;
  counters.stats.updates_applied = updates_applied();
  counters.stats.adapter_distance = adapter_ == nullptr ? 0 : adapter_->distance();
  counters.stats.last_loss = last_loss_;
  counters.buffered_chunks = buffer_.size();
  counters.predictions = predictions_;
  counters.updates_refused = updates_refused_;
  counters.predictions_dropped = predictions_dropped_;
  counters.updates_guarded = updates_guarded_;
  counters.duplicates = duplicates_;
  counters.resumes = resumes_;
  counters.rollbacks = rollbacks_;
  counters.steps_masked = steps_masked_;
  counters.steps_impossible = steps_impossible_;
  counters.snapshots_failed = snapshots_failed_;
  counters.predictions_unkept = predictions_unkept_;
  if (journal_ != nullptr) counters.journal_bytes = journal_->bytes();
  counters.prefixes = resources_.prefixes->counters();
  return counters;
}

}  // namespace robostress
