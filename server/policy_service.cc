#include "server/policy_service.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "common/rpc/convert.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/predict_stream.h"

namespace robostress {
namespace {

constexpr char kVersion[] = "0.1.0";

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

BatcherOptions BatchingOf(const PolicyServerOptions& options) {
  BatcherOptions batching;
  batching.threads = options.threads;
  batching.max_batch = options.max_batch;
  batching.window = options.batch_window;
  batching.queue.capacity = options.queue_capacity;
  return batching;
}

}  // namespace

// Handlers: convert, call, set the status.
class PolicyServer::Service final : public v1::PolicyService::Service {
 public:
  Service(const PolicyServerOptions& options,
          std::vector<std::shared_ptr<const FlowPolicy>> policies)
      : options_(options),
        prefixes_(std::make_shared<PrefixStore>(options.prefix_budget_mib << 20)),
        pacer_({options.cores, options.update_share}),
        async_updates_({options.threads, &pacer_, UpdatePacer::Kind::kAsync, options.update_nice}),
        lockstep_updates_({options.threads, &pacer_, UpdatePacer::Kind::kLockstep, 0}),
        inference_(BatchingOf(options), &pacer_) {
    for (auto& policy : policies) policies_[policy->spec().name] = std::move(policy);
  }

  // New sessions and messages are refused from now on.
  void Drain() ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    draining_ = true;
  }
  // True when no message is under way.
  bool AwaitIdle(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    const auto idle = [this] {
      mu_.AssertHeld();
      return in_flight_ == 0;
    };
    return mu_.AwaitWithTimeout(absl::Condition(&idle), timeout);
  }
  void CancelSessions() ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    for (auto& [id, entry] : sessions_) entry.session->Cancel();
  }
  void StopThreads() {
    inference_.Stop();
    async_updates_.Stop();
    lockstep_updates_.Stop();
  }

  grpc::Status GetServerInfo(grpc::ServerContext*, const v1::GetServerInfoRequest*,
                             v1::GetServerInfoResponse* response) override {
    ServerInfo info;
    info.version = kVersion;
    for (const auto& [name, policy] : policies_) info.policies.push_back(policy->spec());
    info.max_sessions = options_.max_sessions;
    info.inference_threads = options_.threads;
    {
      absl::MutexLock lock(&mu_);
      info.open_sessions = static_cast<int>(sessions_.size());
    }
    *response = ToProto(info);
    return grpc::Status::OK;
  }

  grpc::Status OpenSession(grpc::ServerContext*, const v1::OpenSessionRequest* request,
                           v1::OpenSessionResponse* response) override {
    return ToGrpc(Open(*request, *response));
  }

  grpc::Status CloseSession(grpc::ServerContext*, const v1::CloseSessionRequest* request,
                            v1::CloseSessionResponse*) override {
    absl::MutexLock lock(&mu_);
    const auto found = sessions_.find(request->session_id());
    if (found == sessions_.end()) return ToGrpc(UnknownSession(request->session_id()));
    found->second.session->Cancel();
    sessions_.erase(found);
    return grpc::Status::OK;
  }

  grpc::Status StartEpisode(grpc::ServerContext*, const v1::StartEpisodeRequest* request,
                            v1::StartEpisodeResponse*) override {
    return Serve(request->session_id(), [&](Session& session) -> absl::Status {
      RS_RETURN_IF_ERROR(CheckIndex("task", request->task()));
      RS_RETURN_IF_ERROR(CheckIndex("episode", request->episode()));
      return session.StartEpisode(static_cast<int>(request->task()),
                                  static_cast<int>(request->episode()),
                                  request->last_feedback_sequence());
    });
  }

  grpc::Status Predict(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::PredictResponse, v1::PredictRequest>* stream) override {
    return ServePredictStream(
        context, stream,
        {[this](const std::string& id) { return IsAsync(id); },
         [this](const v1::PredictRequest& request, const std::function<bool()>& cancelled,
                v1::PredictResponse& response) { return Predict(request, cancelled, response); }});
  }

  grpc::Status Feedback(
      grpc::ServerContext*,
      grpc::ServerReaderWriter<v1::FeedbackAck, v1::FeedbackRequest>* stream) override {
    v1::FeedbackRequest request;
    while (stream->Read(&request)) {
      v1::FeedbackAck ack;
      const grpc::Status status =
          Serve(request.session_id(), [&](Session& session) -> absl::Status {
            RS_ASSIGN_OR_RETURN(const ExecutedChunk chunk, FromProto(request.chunk()));
            RS_ASSIGN_OR_RETURN(const FeedbackResult result, session.Feedback(chunk));
            ack.set_sequence(result.sequence);
            ack.set_updates_applied(result.updates_applied);
            return absl::OkStatus();
          });
      if (!status.ok()) return status;
      if (!stream->Write(ack)) break;
    }
    return grpc::Status::OK;
  }

  grpc::Status GetStats(grpc::ServerContext*, const v1::GetStatsRequest* request,
                        v1::GetStatsResponse* response) override {
    return Serve(request->session_id(), [&](Session& session) -> absl::Status {
      RS_ASSIGN_OR_RETURN(const SessionCounters counters, session.Counters());
      *response = ToProto(counters.stats);
      response->set_buffered_chunks(static_cast<uint32_t>(counters.buffered_chunks));
      response->set_predictions(counters.predictions);
      response->set_prefix_bytes(static_cast<uint64_t>(counters.prefixes.bytes));
      response->set_prefix_evictions(counters.prefixes.evictions);
      response->set_prefix_rebuilds(counters.prefixes.rebuilds);
      return absl::OkStatus();
    });
  }

  grpc::Status ExportAdapter(grpc::ServerContext*, const v1::ExportAdapterRequest* request,
                             v1::ExportAdapterResponse* response) override {
    return Serve(request->session_id(), [&](Session& session) -> absl::Status {
      RS_ASSIGN_OR_RETURN(AdapterState state, session.Export());
      response->set_safetensors(std::move(state.safetensors));
      response->set_feedback_sequence(state.feedback_sequence);
      response->set_updates_applied(state.updates_applied);
      return absl::OkStatus();
    });
  }

  grpc::Status ImportAdapter(grpc::ServerContext*, const v1::ImportAdapterRequest* request,
                             v1::ImportAdapterResponse* response) override {
    return Serve(request->session_id(), [&](Session& session) -> absl::Status {
      RS_ASSIGN_OR_RETURN(const FeedbackResult result, session.Import(request->safetensors()));
      response->set_feedback_sequence(result.sequence);
      response->set_updates_applied(result.updates_applied);
      return absl::OkStatus();
    });
  }

  grpc::Status RollbackAdapter(grpc::ServerContext*, const v1::RollbackAdapterRequest* request,
                               v1::RollbackAdapterResponse* response) override {
    return Serve(request->session_id(), [&](Session& session) -> absl::Status {
      RS_RETURN_IF_ERROR(session.Rollback(request->version()));
      response->set_updates_applied(request->version());
      return absl::OkStatus();
    });
  }

 private:
  static absl::Status UnknownSession(const std::string& id) {
    return absl::NotFoundError(absl::StrCat(
        "session '", id,
        "' is not open here; it was closed or the server was restarted: open a new one"));
  }

  static absl::Status CheckIndex(const char* field, uint32_t value) {
    if (value <= static_cast<uint32_t>(WireLimits::kIndex)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat(field, " is ", value, ", must be at most ", WireLimits::kIndex));
  }

  absl::Status Open(const v1::OpenSessionRequest& request, v1::OpenSessionResponse& response)
      ABSL_LOCKS_EXCLUDED(mu_) {
    RS_ASSIGN_OR_RETURN(const SessionSpec spec, FromProto(request.spec()));
    const auto policy = policies_.find(spec.policy);
    if (policy == policies_.end()) {
      std::vector<std::string> names;
      for (const auto& [name, ignored] : policies_) names.push_back(name);
      return absl::NotFoundError(absl::StrCat(
          "policy '", spec.policy, "' is not served here; served: ", absl::StrJoin(names, ", ")));
    }
    uint64_t owner = 0;
    {
      absl::MutexLock lock(&mu_);
      if (draining_) return absl::UnavailableError("the server is shutting down");
      if (static_cast<int>(sessions_.size() + opening_) >= options_.max_sessions) {
        CloseAbandoned();
      }
      if (static_cast<int>(sessions_.size() + opening_) >= options_.max_sessions) {
        return absl::ResourceExhaustedError(absl::StrCat(
            sessions_.size(), " sessions are open, which is the limit, and all were used within ",
            absl::FormatDuration(options_.abandoned_after),
            "; close one or start the server with more --max-sessions"));
      }
      ++opening_;
      owner = ++last_session_;
    }
    AdaptationLoop* const updates =
        spec.mode == ExecutionMode::kAsync ? &async_updates_ : &lockstep_updates_;
    const SessionResources resources{policy->second, updates, &inference_,
                                     options_.lockstep_timeout, prefixes_};
    absl::StatusOr<std::shared_ptr<Session>> session = Session::Create(spec, resources, owner);
    absl::MutexLock lock(&mu_);
    --opening_;
    if (!session.ok()) return session.status();
    const std::string id = absl::StrCat("session-", owner);
    sessions_[id].session = *std::move(session);
    response.set_session_id(id);
    *response.mutable_policy() = ToProto(policy->second->spec());
    return absl::OkStatus();
  }

  bool IsAsync(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    const auto found = sessions_.find(id);
    return found != sessions_.end() && found->second.session->spec().mode == ExecutionMode::kAsync;
  }

  absl::Status Predict(const v1::PredictRequest& request, const std::function<bool()>& cancelled,
                       v1::PredictResponse& response) {
    return Run(request.session_id(), [&](Session& session) -> absl::Status {
      RS_RETURN_IF_ERROR(CheckIndex("chunk", request.chunk()));
      RS_ASSIGN_OR_RETURN(const Observation observation, FromProto(request.observation()));
      PredictOptions options;
      RS_ASSIGN_OR_RETURN(options.priority, FromProto(request.priority()));
      if (request.deadline_ms() > 0) options.deadline = absl::Milliseconds(request.deadline_ms());
      options.cancelled = cancelled;
      RS_ASSIGN_OR_RETURN(
          const PredictedChunk prediction,
          session.Predict(observation, static_cast<int>(request.task()),
                          static_cast<int>(request.episode()), static_cast<int>(request.chunk()),
                          request.last_feedback_sequence(), options));
      response = ToProto(prediction, static_cast<int>(request.chunk()));
      return absl::OkStatus();
    });
  }

  template <class Function>
  grpc::Status Serve(const std::string& id, Function&& function) ABSL_LOCKS_EXCLUDED(mu_) {
    return ToGrpc(Run(id, function));
  }

  // Runs one message of a session and counts it.
  template <class Function>
  absl::Status Run(const std::string& id, Function&& function) ABSL_LOCKS_EXCLUDED(mu_) {
    std::shared_ptr<Session> session;
    {
      absl::MutexLock lock(&mu_);
      if (draining_) return absl::UnavailableError("the server is shutting down");
      const auto found = sessions_.find(id);
      if (found == sessions_.end()) return UnknownSession(id);
      session = found->second.session;
      ++found->second.in_flight;
      ++in_flight_;
    }
    const absl::Status status = function(*session);
    absl::MutexLock lock(&mu_);
    --in_flight_;
    if (const auto found = sessions_.find(id); found != sessions_.end()) {
      --found->second.in_flight;
      found->second.last_used = absl::Now();
    }
    return status;
  }

  // Closes the session that nobody has used for longest, if that is long enough.
  void CloseAbandoned() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    auto oldest = sessions_.end();
    for (auto at = sessions_.begin(); at != sessions_.end(); ++at) {
      if (at->second.in_flight > 0) continue;
      if (oldest == sessions_.end() || at->second.last_used < oldest->second.last_used) oldest = at;
    }
    if (oldest == sessions_.end()) return;
    const absl::Duration unused = absl::Now() - oldest->second.last_used;
    if (unused < options_.abandoned_after) return;
    spdlog::warn("{} was not used for {}: closed to make room", oldest->first,
                 absl::FormatDuration(unused));
    oldest->second.session->Cancel();
    sessions_.erase(oldest);
  }

  struct OpenedSession {
    std::shared_ptr<Session> session;
    absl::Time last_used = absl::Now();
    int in_flight = 0;  // messages under way
  };

  const PolicyServerOptions options_;
  std::map<std::string, std::shared_ptr<const FlowPolicy>>
      policies_;  // by name; fixed after construction
  const std::shared_ptr<PrefixStore> prefixes_;
  UpdatePacer pacer_;
  AdaptationLoop async_updates_, lockstep_updates_;
  Batcher inference_;

  absl::Mutex mu_;
  bool draining_ ABSL_GUARDED_BY(mu_) = false;
  int in_flight_ ABSL_GUARDED_BY(mu_) = 0;
  size_t opening_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t last_session_ ABSL_GUARDED_BY(mu_) = 0;
  std::map<std::string, OpenedSession> sessions_ ABSL_GUARDED_BY(mu_);
};

PolicyServer::PolicyServer() = default;
PolicyServer::~PolicyServer() { Stop(absl::ZeroDuration()); }

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
  server->service_ = std::make_unique<Service>(options, std::move(policies));

  grpc::EnableDefaultHealthCheckService(true);
  grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  grpc::ServerBuilder builder;
  grpc::ResourceQuota quota("policy_server");
  quota.SetMaxThreads(2 * options.max_sessions + 32);  // two streams a session hold a thread each
  builder.SetResourceQuota(quota);
  builder.SetMaxReceiveMessageSize(kMaxMessageBytes);
  builder.SetMaxSendMessageSize(kMaxMessageBytes);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT,
                             0);  // a second server on the port must fail, not share it
  builder.AddListeningPort(options.listen, grpc::InsecureServerCredentials(), &server->port_);
  builder.RegisterService(server->service_.get());
  server->server_ = builder.BuildAndStart();
  if (server->server_ == nullptr || server->port_ == 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on ", options.listen,
                     ": the port is taken or the address is not this machine's; use --listen "
                     "HOST:0 for a free port"));
  }
  server->server_->GetHealthCheckService()->SetServingStatus("robostress.v1.PolicyService", true);
  return server;
}

void PolicyServer::Stop(absl::Duration grace) {
  if (server_ == nullptr) return;
  server_->GetHealthCheckService()->SetServingStatus(false);
  service_->Drain();
  service_->AwaitIdle(grace);
  service_->CancelSessions();
  server_->Shutdown(std::chrono::system_clock::now());
  server_->Wait();
  service_->StopThreads();
  server_.reset();
}

}  // namespace robostress
