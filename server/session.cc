#include "server/session.h"

#include <spdlog/spdlog.h>
#include <torch/torch.h>

#include <algorithm>
#include <cmath>

#include "absl/algorithm/container.h"
#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/adaptation_state.h"
#include "adapter/compensation.h"
#include "adapter/pseudo_target.h"
#include "common/rpc/convert.h"
#include "common/rpc/spec_checks.h"
#include "common/status_macros.h"
#include "server/torch_threads.h"

namespace robostress {
namespace {

absl::Status CheckMethod(const MethodOptions& m, const PolicySpec& policy) {
  const std::vector<std::string> names = MethodNames();
  const auto invalid = [&m](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat("method ", m.method, ": ", parts...));
  };
  if (!absl::c_linear_search(names, m.method)) {
    return absl::NotFoundError(
        absl::StrCat("unknown method '", m.method, "'; known: ", absl::StrJoin(names, ", ")));
  }
  if (m.adapt && !policy.adaptable)
    return invalid("policy ", policy.name, " has no layers to adapt; use base");
  if (m.adapt && m.direct)
    return invalid("adapt and direct exclude each other; set one of them to false");
  if (m.buffer_chunks < 1 || m.buffer_chunks > 4096)
    return invalid("buffer_chunks is ", m.buffer_chunks, ", must be 1..4096");
  if (m.update_interval < 1)
    return invalid("update_interval is ", m.update_interval, ", must be at least 1");
  if (m.batch < 1 || m.batch > m.buffer_chunks) {
    return invalid("batch is ", m.batch, ", must be 1..", m.buffer_chunks, " (buffer_chunks)");
  }
  const auto in_range = [](double value, double low, double high) {
    return value >= low && value <= high;
  };
  if (!in_range(m.learning_rate, 0, 1))
    return invalid("learning_rate is ", m.learning_rate, ", must be 0..1");
  if (!in_range(m.lora_init_std, 0, 10))
    return invalid("lora_init_std is ", m.lora_init_std, ", must be 0..10");
  if (!in_range(m.beta1, 0, 1) || m.beta1 == 1)
    return invalid("beta1 is ", m.beta1, ", must be in [0, 1)");
  if (!in_range(m.beta2, 0, 1) || m.beta2 == 1)
    return invalid("beta2 is ", m.beta2, ", must be in [0, 1)");
  if (!in_range(m.adam_epsilon, 1e-30, 1))
    return invalid("adam_epsilon is ", m.adam_epsilon, ", must be above 0, at most 1");
  if (!in_range(m.clip_norm, 1e-12, 1e12))
    return invalid("clip_norm is ", m.clip_norm, ", must be above 0");
  if (!in_range(m.anchor_weight, 0, 1e6))
    return invalid("anchor_weight is ", m.anchor_weight, ", must be 0 or above");
  if (!in_range(m.gain, -100, 100)) return invalid("gain is ", m.gain, ", must be in -100..100");
  if (!in_range(m.tracking_gain, 1e-3, 100))
    return invalid("tracking_gain is ", m.tracking_gain, ", must be 0.001..100");
  return absl::OkStatus();
}

torch::Tensor DrawNoise(const StreamKey& key, int64_t horizon, int64_t dim) {
  torch::Tensor noise = torch::empty({1, horizon, dim}, torch::kFloat32);
  RandomStream stream(key);
  float* values = noise.data_ptr<float>();
  for (int64_t i = 0; i < noise.numel(); ++i) values[i] = static_cast<float>(stream.Normal());
  return noise;
}

NominalArmOptions ArmOptions(const SessionSpec& spec) {
  NominalArmOptions options;
  options.goal_reference = spec.goal_reference;
  options.control_period_s = spec.control_period_s;
  return options;
}

ResidualOptions ScaledResidualOptions(const SessionSpec& spec) {
  ResidualOptions options = ResidualOptionsOf(
      spec.method, ActsInJointSpace(spec) ? ResidualSpace::kJoint : ResidualSpace::kEndEffector);
  options.translation_scale = spec.translation_scale;
  options.rotation_scale = spec.rotation_scale;
  return options;
}

}  // namespace

std::string SessionIdentity(const SessionSpec& spec) {
  return absl::StrJoin({spec.suite, spec.scenario, absl::StrCat(spec.severity), spec.policy,
                        spec.method.method, absl::StrCat(spec.seed)},
                       "/");
}

StreamKey NoiseKey(const SessionSpec& spec, int task, int episode, int chunk) {
  return StreamKey("prediction_noise")
      .With(spec.method.noise_stream)
      .With(spec.seed)
      .With(spec.suite)
      .With(int64_t{task})
      .With(int64_t{episode})
      .With(int64_t{chunk});
}

Session::Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner)
    : spec_(spec),
      resources_(resources),
      owner_(owner),
      key_(StreamKey("session").With(SessionIdentity(spec))),
      residual_options_(ScaledResidualOptions(spec)),
      buffer_(spec.method.buffer_chunks),
      schedule_(spec.method.buffer_chunks, spec.method.update_interval),
      arm_(ArmOptions(spec)) {}

absl::StatusOr<std::shared_ptr<Session>> Session::Create(const SessionSpec& spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(CheckMethod(spec.method, resources.policy->spec()));
  if (ActsInJointSpace(spec) && spec.method.target == TargetReference::kNominal) {
    return absl::InvalidArgumentError(
        absl::StrCat("method ", spec.method.method,
                     ": target nominal models an end-effector "
                     "controller; robot ",
                     spec.robot, " acts in joint space: use target executed or intent"));
  }
  if (ActsInJointSpace(spec) && spec.method.gain != 1.0) {
    return absl::InvalidArgumentError(
        absl::StrCat("method ", spec.method.method, ": gain ", spec.method.gain,
                     " would scale absolute joint targets; robot ", spec.robot, " needs gain 1"));
  }
  auto session = std::shared_ptr<Session>(new Session(spec, resources, owner));
  if (spec.method.adapt) {
    RS_ASSIGN_OR_RETURN(session->adapter_,
                        LoraAdapter::Create(resources.policy.get(), spec.method, session->key_));
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
  const bool in_time = mu_.AwaitWithTimeout(absl::Condition(&learned), resources_.lockstep_timeout);
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

absl::Status Session::StartEpisode(int task, int episode, uint64_t last_sequence) {
  absl::MutexLock lock(&mu_);
  if (spec_.mode == ExecutionMode::kLockstep) RS_RETURN_IF_ERROR(AwaitLearned(last_sequence));
  if (cancelled_) return absl::CancelledError("the session was closed");
  if (episode_ && episode_->first != task) {
    if (feedback_sequence_ >= last_sequence) {
      ClearBuffer();
    } else {
      boundaries_.insert(last_sequence);
    }
  }
  episode_ = {task, episode};
  direct_correction_.resize(0);
  return absl::OkStatus();
}

absl::StatusOr<PredictedChunk> Session::Predict(const Observation& observation, int task,
                                                int episode, int chunk, uint64_t last_sequence,
                                                const PredictOptions& options) {
  UseOneTorchThread();
  const FlowPolicy& policy = *resources_.policy;
  const PolicySpec& spec = policy.spec();
  RS_RETURN_IF_ERROR(CheckObservation(observation, spec));

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
    result.prediction_id = next_prediction_++;
    correction = direct_correction_;
  }
  const bool async = spec_.mode == ExecutionMode::kAsync;
  PredictionJob job;
  job.policy = resources_.policy;
  job.observation = &observation;
  job.with_base = spec_.method.track_intent || spec_.method.target == TargetReference::kIntent;
  job.exact = !async;
  job.replaceable = async;
  job.session = owner_;
  job.priority = options.priority;
  if (job.priority == Priority::kUnspecified)
    job.priority = async ? Priority::kRobot : Priority::kSimulation;
  if (async) job.deadline = options.deadline;
  job.cancelled = options.cancelled;
  if (adapter_ != nullptr) job.adapter = [this] { return adapter_->snapshot(); };

  Prediction prediction{task, episode, chunk, {}, {}, {}, {}};
  try {
    torch::NoGradGuard no_grad;
    job.noise = DrawNoise(NoiseKey(spec_, task, episode, chunk), policy.horizon(),
                          policy.model_action_dim());
    RS_ASSIGN_OR_RETURN(SampledPrediction sampled, resources_.inference->Predict(job));
    result.adapter_version = sampled.adapter == nullptr ? 0 : sampled.adapter->version;
    PolicyContext& context = sampled.context;
    const torch::Tensor raw = sampled.raw;
    result.policy_actions = policy.ToEnvironment(raw, context.state);
    if (job.with_base) {
      result.base_actions = sampled.base.defined()
                                ? policy.ToEnvironment(sampled.base, context.state)
                                : result.policy_actions;
    }
    if (adapter_ != nullptr) {
      prediction.raw = raw;
      prediction.state = context.state;
      prediction.prefix = resources_.prefixes->Add(
          resources_.policy, std::make_shared<const Observation>(observation), std::move(context));
      if (spec_.method.target == TargetReference::kIntent) prediction.base = result.base_actions;
    }
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("prediction failed: ", error.what()));
  }
  if (!result.policy_actions.allFinite()) {
    return absl::InternalError(
        absl::StrCat("the policy predicted a value that is not finite with adapter version ",
                     result.adapter_version, "; lower the learning rate or roll the adapter back"));
  }

  result.actions = result.policy_actions;
  const Eigen::Index arm = result.actions.cols() - 1;
  if (spec_.method.gain != 1.0) {
    result.actions.leftCols(arm) *= static_cast<float>(spec_.method.gain);
  }
  if (spec_.method.direct && correction.size() > 0) {
    result.actions.leftCols(arm).rowwise() -= correction.head(arm).cast<float>().transpose();
  }

  absl::MutexLock lock(&mu_);
  ++predictions_;
  outstanding_.emplace(result.prediction_id, std::move(prediction));
  while (outstanding_.size() > kMaxOutstanding) {
    outstanding_.erase(outstanding_.begin());
    ++predictions_dropped_;
  }
  return result;
}

absl::StatusOr<Session::BufferedChunk> Session::MakeTrainingChunk(const ExecutedChunk& executed,
                                                                  const Prediction& prediction) {
  BufferedChunk chunk;
  chunk.prefix = prediction.prefix;
  const std::pair<int, int> episode{executed.task, executed.episode};
  if (executed.chunk == 0 || arm_episode_ != episode) {
    arm_.Reset();
    arm_episode_ = episode;
  }
  if (!spec_.method.use_residual) {  // eta = 0: the raw prediction itself, without a round trip
                                     // through ToEnvironment
    chunk.target = prediction.raw;
    return chunk;
  }
  Eigen::MatrixXf base;
  if (prediction.base.rows() > 0) {
    base = prediction.base.middleRows(executed.first_step, executed.steps.size());
  }
  RS_ASSIGN_OR_RETURN(
      const Eigen::MatrixXd residual,
      ReferencedResidual(executed, spec_.method.target, residual_options_, base, &arm_));
  try {
    torch::NoGradGuard no_grad;
    chunk.target =
        TargetChunk(prediction.raw, executed.first_step,
                    resources_.policy->ToModel(PseudoTarget(executed, residual), prediction.state));
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("pseudo-target failed: ", error.what()));
  }
  return chunk;
}

absl::StatusOr<FeedbackResult> Session::Feedback(const ExecutedChunk& executed) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(
      ValidateExecutedChunk(executed, policy_spec().action_dim, residual_options_.space));
  RS_RETURN_IF_ERROR(CheckExecutedChunk(executed, policy_spec()));

  absl::MutexLock lock(&mu_);
  const auto has_room = [this] {
    mu_.AssertHeld();
    return cancelled_ || pending_updates_ < kMaxPendingUpdates;
  };
  mu_.Await(absl::Condition(&has_room));
  if (cancelled_) return absl::CancelledError("the session was closed");
  RS_RETURN_IF_ERROR(failure_);
  if (executed.sequence <= feedback_sequence_)
    return FeedbackResult{feedback_sequence_, updates_applied()};
  if (executed.sequence != feedback_sequence_ + 1) {
    return absl::FailedPreconditionError(absl::StrCat("feedback ", executed.sequence, " after ",
                                                      feedback_sequence_, "; send ",
                                                      feedback_sequence_ + 1, " first"));
  }
  const auto found = outstanding_.find(executed.prediction_id);
  if (found == outstanding_.end()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "feedback ", executed.sequence, " is about prediction ", executed.prediction_id,
        ", which this session does not hold; it made ", next_prediction_ - 1, ", keeps the last ",
        kMaxOutstanding, " and none that is older than one already reported"));
  }
  const Prediction& prediction = found->second;
  if (prediction.task != executed.task || prediction.episode != executed.episode ||
      prediction.chunk != executed.chunk) {
    return absl::FailedPreconditionError(absl::StrCat(
        "feedback ", executed.sequence, " says task ", executed.task, " episode ", executed.episode,
        " chunk ", executed.chunk, "; prediction ", executed.prediction_id, " was made for task ",
        prediction.task, " episode ", prediction.episode, " chunk ", prediction.chunk));
  }

  if (adapter_ != nullptr) {
    RS_ASSIGN_OR_RETURN(BufferedChunk chunk, MakeTrainingChunk(executed, prediction));
    buffer_.Add(std::move(chunk));
    if (schedule_.Add()) TriggerUpdate();
  }
  if (spec_.method.direct && episode_ == std::pair(executed.task, executed.episode)) {
    direct_correction_ = ChunkResidual(executed, residual_options_).colwise().mean().transpose();
  }
  feedback_sequence_ = executed.sequence;
  ++feedback_chunks_;
  // A later prediction was made after this one: what is older will not be executed any more.
  outstanding_.erase(outstanding_.begin(), found);
  if (boundaries_.erase(feedback_sequence_) > 0) ClearBuffer();
  return FeedbackResult{feedback_sequence_, updates_applied()};
}

void Session::TriggerUpdate() {
  const uint64_t index = triggers_++;
  const StreamKey key = key_.With("update").With(static_cast<int64_t>(index)).With("batch");
  std::vector<BufferedChunk> batch;
  for (const int i : SampleWithoutReplacement(key, buffer_.size(), spec_.method.batch))
    batch.push_back(buffer_[i]);
  ++pending_updates_;
  resources_.adaptation->Post(owner_, [self = shared_from_this(), index, batch = std::move(batch)] {
    self->RunUpdate(index, batch);
  });
}

absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> Session::WithPrefixes(
    const std::vector<BufferedChunk>& chunks) const {
  std::vector<std::shared_ptr<const TrainingChunk>> result;
  for (const BufferedChunk& chunk : chunks) {
    RS_ASSIGN_OR_RETURN(PolicyContext context, resources_.prefixes->Get(*chunk.prefix));
    result.push_back(
        std::make_shared<const TrainingChunk>(TrainingChunk{std::move(context), chunk.target}));
  }
  return result;
}

void Session::RunUpdate(uint64_t index, const std::vector<BufferedChunk>& batch) {
  {
    absl::MutexLock lock(&mu_);
    if (cancelled_ || !failure_.ok()) {
      --pending_updates_;
      return;
    }
  }
  const absl::StatusOr<UpdateReport> report = [&]() -> absl::StatusOr<UpdateReport> {
    RS_ASSIGN_OR_RETURN(const auto chunks, WithPrefixes(batch));
    return adapter_->Update(index, chunks);
  }();
  absl::MutexLock lock(&mu_);
  --pending_updates_;
  if (!report.ok()) {
    failure_ = report.status();
    spdlog::error("session {}: {}", SessionIdentity(spec_), report.status().ToString());
    return;
  }
  last_loss_ = report->loss;
  if (!report->applied) {
    ++updates_refused_;
    spdlog::warn("session {}: update {} refused, loss {} gradient norm {}", SessionIdentity(spec_),
                 index, report->loss, report->gradient_norm);
  }
}

absl::StatusOr<SessionCounters> Session::Counters() {
  absl::MutexLock lock(&mu_);
  if (spec_.mode == ExecutionMode::kLockstep) RS_RETURN_IF_ERROR(AwaitLearned(0));
  SessionCounters counters;
  counters.stats.feedback_chunks = feedback_chunks_;
  counters.stats.updates_applied = updates_applied();
  counters.stats.adapter_distance = adapter_ == nullptr ? 0 : adapter_->distance();
  counters.stats.last_loss = last_loss_;
  counters.buffered_chunks = buffer_.size();
  counters.predictions = predictions_;
  counters.updates_refused = updates_refused_;
  counters.predictions_dropped = predictions_dropped_;
  counters.prefixes = resources_.prefixes->counters();
  return counters;
}

absl::StatusOr<AdapterState> Session::Export() {
  absl::MutexLock lock(&mu_);
  if (adapter_ == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrCat("method ", spec_.method.method, " has no adapter to export"));
  }
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  AdaptationState state;
  state.policy = policy_spec().name;
  state.model_hash = policy_spec().model_hash;
  state.method = spec_.method.method;
  state.lora_kind = spec_.method.lora;
  state.session = SessionIdentity(spec_);
  state.lora = adapter_->Export();
  state.triggers = triggers_;
  state.feedback_sequence = feedback_sequence_;
  state.chunks_since_clear = schedule_.chunks();
  state.task = episode_ ? episode_->first : -1;
  state.nominal_task = arm_episode_.first;
  state.nominal_episode = arm_episode_.second;
  state.nominal = arm_.state();
  state.last_loss = last_loss_;
  std::vector<BufferedChunk> chunks;
  for (int i = 0; i < buffer_.size(); ++i) chunks.push_back(buffer_[i]);
  RS_ASSIGN_OR_RETURN(state.buffer, WithPrefixes(chunks));
  AdapterState result;
  RS_ASSIGN_OR_RETURN(result.safetensors,
                      SerializeAdaptationState(state, resources_.policy->lora_targets()));
  result.feedback_sequence = feedback_sequence_;
  result.updates_applied = state.lora.phi.version;
  return result;
}

absl::StatusOr<FeedbackResult> Session::Import(const std::string& safetensors) {
  if (adapter_ == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrCat("method ", spec_.method.method, " has no adapter to import into"));
  }
  RS_ASSIGN_OR_RETURN(AdaptationState state,
                      ParseAdaptationState("imported adapter", safetensors, *resources_.policy,
                                           policy_spec().model_hash));
  if (state.method != spec_.method.method || state.policy != policy_spec().name) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the adapter was learned by method ", state.method, " on policy ", state.policy,
        "; this session runs method ", spec_.method.method, " on policy ", policy_spec().name));
  }
  if (state.lora_kind != spec_.method.lora) {
    return absl::InvalidArgumentError(
        absl::StrCat("the adapter's parameters are ", LoraKindName(state.lora_kind),
                     "; this session's method has lora: ", LoraKindName(spec_.method.lora),
                     "; open the session with the adapter's kind"));
  }
  if (static_cast<int>(state.buffer.size()) > spec_.method.buffer_chunks) {
    return absl::InvalidArgumentError(
        absl::StrCat("the adapter's buffer holds ", state.buffer.size(),
                     " chunks; this session's buffer_chunks is ", spec_.method.buffer_chunks));
  }
  absl::MutexLock lock(&mu_);
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  RS_RETURN_IF_ERROR(adapter_->Import(state.lora));
  triggers_ = state.triggers;
  feedback_sequence_ = state.feedback_sequence;
  schedule_.set_chunks(state.chunks_since_clear);
  buffer_.Clear();
  for (const auto& chunk : state.buffer) {  // the file has no observations to rebuild from
    buffer_.Add(
        {resources_.prefixes->Add(resources_.policy, nullptr, chunk->context), chunk->target});
  }
  boundaries_.clear();
  outstanding_.clear();
  episode_.reset();
  if (state.task >= 0)
    episode_ = {static_cast<int>(state.task), -1};  // StartEpisode decides whether it is a boundary
  arm_.set_state(state.nominal);
  arm_episode_ = {static_cast<int>(state.nominal_task), static_cast<int>(state.nominal_episode)};
  last_loss_ = state.last_loss;
  direct_correction_.resize(0);
  return FeedbackResult{feedback_sequence_, updates_applied()};
}

absl::Status Session::Rollback(uint64_t version) {
  absl::MutexLock lock(&mu_);
  if (adapter_ == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrCat("method ", spec_.method.method, " has no adapter to roll back"));
  }
  RS_RETURN_IF_ERROR(AwaitLearned(0));
  RS_RETURN_IF_ERROR(adapter_->Rollback(version));
  ClearBuffer();
  return absl::OkStatus();
}

}  // namespace robostress
