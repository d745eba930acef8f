#include "common/rpc/policy_client.h"

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "absl/functional/function_ref.h"
#include "absl/strings/str_cat.h"
#include "common/rollout/chunk_ledger.h"
#include "common/rollout/refusal.h"
#include "common/rollout/spec_checks.h"
#include "common/rpc/channel_credentials.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/deadline_stream.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/policy.grpc.pb.h"

namespace robostress {
namespace {

using Clock = std::chrono::system_clock;

Clock::time_point After(double seconds) {
  return Clock::now() + std::chrono::microseconds(static_cast<int64_t>(seconds * 1e6));
}

absl::StatusOr<std::shared_ptr<grpc::Channel>> OpenChannel(const PolicyClientOptions& options) {
  const size_t colon = options.address.rfind(':');
  if (colon == std::string::npos || colon == 0 || colon + 1 == options.address.size()) {
    return absl::InvalidArgumentError(absl::StrCat("server address '", options.address,
                                                   "' must be HOST:PORT, e.g. 127.0.0.1:50051"));
  }
  RS_ASSIGN_OR_RETURN(const auto credentials, ChannelCredentialsFromEnvironment());
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kLargestMessageBytes);
  arguments.SetMaxSendMessageSize(kLargestMessageBytes);
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY,
                   0);  // a proxy for the web must not swallow a policy server
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 500);
  std::shared_ptr<grpc::Channel> channel =
      grpc::CreateCustomChannel(options.address, credentials, arguments);
  if (!channel->WaitForConnected(After(options.connect_timeout_s))) {
    return absl::UnavailableError(absl::StrCat(
        "no policy server answers at ", options.address, " within ", options.connect_timeout_s,
        " s; start one with `robostress serve --policy nano --listen ", options.address,
        "` or correct --server"));
  }
  return channel;
}

// The connection or the server's memory of the session is gone; resuming may help.
bool SessionLost(const absl::Status& status) {
  return absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status) ||
         absl::IsCancelled(status) || absl::IsNotFound(status);
}

}  // namespace

struct GrpcPolicyClient::Impl {
  using PredictStream = DeadlineStream<v1::PredictRequest, v1::PredictResponse>;
  using FeedbackStream = DeadlineStream<v1::FeedbackRequest, v1::FeedbackAck>;

  PolicyClientOptions options;
  ExecutionMode mode = ExecutionMode::kLockstep;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::PolicyService::Stub> stub;
  SessionTicket ticket;
  bool left = false;
  PolicySpec spec;
  EpisodeKey episode;
  bool episode_started = false;
  ChunkLedger ledger;
  std::unique_ptr<PredictStream> predict;
  std::unique_ptr<FeedbackStream> feedback;
  bool lost = false;           // the session is to be resumed
  bool feedback_open = false;  // what is kept is on the feedback stream
  uint64_t resumes = 0;

  template <class Request, class Response>
  absl::Status Unary(grpc::Status (v1::PolicyService::Stub::*method)(grpc::ClientContext*,
                                                                     const Request&, Response*),
                     const Request& request, Response& response, double timeout_s) {
    grpc::ClientContext context;
    context.set_deadline(After(timeout_s));
    const grpc::Status status = (stub.get()->*method)(&context, request, &response);
    if (status.error_code() == grpc::StatusCode::UNAVAILABLE) {
      return absl::UnavailableError(absl::StrCat(
          "the policy server at ", options.address, " does not answer (", status.error_message(),
          "); start it with `robostress serve` and repeat the command"));
    }
    if (status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED) {
      return absl::DeadlineExceededError(absl::StrCat("the policy server at ", options.address,
                                                      " did not answer within ", timeout_s,
                                                      " s; it may hang or be overloaded"));
    }
    const auto& trailing = context.GetServerTrailingMetadata();
    if (const auto found = trailing.find(kRefusalMetadata); found != trailing.end()) {
      v1::Refusal refusal;
      if (refusal.ParseFromArray(found->second.data(), static_cast<int>(found->second.size())))
        return ToStatus(refusal);
    }
    return FromGrpc(status);
  }

  void SetReconnect(bool durable) {
    if (options.reconnect_timeout_s < 0) options.reconnect_timeout_s = durable ? 30 : 0;
  }

  // Runs `call`; where the session is lost it is resumed and `call` runs again, as long as the
  // options say.
  absl::Status WithSession(absl::FunctionRef<absl::Status()> call) {
    const Clock::time_point deadline = After(options.reconnect_timeout_s);
    double backoff_s = 0.05;
    while (true) {
      absl::Status status = lost ? Resume() : absl::OkStatus();
      const bool resumed = status.ok();
      if (resumed) status = call();
      if (!SessionLost(status)) return status;
      predict.reset();
      feedback.reset();
      feedback_open = false;
      const bool first = !std::exchange(lost, true);
      if (absl::IsNotFound(status)) {
        if (first) continue;  // read from disk once it is resumed
        return status;
      }
      if (After(backoff_s) > deadline) return status;
      std::this_thread::sleep_for(std::chrono::duration<double>(backoff_s));
      backoff_s = std::min(2 * backoff_s, 0.5);
    }
  }

  absl::Status Resume() {
    // A connection is made only while somebody waits for it.
    if (!channel->WaitForConnected(After(std::min(options.call_timeout_s, 0.5)))) {
      return absl::UnavailableError(
          absl::StrCat("the policy server at ", options.address,
                       " is lost; start it again with `robostress serve` and repeat the command"));
    }
    v1::ResumeSessionRequest request;
    request.set_session_id(ticket.session_id);
    request.set_resume_token(ticket.token);
    v1::ResumeSessionResponse response;
    const absl::Status status =
        Unary(&v1::PolicyService::Stub::ResumeSession, request, response, options.call_timeout_s);
    // A server from before sessions could be resumed keeps them over the end of a stream.
    if (absl::IsUnimplemented(status)) {
      lost = false;
      return absl::OkStatus();
    }
    RS_RETURN_IF_ERROR(status);
    RS_RETURN_IF_ERROR(ledger.Acknowledge(response.feedback_sequence()));
    ++resumes;
    lost = false;
    if (!episode_started ||
        (response.episode_started() && static_cast<int>(response.task()) == episode.task &&
         static_cast<int>(response.episode()) == episode.episode))
      return absl::OkStatus();
    return AnnounceEpisode();
  }

  // The order of events is that of before the loss: feedback first.
  absl::Status AnnounceEpisode() {
    RS_RETURN_IF_ERROR(SendKept());
    v1::StartEpisodeRequest request;
    request.set_session_id(ticket.session_id);
    request.set_task(static_cast<uint32_t>(episode.task));
    request.set_episode(static_cast<uint32_t>(episode.episode));
    request.set_last_feedback_sequence(ledger.sent());
    v1::StartEpisodeResponse response;
    return Unary(&v1::PolicyService::Stub::StartEpisode, request, response, options.call_timeout_s);
  }

  absl::Status AwaitAcknowledgements(uint64_t allowed) {
    while (ledger.kept().size() > allowed ||
           (feedback != nullptr && !ledger.kept().empty() && feedback->Poll())) {
      v1::FeedbackAck ack;
      RS_RETURN_IF_ERROR(feedback->Read(ack, After(options.call_timeout_s)));
      RS_RETURN_IF_ERROR(ledger.Acknowledge(ack.sequence()));
    }
    return absl::OkStatus();
  }

  absl::Status Write(const ExecutedChunk& chunk) {
    if (feedback == nullptr) {
      feedback = std::make_unique<FeedbackStream>(
          "Feedback", options.address,
          [&](grpc::ClientContext* context, grpc::CompletionQueue* queue) {
            return stub->PrepareAsyncFeedback(context, queue);
          });
    }
    v1::FeedbackRequest request;
    request.set_session_id(ticket.session_id);
    *request.mutable_chunk() = ToProto(chunk);
    return feedback->Write(request, After(options.call_timeout_s));
  }

  // Everything that is kept and not on the stream, from the oldest on, as far as it is allowed to
  // be without an acknowledgement. Lockstep: a refused chunk must be known before the next
  // prediction waits for it.
  absl::Status SendKept() {
    if (!feedback_open) {
      feedback.reset();
      for (const ExecutedChunk& chunk : ledger.kept()) RS_RETURN_IF_ERROR(Write(chunk));
      feedback_open = true;
    }
    return AwaitAcknowledgements(
        mode == ExecutionMode::kAsync ? static_cast<uint64_t>(options.max_unacknowledged) : 0);
  }

  // After `send` failed: what is to be kept of it.
  absl::Status Settle(const absl::Status& status) {
    if (status.ok() || SessionLost(status)) return status;
    feedback_open = false;
    if (absl::IsInvalidArgument(status) || absl::IsFailedPrecondition(status)) ledger.DropOldest();
    return status;
  }

  // Every chunk sent so far is in.
  absl::Status AwaitAll() {
    return Settle(WithSession([&]() -> absl::Status {
      RS_RETURN_IF_ERROR(SendKept());
      return AwaitAcknowledgements(0);
    }));
  }
};

absl::StatusOr<ServerInfo> GetServerInfo(const PolicyClientOptions& options) {
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::Channel> channel, OpenChannel(options));
  const auto stub = v1::PolicyService::NewStub(channel);
  grpc::ClientContext context;
  context.set_deadline(After(options.call_timeout_s));
  v1::GetServerInfoResponse response;
  RS_RETURN_IF_ERROR(FromGrpc(stub->GetServerInfo(&context, {}, &response)));
  return FromProto(response);
}

GrpcPolicyClient::GrpcPolicyClient(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

absl::StatusOr<std::unique_ptr<GrpcPolicyClient>> GrpcPolicyClient::Connect(
    const PolicyClientOptions& options, const RequestedSession& session) {
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::Channel> channel, OpenChannel(options));
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  impl->mode = session.mode;
  impl->channel = channel;
  impl->stub = v1::PolicyService::NewStub(channel);
  v1::OpenSessionRequest request;
  *request.mutable_spec() = ToProto(session);
  request.set_priority(ToProto(options.scheduling.priority));
  request.set_deadline_ms(static_cast<uint32_t>(options.scheduling.deadline_ms));
  v1::OpenSessionResponse response;
  RS_RETURN_IF_ERROR(impl->Unary(&v1::PolicyService::Stub::OpenSession, request, response,
                                 options.call_timeout_s));
  impl->ticket = {response.session_id(), response.resume_token()};
  impl->SetReconnect(response.durable());
  auto client =
      std::unique_ptr<GrpcPolicyClient>(new GrpcPolicyClient(std::move(impl)));  // closes on error
  RS_ASSIGN_OR_RETURN(client->impl_->spec, FromProto(response.policy()));
  return client;
}

absl::StatusOr<std::unique_ptr<GrpcPolicyClient>> GrpcPolicyClient::Resume(
    const PolicyClientOptions& options, const SessionTicket& ticket, ExecutionMode mode) {
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::Channel> channel, OpenChannel(options));
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  impl->mode = mode;
  impl->channel = channel;
  impl->stub = v1::PolicyService::NewStub(channel);
  impl->ticket = ticket;
  v1::ResumeSessionRequest request;
  request.set_session_id(ticket.session_id);
  request.set_resume_token(ticket.token);
  v1::ResumeSessionResponse response;
  RS_RETURN_IF_ERROR(impl->Unary(&v1::PolicyService::Stub::ResumeSession, request, response,
                                 options.call_timeout_s));
  RS_ASSIGN_OR_RETURN(impl->spec, FromProto(response.policy()));
  impl->ledger.Restart(response.feedback_sequence());
  impl->SetReconnect(response.durable());
  return std::unique_ptr<GrpcPolicyClient>(new GrpcPolicyClient(std::move(impl)));
}

GrpcPolicyClient::~GrpcPolicyClient() {
  impl_->predict.reset();
  impl_->feedback.reset();
  if (impl_->left) return;
  v1::CloseSessionRequest request;
  request.set_session_id(impl_->ticket.session_id);
  v1::CloseSessionResponse response;
  // Best effort: a server that is gone has closed it, or lets it expire.
  impl_->Unary(&v1::PolicyService::Stub::CloseSession, request, response, 5).IgnoreError();
}

const PolicySpec& GrpcPolicyClient::spec() const { return impl_->spec; }
uint64_t GrpcPolicyClient::last_feedback_sequence() const { return impl_->ledger.sent(); }
uint64_t GrpcPolicyClient::acknowledged_feedback_sequence() const {
  return impl_->ledger.acknowledged();
}
const std::string& GrpcPolicyClient::session_id() const { return impl_->ticket.session_id; }
uint64_t GrpcPolicyClient::resumes() const { return impl_->resumes; }

SessionTicket GrpcPolicyClient::Leave() {
  impl_->left = true;
  return impl_->ticket;
}

absl::Status GrpcPolicyClient::StartEpisode(const EpisodeKey& key) {
  const EpisodeKey before = std::exchange(impl_->episode, key);
  const bool started = std::exchange(impl_->episode_started, false);
  const absl::Status status = impl_->WithSession([&] { return impl_->AnnounceEpisode(); });
  if (!status.ok()) {
    impl_->episode = before;
    impl_->episode_started = started;
    return status;
  }
  impl_->episode_started = true;
  return absl::OkStatus();
}

absl::StatusOr<PredictedChunk> GrpcPolicyClient::Predict(const Observation& observation,
                                                         int chunk) {
  return AskFor(observation, chunk, nullptr);
}

absl::StatusOr<PredictedChunk> GrpcPolicyClient::PredictAfter(const Observation& observation,
                                                              int chunk,
                                                              const RunningRows& running) {
  RS_RETURN_IF_ERROR(CheckRunningRows(running, impl_->spec));
  return AskFor(observation, chunk, &running);
}

absl::StatusOr<PredictedChunk> GrpcPolicyClient::AskFor(const Observation& observation, int chunk,
                                                        const RunningRows* running) {
  if (!impl_->episode_started) return absl::FailedPreconditionError("Predict before StartEpisode");
  RS_RETURN_IF_ERROR(CheckObservation(observation, impl_->spec));
  v1::PredictRequest request;
  request.set_session_id(impl_->ticket.session_id);
  request.set_task(static_cast<uint32_t>(impl_->episode.task));
  request.set_episode(static_cast<uint32_t>(impl_->episode.episode));
  request.set_chunk(static_cast<uint32_t>(chunk));
  *request.mutable_observation() = ToProto(observation);
  if (running != nullptr) *request.mutable_running() = ToProto(*running);
  v1::PredictResponse response;
  absl::Status refused;  // the session is well
  const absl::Status status = impl_->WithSession([&]() -> absl::Status {
    // In async a prediction does not depend on feedback, nor on a disk that is full for it.
    if (impl_->mode == ExecutionMode::kLockstep && !impl_->ledger.kept().empty())
      RS_RETURN_IF_ERROR(impl_->SendKept());
    request.set_last_feedback_sequence(impl_->ledger.sent());
    if (impl_->predict == nullptr) {
      impl_->predict = std::make_unique<Impl::PredictStream>(
          "Predict", impl_->options.address,
          [&](grpc::ClientContext* context, grpc::CompletionQueue* queue) {
            return impl_->stub->PrepareAsyncPredict(context, queue);
          });
    }
    const Clock::time_point deadline = After(impl_->options.call_timeout_s);
    while (true) {
      absl::Status sent = impl_->predict->Write(request, deadline);
      if (sent.ok()) sent = impl_->predict->Read(response, deadline);
      if (!sent.ok()) impl_->predict.reset();  // the session outlives a stream
      if (!sent.ok() || !response.has_refusal()) return sent;
      const absl::Status refusal = ToStatus(response.refusal());
      const Clock::time_point again = After(absl::ToDoubleSeconds(RetryAfter(refusal)));
      // A simulation has time: it comes back when the server says. A robot decides itself.
      if (impl_->mode == ExecutionMode::kLockstep && absl::IsResourceExhausted(refusal) &&
          RetryAfter(refusal) > absl::ZeroDuration() && again <= deadline) {
        std::this_thread::sleep_until(again);
        continue;
      }
      // Other errors, on a stream that is read ahead, are those of the session.
      if (!absl::IsResourceExhausted(refusal) && !absl::IsDeadlineExceeded(refusal) &&
          !absl::IsAborted(refusal)) {
        return refusal;
      }
      refused = refusal;
      return absl::OkStatus();
    }
  });
  RS_RETURN_IF_ERROR(status);
  RS_RETURN_IF_ERROR(refused);
  if (response.chunk() != request.chunk()) {
    return absl::InternalError(
        absl::StrCat("the server answered chunk ", response.chunk(), ", asked for chunk ", chunk));
  }
  RS_ASSIGN_OR_RETURN(PredictedChunk prediction, FromProto(response));
  RS_RETURN_IF_ERROR(CheckPrediction(prediction, impl_->spec));
  return prediction;
}

absl::Status GrpcPolicyClient::SendFeedback(ExecutedChunk executed) {
  RS_RETURN_IF_ERROR(CheckExecutedChunk(executed, impl_->spec));
  RS_RETURN_IF_ERROR(impl_->ledger.Add(std::move(executed)));
  bool written = false;
  return impl_->Settle(impl_->WithSession([&]() -> absl::Status {
    if (impl_->feedback_open && !std::exchange(written, true))
      RS_RETURN_IF_ERROR(impl_->Write(impl_->ledger.kept().back()));
    return impl_->SendKept();
  }));
}

absl::StatusOr<SessionStats> GrpcPolicyClient::Stats() {
  RS_RETURN_IF_ERROR(impl_->AwaitAll());
  v1::GetStatsRequest request;
  request.set_session_id(impl_->ticket.session_id);
  v1::GetStatsResponse response;
  RS_RETURN_IF_ERROR(impl_->WithSession([&] {
    return impl_->Unary(&v1::PolicyService::Stub::GetStats, request, response,
                        impl_->options.call_timeout_s);
  }));
  return FromProto(response);
}

absl::StatusOr<AdapterState> GrpcPolicyClient::ExportAdapter() {
  RS_RETURN_IF_ERROR(impl_->AwaitAll());
  v1::ExportAdapterRequest request;
  request.set_session_id(impl_->ticket.session_id);
  v1::ExportAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->WithSession([&] {
    return impl_->Unary(&v1::PolicyService::Stub::ExportAdapter, request, response,
                        impl_->options.call_timeout_s);
  }));
  if (response.feedback_sequence() != impl_->ledger.sent()) {
    return absl::InternalError(absl::StrCat("the exported adapter includes feedback up to ",
                                            response.feedback_sequence(), ", ",
                                            impl_->ledger.sent(), " chunks were acknowledged"));
  }
  return AdapterState{std::move(*response.mutable_safetensors()), response.feedback_sequence(),
                      response.updates_applied()};
}

absl::StatusOr<uint64_t> GrpcPolicyClient::ImportAdapter(const std::string& safetensors) {
  RS_RETURN_IF_ERROR(impl_->AwaitAll());
  v1::ImportAdapterRequest request;
  request.set_session_id(impl_->ticket.session_id);
  request.set_safetensors(safetensors);
  v1::ImportAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->WithSession([&] {
    return impl_->Unary(&v1::PolicyService::Stub::ImportAdapter, request, response,
                        impl_->options.call_timeout_s);
  }));
  impl_->feedback.reset();
  impl_->feedback_open = false;
  impl_->ledger.Restart(response.feedback_sequence());
  impl_->episode_started = false;
  return impl_->ledger.sent();
}

absl::StatusOr<uint64_t> GrpcPolicyClient::RollbackAdapter(uint64_t version) {
  RS_RETURN_IF_ERROR(impl_->AwaitAll());
  v1::RollbackAdapterRequest request;
  request.set_session_id(impl_->ticket.session_id);
  request.set_version(version);
  v1::RollbackAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::RollbackAdapter, request, response,
                                  impl_->options.call_timeout_s));
  return response.updates_applied();
}

}  // namespace robostress
