// robostress proxy: compensation around a policy that somebody else serves, before a real robot.

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <csignal>
#include <cstdio>
#include <memory>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/client_secrets.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/wire/web_socket_client.h"
#include "server/flag_visitor.h"
#include "server/operations/json_log.h"
#include "server/operations/process_metrics.h"
#include "server/operations/reloader.h"
#include "server/proxy/arm_profile.h"
#include "server/proxy/proxy_board.h"
#include "server/proxy/proxy_pages.h"
#include "server/proxy/proxy_record.h"
#include "server/proxy/relay.h"
#include "server/proxy_options.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robostress proxy --upstream ws://gpu:8000 --robot robot.yaml --shadow        # only says what it would do
  robostress proxy --upstream ws://gpu:8000 --robot robot.yaml --out runs/tuesday
  robostress proxy --upstream wss://gpu:8443 --robot robot.yaml --set following_limit=0.3
  robostress proxy off                       # every answer passes from now on; kill -USR1 does the same
  robostress proxy on                        # begins anew; kill -USR2
  robostress proxy state --at 127.0.0.1:8002

Point the client at --listen instead of the server; nothing else changes. robot.yaml of a LIBERO-like arm:
  name: panda
  control_space: end_effector
  dialect: libero
  rate_hz: 20
  execute_steps: 5
  state: {position: [0, 1, 2], rotation: [3, 4, 5]}
  action: {size: 7, translation: [0, 1, 2], rotation: [3, 4, 5], translation_unit: 0.05, rotation_unit: 0.5}

ROBOSTRESS_TLS_CA, ROBOSTRESS_TLS_CERTIFICATE, ROBOSTRESS_TLS_KEY and ROBOSTRESS_TOKEN_FILE say whom the
proxy trusts upstream and what it shows there. SIGTERM and SIGINT stop it. Exit code: 0 done, 1 refused or
nobody there, 2 the command is wrong.)";

struct SwitchRequest {
  std::string at = "127.0.0.1:8002";
};

// `what`: on, off or state, of a proxy that runs.
absl::Status SwitchProxy(const std::string& what, const SwitchRequest& request) {
  WebSocketOptions options;
  options.connect_timeout = absl::Seconds(5);
  RS_ASSIGN_OR_RETURN(
      const std::unique_ptr<WebSocketClient> client,
      WebSocketClient::Connect(absl::StrCat("ws://", request.at, "/switch"), options));
  RS_RETURN_IF_ERROR(client->Receive(absl::Seconds(5)).status());
  RS_RETURN_IF_ERROR(client->Send(what));
  RS_ASSIGN_OR_RETURN(const WebSocketMessage answer, client->Receive(absl::Seconds(5)));
  if (answer.text) return absl::InternalError(answer.bytes);
  std::printf("%s\n", answer.bytes.c_str());
  return absl::OkStatus();
}

struct ProxySecrets {
  std::shared_ptr<TlsStore> tls;
  std::shared_ptr<TokenStore> tokens;
  TlsFiles files;
};

absl::StatusOr<ProxySecrets> SecretsOf(const ProxyOptions& options) {
  ProxySecrets secrets;
  secrets.files = {options.tls_certificate, options.tls_key, options.tls_client_ca};
  if (secrets.files.enabled()) {
    RS_ASSIGN_OR_RETURN(secrets.tls, LoadTls(secrets.files));
  }
  if (!options.tokens.empty()) {
    RS_ASSIGN_OR_RETURN(AccessTokens tokens, AccessTokens::Load(options.tokens));
    secrets.tokens = std::make_shared<TokenStore>(std::move(tokens));
  }
  return secrets;
}

void WarnOfOpenPort(const char* flag, const std::string& listen) {
  if (listen.empty() || absl::StartsWith(listen, "127.") || absl::StartsWith(listen, "[::1]") ||
      absl::StartsWith(listen, "localhost:"))
    return;
  spdlog::warn("{} {} is open to other machines and asks nobody who he is", flag, listen);
}

// Signals that wait together have no order: of on and off, off wins.
void ForgetSwitchOn() {
  sigset_t on;
  sigemptyset(&on);
  sigaddset(&on, SIGUSR2);
  const timespec at_once{};
  sigtimedwait(&on, nullptr, &at_once);
}

absl::Status RunProxy(const ProxyOptions& options, const sigset_t& signals) {
  if (options.upstream.empty() || options.robot.empty()) {
    return absl::InvalidArgumentError(
        "name the policy server and the robot: --upstream ws://HOST:PORT --robot robot.yaml");
  }
  if (options.max_message_mib < 1 || options.max_message_mib > 1024) {
    return absl::InvalidArgumentError(
        absl::StrCat("--max-message-mib is ", options.max_message_mib, ", must be 1..1024"));
  }
  RS_ASSIGN_OR_RETURN(ArmProfile profile, LoadArmProfile(options.robot));
  if (!options.method.empty()) {
    // Options that the file has are its own method's.
    if (options.method != profile.method) profile.method_options.clear();
    profile.method = options.method;
  }
  RS_ASSIGN_OR_RETURN(const MethodOptions method, MethodOf(profile, options.set));
  RS_ASSIGN_OR_RETURN(const ProxySecrets secrets, SecretsOf(options));

  if (secrets.tokens == nullptr && options.tls_client_ca.empty())
    WarnOfOpenPort("--listen", options.listen);
  WarnOfOpenPort("--http-listen", options.http_listen);

  Metrics metrics;
  AddProcessMetrics(&metrics);
  std::unique_ptr<ProxyRecord> record;
  if (!options.out.empty()) {
    RS_ASSIGN_OR_RETURN(record, ProxyRecord::Create(options.out, profile));
  }
  ProxyBoard board(profile, method, options.shadow, &metrics, record.get());
  RelayOptions relay_options;
  relay_options.listen = options.listen;
  relay_options.upstream = options.upstream;
  relay_options.tls = secrets.tls;
  relay_options.tokens = secrets.tokens;
  RS_ASSIGN_OR_RETURN(relay_options.secrets, ClientSecretsFromEnvironment());
  relay_options.max_clients = options.max_clients;
  relay_options.max_message_bytes = static_cast<uint64_t>(options.max_message_mib) << 20;
  RS_ASSIGN_OR_RETURN(
      const std::unique_ptr<Relay> relay,
      Relay::Start(relay_options, [&board](const std::string& peer) { return board.Tap(peer); }));
  const auto clients = metrics.AddGauge("robostress_proxy_clients", "Clients connected now.");
  const auto there =
      metrics.AddGauge("robostress_proxy_upstream_there", "1: the policy server listens.");
  const auto dropped = metrics.AddGauge("robostress_proxy_record_dropped",
                                        "Entries of the record that the disk did not take.");
  metrics.AddCollector([&] {
    const RelayFigures figures = relay->figures();
    clients->Set(figures.clients);
    there->Set(figures.upstream_there ? 1 : 0);
    dropped->Set(record == nullptr ? 0 : static_cast<double>(record->dropped()));
  });
  const ProxySources sources{&board, relay.get(), &metrics, options.upstream};
  std::unique_ptr<WebServer> http;
  if (!options.http_listen.empty()) {
    WebServerOptions web;
    web.name = "proxy-http";
    web.listen = options.http_listen;
    web.max_connections = 32;
    web.workers = 4;
    RS_ASSIGN_OR_RETURN(
        http,
        WebServer::Start(
            web, [&sources](const WebRequest& request) { return ProxyPage(request, sources); },
            [&sources](const WebRequest& request) { return OpenProxySwitch(request, sources); },
            &metrics));
  }
  ReloaderOptions reload;
  reload.tls_files = secrets.files;
  reload.tokens_file = options.tokens;
  RS_ASSIGN_OR_RETURN(
      const std::unique_ptr<Reloader> reloader,
      Reloader::Start(reload, secrets.tls,
                      secrets.tokens != nullptr ? secrets.tokens : std::make_shared<TokenStore>(),
                      &metrics));
  if (!options.ports_file.empty()) {
    RS_RETURN_IF_ERROR(WriteFileAtomically(
        options.ports_file, absl::StrCat("websocket: ", relay->port(),
                                         "\nhttp: ", http == nullptr ? 0 : http->port(), "\n")));
  }
  std::printf("%s before %s: clients on port %d, method %s%s, columns %s\n", profile.name.c_str(),
              options.upstream.c_str(), relay->port(), method.method.c_str(),
              options.shadow ? " in shadow" : "", absl::StrJoin(profile.axes(), " ").c_str());
  if (http != nullptr)
    std::printf("live page, metrics and switch: http://localhost:%d/\n", http->port());
  std::fflush(stdout);

  while (true) {
    int signal = 0;
    sigwait(&signals, &signal);
    if (signal == SIGUSR1) {
      board.Switch(false);
      ForgetSwitchOn();
    } else if (signal == SIGUSR2) {
      board.Switch(true);
    } else if (signal == SIGHUP) {
      reloader->ReloadNow();
    } else {
      break;
    }
  }
  std::printf("stopping\n");
  std::fflush(stdout);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  ProxyOptions options;
  SwitchRequest request;
  cli::App app{
      "Corrects a robot's commands between an unmodified openpi client and the policy server of "
      "somebody else.",
      "robostress proxy"};
  app.footer(kExamples);
  app.require_subcommand(0, 1);
  FlagVisitor flags(&app);
  options.Visit(flags);
  app.get_option("--set")->allow_extra_args(false);  // a command may follow
  for (const auto& [name, help] :
       {std::pair{"off", "Switch a running proxy off: every answer passes"},
        {"on", "Switch it on again; it begins anew"},
        {"state", "Say what a running proxy does"}}) {
    app.add_subcommand(name, help)
        ->add_option("--at", request.at, "HOST:PORT of its --http-listen")
        ->capture_default_str();
  }
  return RunMain(app, argc, argv, [&]() -> absl::Status {
    for (const char* what : {"off", "on", "state"}) {
      if (app.got_subcommand(what)) return SwitchProxy(what, request);
    }
    // Blocked before any thread starts, so that every thread inherits it and sigwait is the only
    // receiver.
    sigset_t signals;
    sigemptyset(&signals);
    for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGUSR1, SIGUSR2})
      sigaddset(&signals, signal);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    signal(SIGXFSZ, SIG_IGN);  // a record that may not grow ends, and its clients do not
    RS_RETURN_IF_ERROR(SetUpLog(options.log_format, options.log_level));
    return RunProxy(options, signals);
  });
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
