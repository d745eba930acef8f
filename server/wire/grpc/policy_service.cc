#include "server/wire/grpc/policy_service.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
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
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/operations/process_metrics.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/read_spec.h"
#include "server/wire/grpc/grpc_access.h"
#include "server/wire/grpc/grpc_call.h"

namespace robostress {
namespace {

constexpr char kHealthName[] = "robostress.v1.PolicyService";

absl::Status CheckBatching(const PolicyServerOptions& options) {
  const auto invalid = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  if (options.max_batch < 1 || options.max_batch > 1024)
    return invalid("--max-batch is ", options.max_batch, ", must be 1..1024");
  if (options.batch_window < absl::ZeroDuration() || options.batch_window > absl::Seconds(10)) {
    return invalid("--batch-window-ms is ", absl::ToDoubleMilliseconds(options.batch_window),
                   ", must be 0..10000");
  }
  if (options.queue_capacity < 1 || options.queue_capacity > 1 << 20)
    return invalid("--queue-capacity is ", options.queue_capacity, ", must be 1..1048576");
  if (!(options.update_share >= 0.001 && options.update_share <= 1))
    return invalid("--update-share is ", options.update_share, ", must be 0.001..1");
  if (options.cores < 0 || options.cores > 1 << 16)
    return invalid("--cores is ", options.cores, ", must be 0..65536; 0: all of this machine");
  if (options.update_nice < 0 || options.update_nice > 19)
    return invalid("--update-nice is ", options.update_nice, ", must be 0..19");
  return absl::OkStatus();
}

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
  return std::min(bytes + names, size_t{kMaxMessageBytes});
}

absl::Status WarmUp(const FlowPolicy& policy) {
  const PolicySpec& spec = policy.spec();
  Observation blank;
  blank.instruction = "warm up";
  for (const std::string& camera : spec.cameras) {
    Image image{spec.image_width, spec.image_height, {}};
    image.data.resize(3 * static_cast<size_t>(spec.image_width) *
                      static_cast<size_t>(spec.image_height));
    blank.views.push_back({camera, std::move(image)});
  }
  blank.proprioception = Eigen::VectorXf::Zero(spec.state_dim);
  try {
    torch::NoGradGuard no_grad;
    RS_ASSIGN_OR_RETURN(const PolicyContext context, policy.Encode(blank));
    policy.Sample(context, torch::zeros({1, policy.horizon(), policy.model_action_dim()}), nullptr);
  } catch (const std::exception& error) {
    return absl::InternalError(
        absl::StrCat("policy ", spec.name, " failed to warm up: ", error.what()));
  }
  return absl::OkStatus();
}

BatcherOptions BatchingOf(const PolicyServerOptions& options) {
  BatcherOptions batching;
  batching.threads = options.threads;
  batching.max_batch = options.max_batch;
  batching.window = options.batch_window;
  batching.queue.capacity = options.queue_capacity;
  batching.queue.starvation_limit = options.starvation_limit;
  return batching;
}

}  // namespace

// Handlers: convert, call, say what came out. gRPC itself is server/wire/grpc/grpc_call.h.
class PolicyServer::Service {
 public:
  Service(const PolicyServerOptions& options,
          std::vector<std::shared_ptr<const FlowPolicy>> policies)
      : options_(options),
        prefixes_(std::make_shared<PrefixStore>(options.prefix_budget_mib << 20)),
        own_metrics_(options.metrics == nullptr ? std::make_unique<Metrics>() : nullptr),
        metrics_(options.metrics == nullptr ? *own_metrics_ : *options.metrics),
        telemetry_(&metrics_),
        traces_(&metrics_, static_cast<size_t>(options.kept_traces)),
        pacer_({options.cores, options.update_share}, &metrics_),
        async_updates_({options.threads, &pacer_, UpdatePacer::Kind::kAsync, options.update_nice}),
        lockstep_updates_({options.threads, &pacer_, UpdatePacer::Kind::kLockstep, 0}),
        inference_(BatchingOf(options), &pacer_, &metrics_),
        calls_(ThreadsOf("call", options)),
        feedback_calls_(ThreadsOf("feedback", options)) {
    for (auto& policy : policies) policies_[policy->spec().name] = std::move(policy);
  }

  absl::Status OpenRegistry() {
    SessionRegistryOptions registry;
    registry.max_sessions = options_.max_sessions;
    registry.caps = options_.caps;
    registry.state_dir = options_.state_dir;
    registry.max_stored_sessions = options_.max_stored_sessions;
    registry.abandoned_after = options_.abandoned_after;
    registry.expire_after = options_.expire_after;
    RS_ASSIGN_OR_RETURN(
        sessions_,
        SessionRegistry::Create(
            registry, [this](const std::string& name) { return ResourcesOf(name); }, &clock_));
    std::vector<PolicySpec> specs;
    for (const auto& [name, policy] : policies_) {
      specs.push_back(policy->spec());
      if (options_.max_view_side != 0) specs.back().max_view_side = options_.max_view_side;
    }
    host_ = std::make_unique<RegistryHost>(sessions_.get(), std::move(specs), options_.guard,
                                           &telemetry_, &traces_);
    return absl::OkStatus();
  }
  // The first prediction of a policy allocates and touches everything that later ones use.
  absl::Status WarmUp() const {
    for (const auto& [name, policy] : policies_) RS_RETURN_IF_ERROR(robostress::WarmUp(*policy));
    return absl::OkStatus();
  }
  SessionRegistry& sessions() { return *sessions_; }
  RegistryHost& host() { return *host_; }
  Metrics& metrics() { return metrics_; }
  TraceLog& traces() { return traces_; }
  Telemetry& telemetry() { return telemetry_; }
  std::shared_ptr<const TokenStore> tokens() const { return options_.tokens; }
  void StopThreads() {
    calls_.Stop();
    feedback_calls_.Stop();
    inference_.Stop();
    async_updates_.Stop();
    lockstep_updates_.Stop();
  }

  // After OpenRegistry; outlives the server that it is registered with.
  std::unique_ptr<GrpcService> MakeGrpc() {
    GrpcServiceOptions grpc;
    grpc.wire = AccessRule::Wire::kPolicy;
    grpc.calls_per_client =
        options_.calls_per_client != 0 ? options_.calls_per_client : 4 * options_.max_sessions + 64;
    grpc.idle_timeout = options_.stream_idle;
    grpc.message_timeout = options_.message_timeout;
    grpc.attach = [this](const std::string& id) { sessions_->Attach(id); };
    grpc.detach = [this](const std::string& id) { sessions_->Detach(id); };
    return std::make_unique<GrpcService>(kHealthName, Methods(), grpc, options_.tokens, &metrics_);
  }

 private:
  static FairExecutorOptions ThreadsOf(const char* name, const PolicyServerOptions& options) {
    FairExecutorOptions threads;
    threads.name = name;
    threads.threads = options.max_sessions + 32;
    threads.per_client = threads.threads * 3 / 4;
    return threads;
  }

  static absl::Status CheckIndex(const char* field, uint32_t value) {
    if (value <= static_cast<uint32_t>(WireLimits::kIndex)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat(field, " is ", value, ", must be at most ", WireLimits::kIndex));
  }

  // What the policies served here need [bytes].
  size_t LargestRequest(const std::string& method) const {
    size_t most = size_t{256} << 10;  // a session's spec
    for (const PolicySpec& spec : host_->policies()) {
      const int side = std::max({spec.max_view_side, spec.image_width, spec.image_height});
      if (method == "Predict") most = std::max(most, LargestObservationBytes(spec, side, 1));
      if (method == "Feedback") most = std::max(most, LargestExecutedBytes(spec));
      if (method == "ImportAdapter")
        most = std::max(most, LargestAdapterBytes(*policies_.at(spec.name), options_.caps));
    }
    return most;
  }

  template <class Request, class Response>
  GrpcMethod Unary(const char* name,
                   absl::Status (Service::*handler)(GrpcCallView&, const Request&, Response&)) {
    GrpcMethod method;
    method.name = name;
    method.largest_request = LargestRequest(name);
    method.executor = &calls_;
    method.answer = TypedAnswer<Request, Response>(
        [this, handler](GrpcCallView& view, const Request& request, Response& response) {
          return (this->*handler)(view, request, response);
        });
    return method;
  }

  std::vector<GrpcMethod> Methods() {
    GrpcMethod predict = Unary("Predict", &Service::Predict);
    predict.streams = true;
    predict.reads_ahead = [this](const std::string& id) { return sessions_->IsAsync(id); };
    // A refusal is an answer, and the stream goes on; of a stream that is read ahead every error
    // is.
    predict.as_answer = [](const google::protobuf::Message& request, const absl::Status& status,
                           bool read_ahead, google::protobuf::Message& response) {
      if (!read_ahead && !IsRefusal(status)) return false;
      auto& refused = static_cast<v1::PredictResponse&>(response);
      refused.set_chunk(static_cast<const v1::PredictRequest&>(request).chunk());
      *refused.mutable_refusal() = ToRefusal(status);
      return true;
    };
    GrpcMethod feedback = Unary("Feedback", &Service::Feedback);
    feedback.streams = true;
    feedback.executor = &feedback_calls_;
    GrpcMethod import = Unary("ImportAdapter", &Service::ImportAdapter);
    import.at_once = 2;  // the largest messages there are
    return {Unary("GetServerInfo", &Service::GetServerInfo),
            Unary("OpenSession", &Service::OpenSession),
            Unary("ResumeSession", &Service::ResumeSession),
            Unary("CloseSession", &Service::CloseSession),
            Unary("StartEpisode", &Service::StartEpisode),
            std::move(predict),
            std::move(feedback),
            Unary("GetStats", &Service::GetStats),
            Unary("ExportAdapter", &Service::ExportAdapter),
            std::move(import),
            Unary("RollbackAdapter", &Service::RollbackAdapter)};
  }

  absl::Status GetServerInfo(GrpcCallView&, const v1::GetServerInfoRequest&,
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

  absl::Status OpenSession(GrpcCallView& call, const v1::OpenSessionRequest& request,
                           v1::OpenSessionResponse& response) {
    const absl::Status status = Open(call.caller(), request, response);
    if (IsRefusal(status))
      call.AddTrailingMetadata(kRefusalMetadata, ToRefusal(status).SerializeAsString());
    return status;
  }

  absl::Status CloseSession(GrpcCallView& call, const v1::CloseSessionRequest& request,
                            v1::CloseSessionResponse&) {
    return host_->CloseSession(call.caller(), request.session_id());
  }

  absl::Status StartEpisode(GrpcCallView& call, const v1::StartEpisodeRequest& request,
                            v1::StartEpisodeResponse&) {
    RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
    RS_RETURN_IF_ERROR(CheckIndex("task", request.task()));
    RS_RETURN_IF_ERROR(CheckIndex("episode", request.episode()));
    return session->StartEpisode(static_cast<int>(request.task()),
                                 static_cast<int>(request.episode()),
                                 request.last_feedback_sequence());
  }

  absl::Status GetStats(GrpcCallView& call, const v1::GetStatsRequest& request,
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
    response.set_journal_bytes(counters.journal_bytes);
    response.set_durable(session->durable());
    return absl::OkStatus();
  }

  absl::Status ExportAdapter(GrpcCallView& call, const v1::ExportAdapterRequest& request,
                             v1::ExportAdapterResponse& response) {
    RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
    RS_ASSIGN_OR_RETURN(AdapterState state, session->Export());
    response.set_safetensors(std::move(state.safetensors));
    response.set_feedback_sequence(state.feedback_sequence);
    response.set_updates_applied(state.updates_applied);
    return absl::OkStatus();
  }

  absl::Status ImportAdapter(GrpcCallView& call, const v1::ImportAdapterRequest& request,
                             v1::ImportAdapterResponse& response) {
    RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
    RS_ASSIGN_OR_RETURN(const FeedbackResult result, session->Import(request.safetensors()));
    response.set_feedback_sequence(result.sequence);
    response.set_updates_applied(result.updates_applied);
    return absl::OkStatus();
  }

  absl::Status RollbackAdapter(GrpcCallView& call, const v1::RollbackAdapterRequest& request,
                               v1::RollbackAdapterResponse& response) {
    RS_ASSIGN_OR_RETURN(const auto session, sessions_->Use(request.session_id(), call.caller()));
    RS_RETURN_IF_ERROR(session->Rollback(request.version()));
    response.set_updates_applied(request.version());
    return absl::OkStatus();
  }

  absl::StatusOr<SessionResources> ResourcesOf(const std::string& name) {
    const auto policy = policies_.find(name);
    if (policy == policies_.end()) {
      std::vector<std::string> names;
      for (const auto& [served, ignored] : policies_) names.push_back(served);
      return absl::NotFoundError(absl::StrCat(
          "policy '", name, "' is not served here; served: ", absl::StrJoin(names, ", ")));
    }
    SessionResources resources{policy->second, &async_updates_, &inference_,
                               options_.lockstep_timeout, prefixes_};
    resources.lockstep_adaptation = &lockstep_updates_;
    resources.max_view_side = options_.max_view_side;
    resources.snapshot_bytes = options_.snapshot_mib << 20;
    resources.snapshot_records = options_.snapshot_records;
    resources.sync_predictions = options_.sync_predictions;
    return resources;
  }

  uint64_t ExpiresAfter() const {
    const absl::Duration after = options_.expire_after;
    return after == absl::InfiniteDuration()
               ? 0
               : static_cast<uint64_t>(std::max(int64_t{1}, absl::ToInt64Seconds(after)));
  }

  absl::Status Open(const Caller& caller, const v1::OpenSessionRequest& request,
                    v1::OpenSessionResponse& response) {
    SessionRequest wanted;
    RS_ASSIGN_OR_RETURN(const RequestedSession asked, FromProto(request.spec()));
    RS_ASSIGN_OR_RETURN(wanted.spec, ReadSpec(asked));
    wanted.guard = options_.guard;
    if (request.has_guard()) {
      RS_ASSIGN_OR_RETURN(wanted.guard, FromRecord(request.guard()));
    }
    RS_ASSIGN_OR_RETURN(wanted.scheduling.priority, FromProto(request.priority()));
    RS_RETURN_IF_ERROR(CheckIndex("deadline_ms", request.deadline_ms()));
    wanted.scheduling.deadline_ms = static_cast<int>(request.deadline_ms());
    RS_ASSIGN_OR_RETURN(const OpenedSession opened, sessions_->Open(wanted, caller));
    response.set_session_id(opened.id);
    response.set_resume_token(opened.token);
    response.set_durable(opened.session->durable());
    response.set_expires_after_s(ExpiresAfter());
    *response.mutable_policy() = ToProto(opened.session->policy_spec());
    return absl::OkStatus();
  }

  absl::Status ResumeSession(GrpcCallView& call, const v1::ResumeSessionRequest& request,
                             v1::ResumeSessionResponse& response) {
    RS_ASSIGN_OR_RETURN(
        const OpenedSession opened,
        sessions_->Resume(request.session_id(), request.resume_token(), call.caller()));
    const SessionPosition position = opened.session->Position();
    *response.mutable_policy() = ToProto(opened.session->policy_spec());
    response.set_durable(opened.session->durable());
    response.set_feedback_sequence(position.feedback_sequence);
    response.set_last_prediction_id(position.last_prediction_id);
    response.set_updates_applied(position.updates_applied);
    response.set_episode_started(position.episode && position.episode->second >= 0);
    if (response.episode_started()) {
      response.set_task(static_cast<uint32_t>(position.episode->first));
      response.set_episode(static_cast<uint32_t>(position.episode->second));
    }
    response.set_expires_after_s(ExpiresAfter());
    return absl::OkStatus();
  }

  absl::Status Predict(GrpcCallView& call, const v1::PredictRequest& request,
                       v1::PredictResponse& response) {
    const auto received = std::chrono::steady_clock::now();
    const std::string& id = request.session_id();
    RS_RETURN_IF_ERROR(sessions_->Use(id, call.caller()).status());  // before what it says
    call.Serves(id);
    for (const auto& [field, index] : {std::pair("task", request.task()),
                                       {"episode", request.episode()},
                                       {"chunk", request.chunk()},
                                       {"deadline_ms", request.deadline_ms()}})
      RS_RETURN_IF_ERROR(CheckIndex(field, index));
    RS_ASSIGN_OR_RETURN(const Observation observation, FromProto(request.observation()));
    PredictOptions options;
    RS_ASSIGN_OR_RETURN(options.priority, FromProto(request.priority()));
    if (request.deadline_ms() > 0) options.deadline = absl::Milliseconds(request.deadline_ms());
    options.cancelled = [&call] { return call.cancelled(); };
    RS_ASSIGN_OR_RETURN(
        const PredictedChunk prediction,
        host_->Predict(call.caller(), id, observation,
                       {static_cast<int>(request.task()), static_cast<int>(request.episode())},
                       static_cast<int>(request.chunk()), request.last_feedback_sequence(),
                       std::move(options), received));
    response = ToProto(prediction, static_cast<int>(request.chunk()));
    return absl::OkStatus();
  }

  absl::Status Feedback(GrpcCallView& call, const v1::FeedbackRequest& request,
                        v1::FeedbackAck& ack) {
    RS_RETURN_IF_ERROR(sessions_->Use(request.session_id(), call.caller()).status());
    call.Serves(request.session_id());
    RS_ASSIGN_OR_RETURN(const ExecutedChunk chunk, FromProto(request.chunk()));
    RS_ASSIGN_OR_RETURN(const SessionHost::Acknowledged taken,
                        host_->Feedback(call.caller(), request.session_id(), chunk));
    ack.set_sequence(taken.sequence);
    ack.set_updates_applied(taken.updates_applied);
    ack.set_durable(taken.durable);
    ack.set_duplicate(taken.duplicate);
    return absl::OkStatus();
  }

  const PolicyServerOptions options_;
  const std::string instance_ = absl::StrCat(absl::Hex(absl::ToUnixNanos(absl::Now())));
  MonotonicClock clock_;
  std::map<std::string, std::shared_ptr<const FlowPolicy>>
      policies_;  // by name; fixed after construction
  const std::shared_ptr<PrefixStore> prefixes_;
  const std::unique_ptr<Metrics> own_metrics_;
  Metrics& metrics_;
  Telemetry telemetry_;
  TraceLog traces_;
  UpdatePacer pacer_;
  AdaptationLoop async_updates_, lockstep_updates_;
  Batcher inference_;
  FairExecutor calls_, feedback_calls_;  // apart: a lockstep prediction waits for feedback
  // Set by OpenRegistry.
  std::unique_ptr<SessionRegistry> sessions_;
  std::unique_ptr<RegistryHost> host_;
};

PolicyServer::PolicyServer() = default;
PolicyServer::~PolicyServer() { Stop(absl::ZeroDuration()); }
SessionRegistry& PolicyServer::sessions() { return service_->sessions(); }
RegistryHost& PolicyServer::host() { return service_->host(); }
Metrics& PolicyServer::metrics() { return service_->metrics(); }
TraceLog& PolicyServer::traces() { return service_->traces(); }
Telemetry& PolicyServer::telemetry() { return service_->telemetry(); }
std::shared_ptr<const TokenStore> PolicyServer::tokens() const { return service_->tokens(); }

absl::StatusOr<std::unique_ptr<PolicyServer>> PolicyServer::Start(
    const PolicyServerOptions& options, std::vector<std::shared_ptr<const FlowPolicy>> policies) {
  if (options.threads < 1 || options.threads > 1024) {
    return absl::InvalidArgumentError(
        absl::StrCat("--threads is ", options.threads, ", must be 1..1024"));
  }
  if (options.prefix_budget_mib < 0 || options.prefix_budget_mib > (int64_t{1} << 30)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--prefix-budget-mib is ", options.prefix_budget_mib, ", must be 0..1073741824"));
  }
  RS_RETURN_IF_ERROR(CheckBatching(options));
  if (options.max_sessions < 1 || options.max_sessions > 4096) {
    return absl::InvalidArgumentError(
        absl::StrCat("--max-sessions is ", options.max_sessions, ", must be 1..4096"));
  }
  auto server = std::unique_ptr<PolicyServer>(new PolicyServer());
  if (options.snapshot_mib < 1 || options.snapshot_records < 1) {
    return absl::InvalidArgumentError("a snapshot is due after at least 1 MiB and 1 record");
  }
  server->service_ = std::make_unique<Service>(options, std::move(policies));
  RS_RETURN_IF_ERROR(server->service_->OpenRegistry());
  server->grpc_ = server->service_->MakeGrpc();

  grpc::EnableDefaultHealthCheckService(true);
  grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  grpc::ServerBuilder builder;
  LimitConnections(builder, {.calls = server->grpc_->calls_per_client()});
  builder.SetMaxReceiveMessageSize(
      std::min(static_cast<int>(server->grpc_->largest_request()), options.max_message_mib << 20));
  builder.SetMaxSendMessageSize(options.max_message_mib << 20);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT,
                             0);  // a second server on the port must fail, not share it
  server->credentials_ = MakeServerCredentials(options.tls);
  builder.AddListeningPort(options.listen, server->credentials_, &server->port_);
  builder.RegisterService(server->grpc_.get());
  server->server_ = builder.BuildAndStart();
  if (server->server_ == nullptr || server->port_ == 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on ", options.listen,
                     ": the port is taken or the address is not this machine's; use --listen "
                     "HOST:0 for a free port"));
  }
  grpc::HealthCheckServiceInterface* health = server->server_->GetHealthCheckService();
  health->SetServingStatus(false);
  health->SetServingStatus(kHealthName, false);
  if (options.warm_up) RS_RETURN_IF_ERROR(server->service_->WarmUp());
  health->SetServingStatus(true);
  health->SetServingStatus(kHealthName, true);
  server->ready_ = true;
  return server;
}

void PolicyServer::Drain() {
  ready_ = false;
  server_->GetHealthCheckService()->SetServingStatus(false);
  service_->sessions().Drain();
}

void PolicyServer::Stop(absl::Duration grace) {
  if (server_ == nullptr) return;
  Drain();
  SessionRegistry& sessions = service_->sessions();
  if (sessions.AwaitIdle(grace)) sessions.FlushAll();
  sessions.CancelAll();
  server_->Shutdown(std::chrono::system_clock::now());
  server_->Wait();
  service_->StopThreads();
  server_.reset();
  grpc_.reset();
}

}  // namespace robostress
