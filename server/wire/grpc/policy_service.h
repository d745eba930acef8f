#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "common/rpc/grpc_status.h"
#include "server/inference/adaptation.h"
#include "server/operations/access_tokens.h"
#include "server/operations/metrics.h"
#include "server/operations/tls_files.h"
#include "server/policies/policy.h"
#include "server/sessions/registry_host.h"
#include "server/sessions/session_registry.h"

namespace grpc {
class Server;
class ServerCredentials;
}  // namespace grpc

namespace robostress {

class GrpcService;

struct PolicyServerOptions {
  std::string listen = "127.0.0.1:0";  // HOST:PORT; port 0: any free one
  int threads = 2;    // batches of predictions computed at once, and as many threads for updates
  int max_batch = 8;  // predictions of one batch; 1: none is batched
  absl::Duration batch_window = absl::ZeroDuration();  // BatcherOptions
  int queue_capacity = 256;  // predictions that wait; more are refused with a time to come back
  // Updates yield to predictions (server/inference/update_pacer.h): cores that both share, 0: all;
  // the share of one core that all updates keep meanwhile; what is added to the nice value of the
  // threads on which async sessions learn.
  int cores = 0;
  double update_share = 0.1;
  int update_nice = 5;
  Metrics* metrics = nullptr;  // outlives the server; null: it has its own
  int max_sessions = 64;
  // When max_sessions are open, the one unused for longest makes room if it was unused this long:
  // its client was killed, or it has ended without closing.
  absl::Duration abandoned_after = absl::Minutes(15);
  // Durable sessions (server/sessions/session_registry.h); empty: in memory only.
  std::string state_dir;
  absl::Duration expire_after = absl::InfiniteDuration();
  int max_stored_sessions = 4096;    // in memory and on disk together
  uint64_t snapshot_mib = 64;        // a snapshot is due after so much of a session's journal
  uint64_t snapshot_records = 1024;  // or so many records
  bool sync_predictions = false;     // predictions survive a loss of power
  GuardOptions guard;                // of sessions that ask for none
  MethodCaps caps;                   // what a session's adaptation may cost
  absl::Duration lockstep_timeout = absl::Seconds(120);
  // A simulation's prediction that has waited this long goes like a real arm's.
  absl::Duration starvation_limit = absl::Seconds(2);
  int max_message_mib = kMaxMessageBytes >> 20;  // of gRPC, in both directions
  int kept_traces = 256;                         // predictions whose spans /traces shows
  // Of the prefix keys and values that all sessions keep for learning
  // (server/inference/prefix_store.h).
  int64_t prefix_budget_mib = PrefixStore::kDefaultBudgetBytes >> 20;
  int max_view_side = 0;          // [px] of any view; 0: what each policy takes
  bool warm_up = true;            // predict once with every policy before health says SERVING
  std::shared_ptr<TlsStore> tls;  // null: plain
  // Asked by every call; never null.
  std::shared_ptr<TokenStore> tokens = std::make_shared<TokenStore>();
  // gRPC calls that one client may have open; 0: 4 a session and 64 more.
  int calls_per_client = 0;
  absl::Duration stream_idle = absl::Minutes(15);  // then a stream on which nothing goes is ended
  // For the message of a call that is no stream.
  absl::Duration message_timeout = absl::Seconds(30);
};

// A policy service over gRPC with health and reflection. Start listens, health says NOT_SERVING,
// the policies are warmed up, health says SERVING, Start returns.
class PolicyServer {
 public:
  // `policies` are served by their spec().name.
  static absl::StatusOr<std::unique_ptr<PolicyServer>> Start(
      const PolicyServerOptions& options, std::vector<std::shared_ptr<const FlowPolicy>> policies);
  ~PolicyServer();  // Stop with no grace

  int port() const { return port_; }
  // For what stands beside the service: operators, metrics.
  SessionRegistry& sessions();
  RegistryHost& host();
  Metrics& metrics();
  TraceLog& traces();
  Telemetry& telemetry();
  std::shared_ptr<const TokenStore> tokens() const;
  // Warmed up and not draining.
  bool ready() const { return ready_; }
  // Refuses new sessions and messages; health says NOT_SERVING. Any thread; returns at once.
  void Drain();
  // Refuses new sessions and messages, answers those under way for at most `grace`, writes durable
  // sessions to disk, cancels the rest, joins.
  void Stop(absl::Duration grace);

 private:
  class Service;
  PolicyServer();

  std::unique_ptr<Service> service_;
  std::unique_ptr<GrpcService> grpc_;
  std::shared_ptr<grpc::ServerCredentials> credentials_;  // outlives the server
  std::unique_ptr<grpc::Server> server_;
  std::atomic<bool> ready_{false};
  int port_ = 0;
};

}  // namespace robostress
