// robostress sessions: an operator's view of a running server's sessions, over AdminService.

#include <grpcpp/create_channel.h>

#include <chrono>
#include <cstdio>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/rpc/channel_credentials.h"
#include "common/rpc/grpc_status.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robostress/v1/policy.grpc.pb.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robostress serve --admin-listen 127.0.0.1:50052 ...         # the port that answers
  robostress sessions list
  robostress sessions versions SESSION                        # published adapters, oldest first
  robostress sessions export SESSION 24 --out arm_1.safetensors
  robostress sessions pin SESSION 24                          # keep it, whatever is published after
  robostress sessions rollback SESSION 24                     # predictions use it from the next on
  robostress sessions end SESSION
  robostress sessions drain --grace 10                        # answer what is under way, then stop

TLS and the operator's token come from the environment: ROBOSTRESS_TLS_CA, ROBOSTRESS_TLS_CERTIFICATE,
ROBOSTRESS_TLS_KEY, ROBOSTRESS_TOKEN_FILE. Exit code: 0 done, 1 refused or no server, 2 the command is wrong.)";

struct Request {
  std::string server = "127.0.0.1:50052", session, out;
  uint64_t version = 0;
  double grace_s = 0, timeout_s = 20;
  bool json = false;
};

// One operator's calls; every error is the server's, with its address.
class Operator {
 public:
  static absl::StatusOr<Operator> Connect(const Request& request) {
    RS_ASSIGN_OR_RETURN(const auto credentials, ChannelCredentialsFromEnvironment());
    return Operator(request, grpc::CreateChannel(request.server, credentials));
  }

  absl::Status List() const {
    v1::ListSessionsResponse response;
    RS_RETURN_IF_ERROR(Call(&v1::AdminService::Stub::ListSessions, {}, &response));
    if (request_.json) {
      nlohmann::ordered_json rows = nlohmann::json::array();
      for (const v1::SessionSummary& session : response.sessions()) rows.push_back(Row(session));
      std::printf("%s\n", rows.dump(2).c_str());
      return absl::OkStatus();
    }
    absl::PrintF("%-24s %-52s %-7s %8s %8s %9s %8s %9s\n", "session", "what it serves", "state",
                 "idle [s]", "chunks", "predicted", "updates", "distance");
    for (const v1::SessionSummary& session : response.sessions()) {
      absl::PrintF("%-24s %-52s %-7s %8.1f %8d %9d %8d %9.4g\n", session.session_id(),
                   What(session.spec()), State(session), session.idle_s(),
                   session.feedback_sequence(), session.predictions(), session.updates_applied(),
                   session.adapter_distance());
      if (!session.error().empty()) absl::PrintF("  %s\n", session.error());
    }
    absl::PrintF("%d sessions\n", response.sessions_size());
    return absl::OkStatus();
  }

  absl::Status Versions() const {
    v1::ListVersionsRequest list;
    list.set_session_id(request_.session);
    v1::ListVersionsResponse response;
    RS_RETURN_IF_ERROR(Call(&v1::AdminService::Stub::ListVersions, list, &response));
    if (request_.json) {
      nlohmann::ordered_json rows = nlohmann::json::array();
      for (const v1::AdapterVersion& version : response.versions()) {
        rows.push_back({{"version", version.version()},
                        {"published", version.published()},
                        {"pinned", version.pinned()},
                        {"distance", version.distance()},
                        {"feedback_sequence", version.feedback_sequence()},
                        {"loss", version.loss()}});
      }
      std::printf("%s\n", rows.dump(2).c_str());
      return absl::OkStatus();
    }
    absl::PrintF("%8s %8s %10s %10s\n", "version", "chunks", "distance", "loss");
    for (const v1::AdapterVersion& version : response.versions()) {
      absl::PrintF("%8d %8d %10.4g %10.4g%s%s\n", version.version(), version.feedback_sequence(),
                   version.distance(), version.loss(), version.published() ? "  published" : "",
                   version.version() == 0 ? "  always held"
                   : version.pinned()     ? "  pinned"
                                          : "");
    }
    return absl::OkStatus();
  }

  absl::Status Pin(bool pinned) const {
    v1::PinVersionRequest pin;
    pin.set_session_id(request_.session);
    pin.set_version(request_.version);
    pin.set_pinned(pinned);
    v1::PinVersionResponse response;
    return Call(&v1::AdminService::Stub::PinVersion, pin, &response);
  }

  absl::Status Export() const {
    v1::ExportVersionRequest wanted;
    wanted.set_session_id(request_.session);
    wanted.set_version(request_.version);
    v1::ExportVersionResponse response;
    RS_RETURN_IF_ERROR(Call(&v1::AdminService::Stub::ExportVersion, wanted, &response));
    RS_RETURN_IF_ERROR(WriteFileAtomically(request_.out, response.safetensors()));
    absl::PrintF("%s: %d bytes\n", request_.out, response.safetensors().size());
    return absl::OkStatus();
  }

  absl::Status Rollback() const {
    v1::RollbackSessionRequest back;
    back.set_session_id(request_.session);
    back.set_version(request_.version);
    v1::RollbackSessionResponse response;
    RS_RETURN_IF_ERROR(Call(&v1::AdminService::Stub::RollbackSession, back, &response));
    absl::PrintF("version %d is published\n", response.updates_applied());
    return absl::OkStatus();
  }

  absl::Status End() const {
    v1::EndSessionRequest end;
    end.set_session_id(request_.session);
    v1::EndSessionResponse response;
    return Call(&v1::AdminService::Stub::EndSession, end, &response);
  }

  absl::Status Drain() const {
    v1::DrainRequest drain;
    drain.set_grace_s(request_.grace_s);
    v1::DrainResponse response;
    return Call(&v1::AdminService::Stub::Drain, drain, &response);
  }

 private:
  Operator(const Request& request, const std::shared_ptr<grpc::Channel>& channel)
      : request_(request), stub_(v1::AdminService::NewStub(channel)) {}

  template <typename Message, typename Response>
  absl::Status Call(grpc::Status (v1::AdminService::Stub::*method)(grpc::ClientContext*,
                                                                   const Message&, Response*),
                    const Message& message, Response* response) const {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() +
                         std::chrono::duration_cast<std::chrono::system_clock::duration>(
                             std::chrono::duration<double>(request_.timeout_s)));
    const absl::Status status = FromGrpc((stub_.get()->*method)(&context, message, response));
    if (status.ok()) return status;
    return absl::Status(status.code(), absl::StrCat(request_.server, ": ", status.message()));
  }

  static std::string What(const v1::SessionSpec& spec) {
    return absl::StrCat(spec.robot(), " ", spec.suite(), " ", spec.scenario(), " L",
                        spec.severity(), " ", spec.policy(), " s", spec.seed());
  }
  static std::string State(const v1::SessionSummary& session) {
    if (!session.error().empty()) return "failed";
    return session.open() ? "open" : "on disk";
  }
  static nlohmann::ordered_json Row(const v1::SessionSummary& session) {
    return {{"session", session.session_id()},
            {"robot", session.spec().robot()},
            {"suite", session.spec().suite()},
            {"scenario", session.spec().scenario()},
            {"severity", session.spec().severity()},
            {"policy", session.spec().policy()},
            {"seed", session.spec().seed()},
            {"state", State(session)},
            {"idle_s", session.idle_s()},
            {"feedback_sequence", session.feedback_sequence()},
            {"predictions", session.predictions()},
            {"updates_applied", session.updates_applied()},
            {"adapter_distance", session.adapter_distance()},
            {"last_loss", session.last_loss()},
            {"error", session.error()}};
  }

  Request request_;
  std::unique_ptr<v1::AdminService::Stub> stub_;
};

absl::Status Run(const cli::App& app, const Request& request) {
  RS_ASSIGN_OR_RETURN(const Operator server, Operator::Connect(request));
  if (app.got_subcommand("list")) return server.List();
  if (app.got_subcommand("versions")) return server.Versions();
  if (app.got_subcommand("pin")) return server.Pin(true);
  if (app.got_subcommand("unpin")) return server.Pin(false);
  if (app.got_subcommand("export")) return server.Export();
  if (app.got_subcommand("rollback")) return server.Rollback();
  if (app.got_subcommand("end")) return server.End();
  return server.Drain();
}

int Main(int argc, char** argv) {
  Request request;
  cli::App app(
      "Lists a server's sessions and the adapters they published; exports, pins, rolls back.",
      "robostress sessions");
  app.footer(kExamples);
  app.require_subcommand(1);
  app.fallthrough();
  app.add_option("--server", request.server, "HOST:PORT of the server's --admin-listen")
      ->capture_default_str();
  app.add_option("--timeout", request.timeout_s, "for the answer [s]")
      ->capture_default_str()
      ->check(cli::Range(0.1, 3600.0));
  app.add_flag("--json", request.json, "list and versions as JSON");
  const auto command = [&](const char* name, const char* help, bool session, bool version) {
    cli::App* result = app.add_subcommand(name, help);
    if (session) result->add_option("SESSION", request.session, "as list prints it")->required();
    if (version)
      result->add_option("VERSION", request.version, "as versions prints it; 0: unadapted")
          ->required();
    return result;
  };
  command("list", "Sessions in memory and on disk", false, false);
  command("versions", "Adapters that a session published", true, false);
  command("pin", "Keep a version, whatever is published after it", true, true);
  command("unpin", "Take the pin away", true, true);
  command("export", "Write a version as a safetensors file", true, true)
      ->add_option("--out", request.out, "file to write")
      ->required();
  command("rollback", "Publish an earlier version again; what was learned since is forgotten", true,
          true);
  command("end", "End a session, on disk too", true, false);
  command("drain", "Refuse what is new, answer what is under way, write sessions, stop", false,
          false)
      ->add_option("--grace", request.grace_s, "for what is under way [s]; 0: the server's own")
      ->check(cli::Range(0.0, 3600.0));
  return RunMain(app, argc, argv, [&] { return Run(app, request); });
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
