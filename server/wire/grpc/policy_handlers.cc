#include "server/wire/grpc/policy_handlers.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "adapter/lora.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/refusal.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "common/version.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/read_spec.h"

namespace robostress {
namespace {

// What an adapter of the widest kind that may be opened needs as a file [bytes]: phi, phi_0 and two
// moments, and a full buffer with its prefixes.
size_t LargestAdapterBytes(const FlowPolicy& policy, const MethodCaps& caps) {
  const auto parameters = static_cast<size_t>(
      std::max(NumLoraParameters(policy.lora_targets(), LoraKind::kPerHead, caps.max_rank),
               NumLoraParameters(policy.lora_targets(), LoraKind::kPerMatrix, caps.max_rank)));
  const ContextShape context = policy.context_shape();
  const auto prefix = static_cast<size_t>(context.max_prefix);
  const size_t chunk =
      2 * static_cast<size_t>(context.layers * context.kv_heads * context.head_dim) * prefix *
          c10::elementSize(context.kv_type) +
      prefix + 4 * static_cast<size_t>(context.state_dim) +
      4 * static_cast<size_t>(policy.horizon() * policy.model_action_dim());
  const size_t tensors =
      8 * policy.lora_targets().size() +
      static_cast<size_t>(caps.max_buffer_chunks) * static_cast<size_t>(2 * context.layers + 3);
  const size_t names = 256 * tensors + (size_t{64} << 10);  // the file's own header
  const size_t bytes = 4 * 4 * parameters + static_cast<size_t>(caps.max_buffer_chunks) * chunk;
  return std::min(bytes + names, size_t{kLargestMessageBytes});
}

absl::Status CheckIndex(const char* field, uint32_t value) {
  if (value <= static_cast<uint32_t>(WireLimits::kIndex)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, ", must be at most ", WireLimits::kIndex));
}

}  // namespace

PolicyHandlers::PolicyHandlers(const Options& options, const ServedPolicies* policies,
                               SessionRegistry* sessions, RegistryHost* host, FairExecutor* calls,
                               FairExecutor* feedback_calls)
    : options_(options),
      instance_(absl::StrCat(absl::Hex(absl::ToUnixNanos(absl::Now())))),
      policies_(policies),
      sessions_(sessions),
      host_(host),
      calls_(calls),
      feedback_calls_(feedback_calls) {}

size_t PolicyHandlers::LargestRequest(const std::string& method) const {
  size_t most = size_t{256} << 10;  // a session's spec
  for (const PolicySpec& spec : host_->policies()) {
    const int side = std::max({spec.max_view_side, spec.image_width, spec.image_height});
    if (method == "Predict") most = std::max(most, LargestObservationBytes(spec, side, 1));
    if (method == "Feedback") most = std::max(most, LargestExecutedBytes(spec));
    if (method == "ImportAdapter")
      most = std::max(most, LargestAdapterBytes(*policies_->at(spec.name), options_.caps));
  }
  return most;
}

template <class Request, class Response>
GrpcMethod PolicyHandlers::Unary(const char* name, Handler<Request, Response> handler) {
  GrpcMethod method;
  method.name = name;
  method.largest_request = LargestRequest(name);
  method.executor = calls_;
  method.answer = TypedAnswer<Request, Response>(
      [this, handler](GrpcCallView& call, const Request& request, Response& response) {
        return (this->*handler)(call, request, response);
      });
  return method;
}

GrpcMethod PolicyHandlers::PredictStream() {
  GrpcMethod predict = Unary("Predict", &PolicyHandlers::Predict);
  predict.streams = true;
  predict.reads_ahead = [this](const std::string& id) { return sessions_->IsAsync(id); };
  // A refusal is an answer, and the stream goes on; of a stream that is read ahead every error is.
  predict.as_answer = [](const google::protobuf::Message& request, const absl::Status& status,
                         bool read_ahead, google::protobuf::Message& response) {
    if (!read_ahead && !IsRefusal(status)) return false;
    auto& refused = static_cast<v1::PredictResponse&>(response);
    refused.set_chunk(static_cast<const v1::PredictRequest&>(request).chunk());
    *refused.mutable_refusal() = ToRefusal(status);
    return true;
  };
  return predict;
}

std::vector<GrpcMethod> PolicyHandlers::Methods() {
  GrpcMethod feedback = Unary("Feedback", &PolicyHandlers::Feedback);
  feedback.streams = true;
  feedback.executor = feedback_calls_;
  GrpcMethod import = Unary("ImportAdapter", &PolicyHandlers::ImportAdapter);
  import.at_once = 2;  // the largest messages there are
  return {Unary("GetServerInfo", &PolicyHandlers::GetServerInfo),
          Unary("OpenSession", &PolicyHandlers::OpenSession),
          Unary("ResumeSession", &PolicyHandlers::ResumeSession),
          Unary("CloseSession", &PolicyHandlers::CloseSession),
          Unary("StartEpisode", &PolicyHandlers::StartEpisode),
          PredictStream(),
          std::move(feedback),
          Unary("GetStats", &PolicyHandlers::GetStats),
          Unary("ExportAdapter", &PolicyHandlers::ExportAdapter),
          std::move(import),
          Unary("RollbackAdapter", &PolicyHandlers::RollbackAdapter)};
}

// --------------------------------------------------------------------------------------- sessions

absl::Status PolicyHandlers::GetServerInfo(GrpcCallView&, const v1::GetServerInfoRequest&,
                                           v1::GetServerInfoResponse& response) {
  ServerInfo info;
  info.version = BuildVersion();
  info.policies = host_->policies();
  info.max_sessions = options_.max_sessions;
  info.inference_threads = options_.threads;
  info.open_sessions = sessions_->open_sessions();
  info.durable = sessions_->durable();
  info.instance = instance_;
  info.draining = sessions_->draining();
  response = ToProto(info);
  return absl::OkStatus();
}

uint64_t PolicyHandlers::ExpiresAfter() const {
  if (options_.expire_after == absl::InfiniteDuration()) return 0;
  return static_cast<uint64_t>(std::max(int64_t{1}, absl::ToInt64Seconds(options_.expire_after)));
}

absl::StatusOr<SessionHost::Opened> PolicyHandlers::Open(const Caller& caller,
                                                         const v1::OpenSessionRequest& request) {
  RS_ASSIGN_OR_RETURN(const RequestedSession asked, FromProto(request.spec()));
  RS_ASSIGN_OR_RETURN(const SessionSpec spec, ReadSpec(asked));
  std::optional<GuardOptions> guard;
  if (request.has_guard()) {
    RS_ASSIGN_OR_RETURN(guard, FromRecord(request.guard()));
  }
  SessionScheduling scheduling;
  RS_ASSIGN_OR_RETURN(scheduling.priority, FromProto(request.priority()));
  RS_RETURN_IF_ERROR(CheckIndex("deadline_ms", request.deadline_ms()));
  scheduling.deadline_ms = static_cast<int>(request.deadline_ms());
  return host_->Open(caller, spec, scheduling, guard ? &*guard : nullptr);
}

absl::Status PolicyHandlers::OpenSession(GrpcCallView& call, const v1::OpenSessionRequest& request,
                                         v1::OpenSessionResponse& response) {
  const absl::StatusOr<SessionHost::Opened> opened = Open(call.caller(), request);
  if (IsRefusal(opened.status())) {
    call.AddTrailingMetadata(kRefusalMetadata, ToRefusal(opened.status()).SerializeAsString());
  }
  RS_RETURN_IF_ERROR(opened.status());
  response.set_session_id(opened->id);
  response.set_resume_token(opened->resume_token);
  response.set_durable(opened->durable);
  response.set_expires_after_s(ExpiresAfter());
  *response.mutable_policy() = ToProto(opened->policy);
  return absl::OkStatus();
}

absl::Status PolicyHandlers::ResumeSession(GrpcCallView& call,
                                           const v1::ResumeSessionRequest& request,
                                           v1::ResumeSessionResponse& response) {
  RS_ASSIGN_OR_RETURN(const SessionHost::Opened resumed,
                      host_->Resume(call.caller(), request.session_id(), request.resume_token()));
  *response.mutable_policy() = ToProto(resumed.policy);
  response.set_durable(resumed.durable);
  response.set_feedback_sequence(resumed.at.feedback_sequence);
  response.set_last_prediction_id(resumed.at.last_prediction_id);
  response.set_updates_applied(resumed.at.updates_applied);
  response.set_episode_started(resumed.at.episode && resumed.at.episode->episode >= 0);
  if (response.episode_started()) {
    response.set_task(static_cast<uint32_t>(resumed.at.episode->task));
    response.set_episode(static_cast<uint32_t>(resumed.at.episode->episode));
  }
  response.set_expires_after_s(ExpiresAfter());
  return absl::OkStatus();
}

absl::Status PolicyHandlers::CloseSession(GrpcCallView& call,
                                          const v1::CloseSessionRequest& request,
                                          v1::CloseSessionResponse&) {
  return host_->Close(call.caller(), request.session_id());
}

// --------------------------------------------------------------------------------------- messages

absl::Status PolicyHandlers::StartEpisode(GrpcCallView& call,
                                          const v1::StartEpisodeRequest& request,
                                          v1::StartEpisodeResponse&) {
  RS_ASSIGN_OR_RETURN(const auto session, host_->Use(call.caller(), request.session_id()));
  RS_RETURN_IF_ERROR(CheckIndex("task", request.task()));
  RS_RETURN_IF_ERROR(CheckIndex("episode", request.episode()));
  return session->StartEpisode(
      {static_cast<int>(request.task()), static_cast<int>(request.episode())},
      request.last_feedback_sequence());
}

absl::Status PolicyHandlers::Predict(GrpcCallView& call, const v1::PredictRequest& request,
                                     v1::PredictResponse& response) {
  const auto received = std::chrono::steady_clock::now();
  // Before what it says.
  RS_ASSIGN_OR_RETURN(const auto session, host_->Use(call.caller(), request.session_id()));
  call.Serves(request.session_id());
  for (const auto& [field, index] : {std::pair("task", request.task()),
                                     {"episode", request.episode()},
                                     {"chunk", request.chunk()},
                                     {"deadline_ms", request.deadline_ms()}})
    RS_RETURN_IF_ERROR(CheckIndex(field, index));
  RS_ASSIGN_OR_RETURN(Observation observation, FromProto(request.observation()));
  PredictOptions options;
  RS_ASSIGN_OR_RETURN(options.priority, FromProto(request.priority()));
  if (request.deadline_ms() > 0) options.deadline = absl::Milliseconds(request.deadline_ms());
  options.cancelled = [&call] { return call.cancelled(); };
  if (request.has_running()) {
    RS_ASSIGN_OR_RETURN(options.running, FromProto(request.running()));
  }
  const ChunkKey key{{static_cast<int>(request.task()), static_cast<int>(request.episode())},
                     static_cast<int>(request.chunk())};
  RS_ASSIGN_OR_RETURN(
      const PredictedChunk prediction,
      session->Predict(std::make_shared<const Observation>(std::move(observation)), key,
                       request.last_feedback_sequence(), std::move(options), received));
  response = ToProto(prediction, key.chunk);
  return absl::OkStatus();
}

absl::Status PolicyHandlers::Feedback(GrpcCallView& call, const v1::FeedbackRequest& request,
                                      v1::FeedbackAck& ack) {
  RS_ASSIGN_OR_RETURN(const auto session, host_->Use(call.caller(), request.session_id()));
  call.Serves(request.session_id());
  RS_ASSIGN_OR_RETURN(const ExecutedChunk chunk, FromProto(request.chunk()));
  RS_ASSIGN_OR_RETURN(const FeedbackResult taken, session->Feedback(chunk));
  ack.set_sequence(taken.sequence);
  ack.set_updates_applied(taken.updates_applied);
  ack.set_durable(taken.durable);
  ack.set_duplicate(taken.duplicate);
  return absl::OkStatus();
}

// ---------------------------------------------------------------------------------------- adapters

absl::Status PolicyHandlers::GetStats(GrpcCallView& call, const v1::GetStatsRequest& request,
                                      v1::GetStatsResponse& response) {
  RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
  RS_ASSIGN_OR_RETURN(const SessionCounters counters, session->Counters());
  response = ToProto(counters.stats);
  response.set_buffered_chunks(static_cast<uint32_t>(counters.buffered_chunks));
  response.set_predictions(counters.predictions);
  response.set_prefix_bytes(static_cast<uint64_t>(counters.prefixes.bytes));
  response.set_prefix_evictions(counters.prefixes.evictions);
  response.set_prefix_rebuilds(counters.prefixes.rebuilds);
  response.set_duplicates(counters.duplicates);
  response.set_updates_refused(counters.updates_refused);
  response.set_updates_guarded(counters.updates_guarded);
  response.set_predictions_dropped(counters.predictions_dropped);
  response.set_resumes(counters.resumes);
  response.set_rollbacks(counters.rollbacks);
  response.set_steps_masked(counters.steps_masked);
  response.set_steps_impossible(counters.steps_impossible);
  response.set_journal_bytes(counters.journal_bytes);
  response.set_durable(session->durable());
  return absl::OkStatus();
}

absl::Status PolicyHandlers::ExportAdapter(GrpcCallView& call,
                                           const v1::ExportAdapterRequest& request,
                                           v1::ExportAdapterResponse& response) {
  RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
  RS_ASSIGN_OR_RETURN(AdapterState state, session->Export());
  const size_t mib = (state.safetensors.size() >> 20) + 1;
  if (mib > static_cast<size_t>(options_.max_message_mib)) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the adapter with its buffer has ", mib, " MiB, and this server sends at most ",
        options_.max_message_mib, "; start it with --max-message-mib ", mib,
        " (at most 1024), or open the session with a smaller buffer_chunks"));
  }
  response.set_safetensors(std::move(state.safetensors));
  response.set_feedback_sequence(state.feedback_sequence);
  response.set_updates_applied(state.updates_applied);
  return absl::OkStatus();
}

absl::Status PolicyHandlers::ImportAdapter(GrpcCallView& call,
                                           const v1::ImportAdapterRequest& request,
                                           v1::ImportAdapterResponse& response) {
  RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
  RS_ASSIGN_OR_RETURN(const FeedbackResult result, session->Import(request.safetensors()));
  response.set_feedback_sequence(result.sequence);
  response.set_updates_applied(result.updates_applied);
  return absl::OkStatus();
}

absl::Status PolicyHandlers::RollbackAdapter(GrpcCallView& call,
                                             const v1::RollbackAdapterRequest& request,
                                             v1::RollbackAdapterResponse& response) {
  RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
  RS_RETURN_IF_ERROR(session->Rollback(request.version()));
  response.set_updates_applied(request.version());
  return absl::OkStatus();
}

}  // namespace robostress
