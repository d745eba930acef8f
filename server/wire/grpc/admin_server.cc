#include "server/wire/grpc/admin_server.h"

#include <grpcpp/grpcpp.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/sessions/read_spec.h"
#include "server/wire/fair_executor.h"
#include "server/wire/grpc/grpc_access.h"
#include "server/wire/grpc/grpc_call.h"

namespace robostress {
namespace {

constexpr size_t kLargestRequest = 64 << 10;  // [bytes]
constexpr int kCallsPerClient = 32;

}  // namespace

// Handlers: call, convert, log who did it.
class AdminServer::Service {
 public:
  Service(AdminServerOptions options, SessionRegistry* registry)
      : options_(std::move(options)), registry_(registry) {}

  std::vector<GrpcMethod> Methods(FairExecutor* executor) {
    return {Unary("ListSessions", &Service::ListSessions, executor),
            Unary("ListVersions", &Service::ListVersions, executor),
            Unary("PinVersion", &Service::PinVersion, executor),
            Unary("ExportVersion", &Service::ExportVersion, executor),
            Unary("RollbackSession", &Service::RollbackSession, executor),
            Unary("EndSession", &Service::EndSession, executor),
            Unary("Drain", &Service::Drain, executor)};
  }

 private:
  template <class Request, class Response>
  GrpcMethod Unary(const char* name,
                   absl::Status (Service::*handler)(GrpcCallView&, const Request&, Response&),
                   FairExecutor* executor) {
    GrpcMethod method;
    method.name = name;
    method.largest_request = kLargestRequest;
    method.executor = executor;
    method.answer = TypedAnswer<Request, Response>(
        [this, handler](GrpcCallView& view, const Request& request, Response& response) {
          return (this->*handler)(view, request, response);
        });
    return method;
  }

  absl::Status ListSessions(GrpcCallView& call, const v1::ListSessionsRequest&,
                            v1::ListSessionsResponse& response) {
    return Logged(call, "", [&]() -> absl::Status {
      for (const SessionRow& row : registry_->List()) {
        v1::SessionSummary& summary = *response.add_sessions();
        summary.set_session_id(row.id);
        *summary.mutable_spec() = ToProto(RequestOf(row.request.spec));
        summary.set_open(row.open);
        summary.set_priority(ToProto(row.request.scheduling.priority));
        summary.set_idle_s(absl::ToDoubleSeconds(row.idle));
        summary.set_feedback_sequence(row.feedback_sequence);
        summary.set_predictions(row.counters.predictions);
        summary.set_updates_applied(row.counters.stats.updates_applied);
        summary.set_adapter_distance(row.counters.stats.adapter_distance);
        summary.set_last_loss(row.counters.stats.last_loss);
        if (!row.error.ok()) summary.set_error(row.error.ToString());
      }
      return absl::OkStatus();
    });
  }

  absl::Status ListVersions(GrpcCallView& call, const v1::ListVersionsRequest& request,
                            v1::ListVersionsResponse& response) {
    return Logged(call, "", [&]() -> absl::Status {
      RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session,
                          registry_->Load(request.session_id()));
      RS_ASSIGN_OR_RETURN(const std::vector<PublishedVersion> versions, session->Versions());
      for (size_t i = 0; i < versions.size(); ++i) {
        v1::AdapterVersion& version = *response.add_versions();
        version.set_version(versions[i].weights->version);
        version.set_published(i + 1 == versions.size());
        version.set_pinned(versions[i].pinned);
        version.set_distance(versions[i].distance);
        version.set_feedback_sequence(versions[i].feedback_sequence);
        version.set_loss(versions[i].loss);
      }
      return absl::OkStatus();
    });
  }

  absl::Status PinVersion(GrpcCallView& call, const v1::PinVersionRequest& request,
                          v1::PinVersionResponse&) {
    const std::string what = absl::StrCat(request.pinned() ? "pin" : "unpin", " version ",
                                          request.version(), " of ", request.session_id());
    return Logged(call, what, [&]() -> absl::Status {
      RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session,
                          registry_->Load(request.session_id()));
      return session->Pin(request.version(), request.pinned());
    });
  }

  absl::Status ExportVersion(GrpcCallView& call, const v1::ExportVersionRequest& request,
                             v1::ExportVersionResponse& response) {
    const std::string what =
        absl::StrCat("export version ", request.version(), " of ", request.session_id());
    return Logged(call, what, [&]() -> absl::Status {
      RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session,
                          registry_->Load(request.session_id()));
      RS_ASSIGN_OR_RETURN(*response.mutable_safetensors(),
                          session->ExportVersion(request.version()));
      return absl::OkStatus();
    });
  }

  absl::Status RollbackSession(GrpcCallView& call, const v1::RollbackSessionRequest& request,
                               v1::RollbackSessionResponse& response) {
    const std::string what =
        absl::StrCat("roll ", request.session_id(), " back to version ", request.version());
    return Logged(call, what, [&]() -> absl::Status {
      RS_ASSIGN_OR_RETURN(const SessionRegistry::Lease session,
                          registry_->Load(request.session_id()));
      RS_RETURN_IF_ERROR(session->Rollback(request.version()));
      response.set_updates_applied(request.version());
      return absl::OkStatus();
    });
  }

  absl::Status EndSession(GrpcCallView& call, const v1::EndSessionRequest& request,
                          v1::EndSessionResponse&) {
    return Logged(call, absl::StrCat("end ", request.session_id()),
                  [&] { return registry_->Close(request.session_id()); });
  }

  absl::Status Drain(GrpcCallView& call, const v1::DrainRequest& request, v1::DrainResponse&) {
    return Logged(call, "drain", [&]() -> absl::Status {
      if (!(request.grace_s() >= 0 && request.grace_s() <= 86400)) {
        return absl::InvalidArgumentError(
            absl::StrCat("grace_s is ", request.grace_s(), ", must be 0..86400"));
      }
      if (!drained_.exchange(true) && options_.drain)
        options_.drain(absl::Seconds(request.grace_s()));
      return absl::OkStatus();
    });
  }

  // Logs what changes something, with who did it.
  template <class Function>
  absl::Status Logged(const GrpcCallView& call, const std::string& what, Function&& function) {
    const absl::Status status = function();
    if (!what.empty()) {
      spdlog::info("admin: {} ({}): {}: {}", call.caller().name, call.peer(), what,
                   status.ok() ? "done" : status.ToString());
    }
    return status;
  }

  const AdminServerOptions options_;
  SessionRegistry* const registry_;
  std::atomic<bool> drained_{false};
};

AdminServer::AdminServer() = default;
AdminServer::~AdminServer() {
  if (server_ == nullptr) return;
  // Calls under way are answered: Drain, which may be what ends this server, is one of them.
  server_->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(2));
  server_->Wait();
  executor_->Stop();
}

absl::StatusOr<std::unique_ptr<AdminServer>> AdminServer::Start(
    const AdminServerOptions& options, SessionRegistry* registry,
    std::shared_ptr<const TokenStore> tokens, Metrics* metrics) {
  auto server = std::unique_ptr<AdminServer>(new AdminServer());
  FairExecutorOptions threads;
  threads.name = "admin";
  threads.threads = 8;
  threads.per_client = 6;
  server->executor_ = std::make_unique<FairExecutor>(threads);
  server->service_ = std::make_unique<Service>(options, registry);
  GrpcServiceOptions grpc;
  grpc.wire = AccessRule::Wire::kAdmin;
  grpc.calls_per_client = kCallsPerClient;
  server->grpc_ = std::make_unique<GrpcService>("robostress.v1.AdminService",
                                                server->service_->Methods(server->executor_.get()),
                                                grpc, std::move(tokens), metrics);
  server->credentials_ = MakeServerCredentials(options.tls);
  grpc::ServerBuilder builder;
  LimitConnections(builder, {.calls = kCallsPerClient});
  builder.SetMaxReceiveMessageSize(static_cast<int>(kLargestRequest));
  builder.SetMaxSendMessageSize(kMaxMessageBytes);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.AddListeningPort(options.listen, server->credentials_, &server->port_);
  builder.RegisterService(server->grpc_.get());
  server->server_ = builder.BuildAndStart();
  if (server->server_ == nullptr || server->port_ == 0) {
    return absl::UnavailableError(absl::StrCat("cannot listen on ", options.listen,
                                               " for operators: the port is taken or the address "
                                               "is not this machine's; use --admin-listen HOST:0"));
  }
  return server;
}

}  // namespace robostress
