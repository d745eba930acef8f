#include <pthread.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <memory>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/config.h"
#include "common/rollout/message_limits.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "server/flag_visitor.h"
#include "server/inference/torch_threads.h"
#include "server/operations/json_log.h"
#include "server/operations/process_metrics.h"
#include "server/operations/reloader.h"
#include "server/pages/operations_pages.h"
#include "server/serve_options.h"
#include "server/web_endpoints.h"
#include "server/wire/grpc/admin_server.h"
#include "server/wire/grpc/policy_service.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robostress serve                                        # nano on a free port of this machine
  robostress serve --policy nano --listen 0.0.0.0:50051   # for workers on other machines
  robostress serve --state-dir /var/lib/robostress        # sessions survive the server
  robostress serve --policy my_nano.safetensors --port-file /tmp/port
  robostress serve --policy pi05_libero --policy-options transform=libero tokenizer=paligemma_tokenizer.model
  robostress serve --websocket-listen 127.0.0.1:8000 --http-listen 127.0.0.1:9090   # openpi's clients; live page
  robostress serve --config serve.yaml --threads 4        # a file with the flags' names, and flags over it
  robostress serve --config serve.yaml --print-config     # what would be served with
  robostress-worker --unit UNIT.yaml --out DIR --server 127.0.0.1:50051

SIGTERM and SIGINT stop it: it refuses new messages, answers those under way (at most --grace seconds) and exits.
SIGHUP reads certificates and tokens again; they are also read every --reload-seconds.
Without --tls-certificate and --tokens nothing is encrypted and nobody is asked who they are: every port is loopback
unless you say otherwise, and should stay there or on a trusted network.)";

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "robostress serve: %s\n", std::string(status.message()).c_str());
  return 1;
}

// What may change while the server runs.
struct Secrets {
  std::shared_ptr<TlsStore> tls;  // null: plain
  std::shared_ptr<TokenStore> tokens = std::make_shared<TokenStore>();
};

TlsFiles TlsOf(const ServeOptions& options) {
  return {options.tls_certificate, options.tls_key, options.tls_client_ca};
}

absl::StatusOr<Secrets> SecretsOf(const ServeOptions& options) {
  Secrets secrets;
  if (TlsOf(options).enabled()) {
    RS_ASSIGN_OR_RETURN(secrets.tls, LoadTls(TlsOf(options)));
  }
  if (!options.tokens.empty()) {
    RS_ASSIGN_OR_RETURN(AccessTokens tokens, AccessTokens::Load(options.tokens));
    secrets.tokens = std::make_shared<TokenStore>(std::move(tokens));
  }
  return secrets;
}

template <class T>
absl::Status InRange(const char* flag, T value, T low, T high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(flag, " is ", value, ", must be ", low, "..", high));
}

absl::Status CheckLimits(const ServeOptions& o) {
  RS_RETURN_IF_ERROR(InRange("--max-stored-sessions", o.max_stored_sessions, 1, 1000000));
  RS_RETURN_IF_ERROR(InRange("--abandoned-after", o.abandoned_after, 0.0, 1e7));
  RS_RETURN_IF_ERROR(InRange("--lockstep-timeout", o.lockstep_timeout, 1.0, 86400.0));
  RS_RETURN_IF_ERROR(InRange("--starvation-limit", o.starvation_limit, 0.0, 3600.0));
  RS_RETURN_IF_ERROR(
      InRange("--max-message-mib", o.max_message_mib, 1, kLargestMessageBytes >> 20));
  RS_RETURN_IF_ERROR(InRange("--kept-traces", o.kept_traces, 1, 100000));
  RS_RETURN_IF_ERROR(InRange("--request-timeout", o.request_timeout, 1.0, 3600.0));
  RS_RETURN_IF_ERROR(InRange("--idle-timeout", o.idle_timeout, 1.0, 86400.0));
  RS_RETURN_IF_ERROR(InRange("--health-connections", o.health_connections, 1, 1024));
  RS_RETURN_IF_ERROR(InRange("--max-rank", o.max_rank, 1, 256));
  RS_RETURN_IF_ERROR(InRange("--max-update-batch", o.max_update_batch, 1, 4096));
  RS_RETURN_IF_ERROR(InRange("--min-update-interval", o.min_update_interval, 1, 1 << 20));
  RS_RETURN_IF_ERROR(InRange("--max-buffer-chunks", o.max_buffer_chunks, 1, 4096));
  RS_RETURN_IF_ERROR(InRange("--calls-per-client", o.calls_per_client, 0, 1 << 20));
  RS_RETURN_IF_ERROR(InRange("--stream-idle", o.stream_idle, 1.0, 1e7));
  RS_RETURN_IF_ERROR(InRange("--grace", o.grace, 0.0, 86400.0));
  return InRange("--session-expiry", o.session_expiry, 0.0, 1e9);
}

absl::StatusOr<PolicyServerOptions> PolicyServerOptionsOf(const ServeOptions& options) {
  PolicyServerOptions result;
  result.listen = options.listen;
  result.threads = options.threads != 0
                       ? options.threads
                       : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  result.max_batch = options.max_batch;
  result.batch_window = absl::Milliseconds(options.batch_window_ms);
  result.queue_capacity = options.queue_capacity;
  result.cores = options.cores;
  result.update_share = options.update_share;
  result.update_nice = options.update_nice;
  result.max_sessions = options.max_sessions;
  result.caps = {options.max_rank, options.max_update_batch, options.min_update_interval,
                 options.max_buffer_chunks};
  result.prefix_budget_mib = options.prefix_budget_mib;
  result.warm_up = options.warm_up;
  if (options.max_view_side < 0 || options.max_view_side > WireLimits::kImageSide) {
    return absl::InvalidArgumentError(absl::StrCat("--max-view-side is ", options.max_view_side,
                                                   ", must be 0 (what the policy takes) to ",
                                                   WireLimits::kImageSide));
  }
  result.max_view_side = options.max_view_side;
  result.state_dir = options.state_dir;
  result.max_stored_sessions = options.max_stored_sessions;
  result.abandoned_after = absl::Seconds(options.abandoned_after);
  result.lockstep_timeout = absl::Seconds(options.lockstep_timeout);
  result.starvation_limit = absl::Seconds(options.starvation_limit);
  result.max_message_mib = options.max_message_mib;
  result.kept_traces = options.kept_traces;
  result.calls_per_client = options.calls_per_client;
  result.stream_idle = absl::Seconds(options.stream_idle);
  result.message_timeout = absl::Seconds(options.request_timeout);
  if (options.session_expiry > 0) result.expire_after = absl::Seconds(options.session_expiry);
  result.snapshot_mib = options.snapshot_mib;
  result.snapshot_records = options.snapshot_records;
  result.sync_predictions = options.sync_predictions;
  if (!(options.guard_ratio >= 1e-6 && options.guard_ratio <= 1e6)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--guard-ratio is ", options.guard_ratio, ", must be 1e-6..1e6"));
  }
  if (!(options.guard_distance >= 0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--guard-distance is ", options.guard_distance, ", must be 0 or above"));
  }
  result.guard.enabled = options.guard;
  result.guard.max_loss_ratio = options.guard_ratio;
  result.guard.max_distance = options.guard_distance;
  return result;
}

absl::StatusOr<WebEndpointsOptions> WebEndpointsOptionsOf(const ServeOptions& options) {
  if (options.websocket_max_mib < 0 || options.websocket_max_mib > 1024) {
    return absl::InvalidArgumentError(absl::StrCat("--websocket-max-mib is ",
                                                   options.websocket_max_mib,
                                                   ", must be 0 (what the policy needs) to 1024"));
  }
  WebEndpointsOptions result;
  result.websocket_listen = options.websocket_listen;
  result.http_listen = options.http_listen;
  result.max_connections = options.max_connections;
  result.websocket_workers = options.max_sessions + 32;  // as gRPC has for its calls
  result.request_timeout = absl::Seconds(options.request_timeout);
  result.idle_timeout = absl::Seconds(options.idle_timeout);
  result.max_message_bytes = static_cast<uint64_t>(options.websocket_max_mib) << 20;
  result.max_connections_per_client = options.connections_per_client;
  result.allowed_hosts = options.allowed_hosts;
  result.openpi.input.resize = options.websocket_resize;
  result.openpi.input.max_view_side = options.max_view_side;
  result.openpi.input.camera_keys = options.websocket_cameras;
  result.openpi.input.default_prompt = options.websocket_prompt;
  result.openpi.session.robot = "openpi";
  result.openpi.session.suite = "openpi";
  result.openpi.session.scenario = "unknown";
  result.openpi.session.mode = ExecutionMode::kAsync;
  RS_ASSIGN_OR_RETURN(result.openpi.session.method, MakeMethod(options.websocket_method));
  return result;
}

bool IsLoopback(const std::string& listen) {
  return listen.empty() || listen.rfind("127.", 0) == 0 || listen.rfind("localhost:", 0) == 0 ||
         listen.rfind("[::1]:", 0) == 0 || listen.rfind("unix:", 0) == 0;
}

// gRPC and the system's resolver take a port modulo 65536.
absl::Status CheckPort(const char* flag, const std::string& listen) {
  if (listen.empty() || absl::StartsWith(listen, "unix")) return absl::OkStatus();
  const std::string port = listen.substr(listen.rfind(':') + 1);
  int number = -1;
  if (absl::SimpleAtoi(port, &number) && number >= 0 && number <= 65535) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(flag, " is ", listen, ", whose port '", port,
                                                 "' must be 0..65535, as in 127.0.0.1:50051"));
}

absl::Status CheckPorts(const ServeOptions& options) {
  RS_RETURN_IF_ERROR(CheckPort("--listen", options.listen));
  RS_RETURN_IF_ERROR(CheckPort("--websocket-listen", options.websocket_listen));
  RS_RETURN_IF_ERROR(CheckPort("--http-listen", options.http_listen));
  RS_RETURN_IF_ERROR(CheckPort("--health-listen", options.health_listen));
  return CheckPort("--admin-listen", options.admin_listen);
}

void WarnOfOpenPorts(const ServeOptions& options) {
  const bool closed = !options.tokens.empty() || !options.tls_client_ca.empty();
  for (const std::string& listen :
       {options.listen, options.websocket_listen, options.http_listen, options.admin_listen}) {
    if (!closed && !IsLoopback(listen))
      spdlog::warn("{} is open to other machines and asks nobody for a token or certificate",
                   listen);
  }
}

int AwaitSignal(const sigset_t& signals) {
  int signal = 0;
  sigwait(&signals, &signal);
  return signal;
}

// Probes are answered from the start on, and by nobody else's places: what fills the other ports
// does not look like a server that is gone. Null: not served.
absl::StatusOr<std::unique_ptr<WebServer>> StartHealth(const ServeOptions& options,
                                                       std::function<bool()> ready,
                                                       Metrics* metrics) {
  if (options.health_listen.empty()) return nullptr;
  WebServerOptions web;
  web.name = "health";
  web.listen = options.health_listen;
  web.max_connections = options.health_connections;
  web.request_timeout = absl::Seconds(5);  // a place is soon free again
  return WebServer::Start(
      web,
      [ready = std::move(ready)](const WebRequest& request) { return HealthPage(request, ready); },
      nullptr, metrics);
}

// Serves until a signal or Drain.
absl::Status Serve(const ServeOptions& options, const sigset_t& signals) {
  UseOneTorchThread();
  RS_RETURN_IF_ERROR(CheckPorts(options));
  RS_RETURN_IF_ERROR(CheckLimits(options));
  RS_ASSIGN_OR_RETURN(PolicyServerOptions server_options, PolicyServerOptionsOf(options));
  RS_ASSIGN_OR_RETURN(WebEndpointsOptions web_options, WebEndpointsOptionsOf(options));
  RS_ASSIGN_OR_RETURN(const Secrets secrets, SecretsOf(options));
  server_options.tls = web_options.tls = secrets.tls;
  server_options.tokens = secrets.tokens;
  WarnOfOpenPorts(options);
  Metrics metrics;
  AddProcessMetrics(&metrics);
  server_options.metrics = &metrics;
  std::unique_ptr<PolicyServer> server;
  std::atomic<const PolicyServer*> started{nullptr};
  RS_ASSIGN_OR_RETURN(
      const std::unique_ptr<WebServer> health,
      StartHealth(
          options, [&started] { return started != nullptr && started.load()->ready(); }, &metrics));
  RS_ASSIGN_OR_RETURN(std::unique_ptr<FlowPolicy> policy,
                      LoadFlowPolicy(options.policy, options.policy_options));
  const PolicySpec spec = policy->spec();
  const bool exact_rows = policy->exact_rows();
  RS_ASSIGN_OR_RETURN(server, PolicyServer::Start(server_options, {std::move(policy)}));
  if (!options.state_dir.empty()) AddDiskMetrics(options.state_dir, &metrics);
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<WebEndpoints> web,
                      WebEndpoints::Start(web_options, server.get()));
  std::atomic<double> drain_grace_s{0};
  std::unique_ptr<AdminServer> admin;
  if (!options.admin_listen.empty()) {
    AdminServerOptions admin_options;
    admin_options.listen = options.admin_listen;
    admin_options.tls = secrets.tls;
    admin_options.drain = [&](absl::Duration grace) {
      server->Drain();
      drain_grace_s = absl::ToDoubleSeconds(grace);
      kill(getpid(), SIGTERM);  // the main thread waits for it and stops the server
    };
    RS_ASSIGN_OR_RETURN(admin, AdminServer::Start(admin_options, &server->sessions(),
                                                  secrets.tokens, &server->metrics()));
  }
  ReloaderOptions reload;
  reload.tls_files = TlsOf(options);
  reload.tokens_file = options.tokens;
  reload.period = absl::Seconds(options.reload_seconds);
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Reloader> reloader,
                      Reloader::Start(reload, secrets.tls, secrets.tokens, &metrics));
  started = server.get();  // every port listens
  if (!options.port_file.empty()) {
    RS_RETURN_IF_ERROR(WriteFileAtomically(options.port_file, absl::StrCat(server->port(), "\n")));
  }
  if (!options.ports_file.empty()) {
    RS_RETURN_IF_ERROR(WriteFileAtomically(
        options.ports_file,
        absl::StrCat("grpc: ", server->port(), "\nwebsocket: ", web->websocket_port(), "\nhttp: ",
                     web->http_port(), "\nadmin: ", admin == nullptr ? 0 : admin->port(),
                     "\nhealth: ", health == nullptr ? 0 : health->port(), "\n")));
  }
  const std::string host = options.listen.substr(0, options.listen.rfind(':'));
  std::printf("serving %s (%s) on %s:%d with %d threads\n", spec.name.c_str(),
              spec.model_hash.c_str(), host.c_str(), server->port(), server_options.threads);
  std::printf("batches of at most %d; lockstep predictions are %s\n", options.max_batch,
              exact_rows ? "batched too: this policy's rows have the bits of batches of one"
                         : "computed alone: this policy's rows agree to rounding only");
  if (web->websocket_port() != 0) std::printf("openpi clients: port %d\n", web->websocket_port());
  if (web->http_port() != 0) {
    std::printf("live page and metrics: %s://localhost:%d/\n",
                secrets.tls != nullptr ? "https" : "http", web->http_port());
  }
  if (admin != nullptr) std::printf("operators: port %d\n", admin->port());
  if (health != nullptr) std::printf("probes: port %d\n", health->port());
  std::fflush(stdout);

  while (AwaitSignal(signals) == SIGHUP) reloader->ReloadNow();
  std::printf("stopping\n");
  std::fflush(stdout);
  const absl::Duration grace =
      absl::Seconds(drain_grace_s > 0 ? drain_grace_s.load() : options.grace);
  server->Drain();
  web->StopWebSockets(grace);
  admin.reset();
  server->Stop(grace);
  return absl::OkStatus();
}

// A first pass finds the file, whose values are the defaults of the second.
std::string ConfigFileOf(int argc, char** argv) {
  cli::App app;
  std::string file;
  app.add_option("--config", file);
  app.set_help_flag();
  app.allow_extras();
  return app.ParseQuietly(argc, argv) ? file : "";  // the second pass says what is wrong
}

int Main(int argc, char** argv) {
  ServeOptions options;
  if (const std::string file = ConfigFileOf(argc, argv); !file.empty()) {
    absl::StatusOr<ServeOptions> loaded = LoadConfig<ServeOptions>(file);
    if (!loaded.ok()) return Fail(loaded.status());
    options = *std::move(loaded);
  }
  cli::App app{"Serves a policy with online self-compensation over gRPC and openpi's WebSocket.",
               "robostress serve"};
  app.footer(kExamples);
  std::string config_file;
  bool print_config = false;
  app.add_option("--config", config_file,
                 "YAML file with the flags' names (a_b for --a-b); flags win over it");
  app.add_flag("--print-config", print_config, "print the resolved configuration and exit");
  FlagVisitor flags(&app);
  options.Visit(flags);
  return RunMain(app, argc, argv, [&]() -> absl::Status {
    if (print_config) {
      std::printf("%s", DumpConfig(options).c_str());
      return absl::OkStatus();
    }
    // Blocked before any thread starts, so that every thread inherits it and sigwait is the only
    // receiver.
    sigset_t signals;
    sigemptyset(&signals);
    for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, signal);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    RS_RETURN_IF_ERROR(SetUpLog(options.log_format, options.log_level));
    return Serve(options, signals);
  });
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
