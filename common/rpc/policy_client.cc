#include "common/rpc/policy_client.h"

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <deque>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/rpc/convert.h"
#include "common/rpc/deadline_stream.h"
#include "common/rpc/grpc_status.h"
#include "common/rpc/refusal.h"
#include "common/rpc/spec_checks.h"
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
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetMaxSendMessageSize(kMaxMessageBytes);
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY,
                   0);  // a proxy for the web must not swallow a policy server
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 500);
  std::shared_ptr<grpc::Channel> channel =
      grpc::CreateCustomChannel(options.address, grpc::InsecureChannelCredentials(), arguments);
  if (!channel->WaitForConnected(After(options.connect_timeout_s))) {
    return absl::UnavailableError(absl::StrCat(
        "no policy server answers at ", options.address, " within ", options.connect_timeout_s,
        " s; start one with `robostress serve --policy nano --listen ", options.address,
        "` or correct --server"));
  }
  return channel;
}

}  // namespace

struct GrpcPolicyClient::Impl {
  using PredictStream = DeadlineStream<v1::PredictRequest, v1::PredictResponse>;
  using FeedbackStream = DeadlineStream<v1::FeedbackRequest, v1::FeedbackAck>;

  PolicyClientOptions options;
  ExecutionMode mode = ExecutionMode::kLockstep;
  std::unique_ptr<v1::PolicyService::Stub> stub;
  std::string session_id;
  PolicySpec spec;
  EpisodeKey episode;
  bool episode_started = false;
  uint64_t sent = 0, acknowledged = 0;  // feedback sequence numbers
  std::unique_ptr<PredictStream> predict;
  std::unique_ptr<FeedbackStream> feedback;
  std::deque<v1::FeedbackRequest> unacknowledged;  // async: in the order of their sequence numbers

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
    return FromGrpc(status);
  }

  absl::Status AwaitAcknowledgements(uint64_t allowed) {
    while (sent - acknowledged > allowed ||
           (feedback != nullptr && acknowledged < sent && feedback->Poll())) {
      v1::FeedbackAck ack;
      RS_RETURN_IF_ERROR(feedback->Read(ack, After(options.call_timeout_s)));
      if (ack.sequence() <= acknowledged || ack.sequence() > sent) {
        return absl::InternalError(absl::StrCat("the server acknowledged feedback ", ack.sequence(),
                                                ", expected ", acknowledged + 1, " to ", sent));
      }
      acknowledged = ack.sequence();
      while (!unacknowledged.empty() && unacknowledged.front().chunk().sequence() <= acknowledged)
        unacknowledged.pop_front();
    }
    return absl::OkStatus();
  }

  FeedbackStream& OpenFeedback() {
    if (feedback == nullptr) {
      feedback = std::make_unique<FeedbackStream>(
          "Feedback", options.address,
          [&](grpc::ClientContext* context, grpc::CompletionQueue* queue) {
            return stub->PrepareAsyncFeedback(context, queue);
          });
    }
    return *feedback;
  }

  // Everything that is kept, from the oldest on, on a new stream.
  absl::Status ResendFeedback() {
    feedback.reset();
    for (const v1::FeedbackRequest& request : unacknowledged)
      RS_RETURN_IF_ERROR(OpenFeedback().Write(request, After(options.call_timeout_s)));
    return absl::OkStatus();
  }

  absl::Status SendKept() {
    absl::Status status =
        feedback_lost ? ResendFeedback()
                      : OpenFeedback().Write(unacknowledged.back(), After(options.call_timeout_s));
    if (status.ok())
      status = AwaitAcknowledgements(static_cast<uint64_t>(options.max_unacknowledged));
    feedback_lost = absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status) ||
                    absl::IsCancelled(status);
    return status;
  }
  bool feedback_lost = false;  // the stream; what is kept must be sent again
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
    const PolicyClientOptions& options, const SessionSpec& session) {
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::Channel> channel, OpenChannel(options));
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  impl->mode = session.mode;
  impl->stub = v1::PolicyService::NewStub(channel);
  v1::OpenSessionRequest request;
  *request.mutable_spec() = ToProto(session);
  v1::OpenSessionResponse response;
  RS_RETURN_IF_ERROR(impl->Unary(&v1::PolicyService::Stub::OpenSession, request, response,
                                 options.call_timeout_s));
  impl->session_id = response.session_id();
  auto client =
      std::unique_ptr<GrpcPolicyClient>(new GrpcPolicyClient(std::move(impl)));  // closes on error
  RS_ASSIGN_OR_RETURN(client->impl_->spec, FromProto(response.policy()));
  return client;
}

GrpcPolicyClient::~GrpcPolicyClient() {
  impl_->predict.reset();
  impl_->feedback.reset();
  v1::CloseSessionRequest request;
  request.set_session_id(impl_->session_id);
  v1::CloseSessionResponse response;
  // Best effort: a server that is gone has closed it.
  impl_->Unary(&v1::PolicyService::Stub::CloseSession, request, response, 5).IgnoreError();
}

const PolicySpec& GrpcPolicyClient::spec() const { return impl_->spec; }
uint64_t GrpcPolicyClient::last_feedback_sequence() const { return impl_->sent; }
uint64_t GrpcPolicyClient::acknowledged_feedback_sequence() const { return impl_->acknowledged; }
const std::string& GrpcPolicyClient::session_id() const { return impl_->session_id; }

absl::Status GrpcPolicyClient::StartEpisode(const EpisodeKey& key) {
  v1::StartEpisodeRequest request;
  request.set_session_id(impl_->session_id);
  request.set_task(static_cast<uint32_t>(key.task));
  request.set_episode(static_cast<uint32_t>(key.episode));
  request.set_last_feedback_sequence(impl_->sent);
  v1::StartEpisodeResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::StartEpisode, request, response,
                                  impl_->options.call_timeout_s));
  impl_->episode = key;
  impl_->episode_started = true;
  return absl::OkStatus();
}

absl::StatusOr<PredictedChunk> GrpcPolicyClient::Predict(const Observation& observation,
                                                         int chunk) {
  if (!impl_->episode_started) return absl::FailedPreconditionError("Predict before StartEpisode");
  RS_RETURN_IF_ERROR(CheckObservation(observation, impl_->spec));
  if (impl_->predict == nullptr) {
    impl_->predict = std::make_unique<Impl::PredictStream>(
        "Predict", impl_->options.address,
        [&](grpc::ClientContext* context, grpc::CompletionQueue* queue) {
          return impl_->stub->PrepareAsyncPredict(context, queue);
        });
  }
  v1::PredictRequest request;
  request.set_session_id(impl_->session_id);
  request.set_task(static_cast<uint32_t>(impl_->episode.task));
  request.set_episode(static_cast<uint32_t>(impl_->episode.episode));
  request.set_chunk(static_cast<uint32_t>(chunk));
  request.set_last_feedback_sequence(impl_->sent);
  *request.mutable_observation() = ToProto(observation);
  const Clock::time_point deadline = After(impl_->options.call_timeout_s);
  v1::PredictResponse response;
  while (true) {
    absl::Status status = impl_->predict->Write(request, deadline);
    if (status.ok()) status = impl_->predict->Read(response, deadline);
    if (!status.ok()) {
      impl_->predict.reset();  // the session outlives a stream
      return status;
    }
    if (!response.has_refusal()) break;
    const absl::Status refusal = FromProto(response.refusal());
    const Clock::time_point again = After(absl::ToDoubleSeconds(RetryAfter(refusal)));
    // A simulation has time: it comes back when the server says. A robot decides itself.
    if (impl_->mode != ExecutionMode::kLockstep || !absl::IsResourceExhausted(refusal) ||
        RetryAfter(refusal) == absl::ZeroDuration() || again > deadline) {
      return refusal;
    }
    std::this_thread::sleep_until(again);
  }
  if (response.chunk() != request.chunk()) {
    return absl::InternalError(
        absl::StrCat("the server answered chunk ", response.chunk(), ", asked for chunk ", chunk));
  }
  RS_ASSIGN_OR_RETURN(PredictedChunk prediction, FromProto(response));
  RS_RETURN_IF_ERROR(CheckPrediction(prediction, impl_->spec));
  return prediction;
}

absl::Status GrpcPolicyClient::SendFeedback(ExecutedChunk executed) {
  if (executed.sequence != impl_->sent + 1) {
    return absl::FailedPreconditionError(
        absl::StrCat("feedback sequence is ", executed.sequence, ", must be ", impl_->sent + 1));
  }
  RS_RETURN_IF_ERROR(CheckExecutedChunk(executed, impl_->spec));
  v1::FeedbackRequest request;
  request.set_session_id(impl_->session_id);
  *request.mutable_chunk() = ToProto(executed);
  if (impl_->mode == ExecutionMode::kAsync) {
    impl_->unacknowledged.push_back(std::move(request));
    impl_->sent = executed.sequence;
    return impl_->SendKept();
  }
  RS_RETURN_IF_ERROR(impl_->OpenFeedback().Write(request, After(impl_->options.call_timeout_s)));
  impl_->sent = executed.sequence;
  // A refused chunk must be known before the next prediction waits for it.
  return impl_->AwaitAcknowledgements(0);
}

absl::StatusOr<SessionStats> GrpcPolicyClient::Stats() {
  RS_RETURN_IF_ERROR(impl_->AwaitAcknowledgements(0));
  v1::GetStatsRequest request;
  request.set_session_id(impl_->session_id);
  v1::GetStatsResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::GetStats, request, response,
                                  impl_->options.call_timeout_s));
  return FromProto(response);
}

absl::StatusOr<AdapterState> GrpcPolicyClient::ExportAdapter() {
  RS_RETURN_IF_ERROR(impl_->AwaitAcknowledgements(0));
  v1::ExportAdapterRequest request;
  request.set_session_id(impl_->session_id);
  v1::ExportAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::ExportAdapter, request, response,
                                  impl_->options.call_timeout_s));
  if (response.feedback_sequence() != impl_->sent) {
    return absl::InternalError(absl::StrCat("the exported adapter includes feedback up to ",
                                            response.feedback_sequence(), ", ", impl_->sent,
                                            " chunks were acknowledged"));
  }
  return AdapterState{std::move(*response.mutable_safetensors()), response.feedback_sequence(),
                      response.updates_applied()};
}

absl::StatusOr<uint64_t> GrpcPolicyClient::ImportAdapter(const std::string& safetensors) {
  RS_RETURN_IF_ERROR(impl_->AwaitAcknowledgements(0));
  v1::ImportAdapterRequest request;
  request.set_session_id(impl_->session_id);
  request.set_safetensors(safetensors);
  v1::ImportAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::ImportAdapter, request, response,
                                  impl_->options.call_timeout_s));
  impl_->feedback.reset();
  impl_->unacknowledged.clear();
  impl_->feedback_lost = false;
  impl_->sent = impl_->acknowledged = response.feedback_sequence();
  impl_->episode_started = false;
  return impl_->sent;
}

absl::StatusOr<uint64_t> GrpcPolicyClient::RollbackAdapter(uint64_t version) {
  RS_RETURN_IF_ERROR(impl_->AwaitAcknowledgements(0));
  v1::RollbackAdapterRequest request;
  request.set_session_id(impl_->session_id);
  request.set_version(version);
  v1::RollbackAdapterResponse response;
  RS_RETURN_IF_ERROR(impl_->Unary(&v1::PolicyService::Stub::RollbackAdapter, request, response,
                                  impl_->options.call_timeout_s));
  return response.updates_applied();
}

}  // namespace robostress
