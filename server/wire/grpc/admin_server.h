#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/operations/access_tokens.h"
#include "server/operations/tls_files.h"
#include "server/sessions/session_registry.h"

namespace grpc {
class Server;
class ServerCredentials;
}  // namespace grpc

namespace robostress {

class FairExecutor;
class GrpcService;
class Metrics;

struct AdminServerOptions {
  std::string listen = "127.0.0.1:0";  // HOST:PORT, apart from robots' and workers'
  std::shared_ptr<TlsStore> tls;       // null: plain
  // Drain was asked for, with this grace (zero: the server's own). Called once, from a handler: it
  // must not wait.
  std::function<void(absl::Duration grace)> drain;
};

// AdminService (policy.proto) on a port of its own. Every call needs the scope `admin`.
class AdminServer {
 public:
  // `registry` and `metrics` must outlive it.
  static absl::StatusOr<std::unique_ptr<AdminServer>> Start(
      const AdminServerOptions& options, SessionRegistry* registry,
      std::shared_ptr<const TokenStore> tokens, Metrics* metrics);
  ~AdminServer();  // ends calls under way, joins

  int port() const { return port_; }

 private:
  class Service;
  AdminServer();

  std::unique_ptr<FairExecutor> executor_;
  std::unique_ptr<Service> service_;
  std::unique_ptr<GrpcService> grpc_;
  std::shared_ptr<grpc::ServerCredentials> credentials_;  // outlives the server
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
};

}  // namespace robostress
