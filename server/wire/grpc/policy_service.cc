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
#include "absl/time/time.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "server/wire/grpc/grpc_access.h"
#include "server/wire/grpc/grpc_call.h"
#include "server/wire/grpc/policy_handlers.h"

namespace robostress {
namespace {

constexpr char kHealthName[] = "robostress.v1.PolicyService";

absl::Status CheckOptions(const PolicyServerOptions& options) {
  const auto invalid = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  if (options.threads < 1 || options.threads > 1024)
    return invalid("--threads is ", options.threads, ", must be 1..1024");
  if (options.prefix_budget_mib < 0 || options.prefix_budget_mib > (int64_t{1} << 30)) {
    return invalid("--prefix-budget-mib is ", options.prefix_budget_mib, ", must be 0..1073741824");
  }
  if (options.max_sessions < 1 || options.max_sessions > 4096)
    return invalid("--max-sessions is ", options.max_sessions, ", must be 1..4096");
  if (options.snapshot_mib < 1 || options.snapshot_records < 1)
    return invalid("a snapshot is due after at least 1 MiB and 1 record");
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

// What the service stands on: threads, policies, sessions and what shows them.
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
    const PolicyHandlers::Options handlers{options_.threads, options_.max_sessions,
                                           options_.expire_after, options_.caps,
                                           options_.max_message_mib};
    handlers_ = std::make_unique<PolicyHandlers>(handlers, &policies_, sessions_.get(), host_.get(),
                                                 &calls_, &feedback_calls_);
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
    return std::make_unique<GrpcService>(kHealthName, handlers_->Methods(), grpc, options_.tokens,
                                         &metrics_);
  }

 private:
  static FairExecutorOptions ThreadsOf(const char* name, const PolicyServerOptions& options) {
    FairExecutorOptions threads;
    threads.name = name;
    threads.threads = options.max_sessions + 32;
    threads.per_client = threads.threads * 3 / 4;
    return threads;
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

  const PolicyServerOptions options_;
  MonotonicClock clock_;
  ServedPolicies policies_;  // fixed after construction
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
  std::unique_ptr<PolicyHandlers> handlers_;
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
  RS_RETURN_IF_ERROR(CheckOptions(options));
  auto server = std::unique_ptr<PolicyServer>(new PolicyServer());
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
  // An answer may still be on its way; streams that stay open would take any time.
  const absl::Duration last_words = std::min(grace, absl::Milliseconds(200));
  server_->Shutdown(absl::ToChronoTime(absl::Now() + last_words));
  server_->Wait();
  service_->StopThreads();
  server_.reset();
  grpc_.reset();
}

}  // namespace robostress
