#pragma once

#include <google/protobuf/message.h>
#include <grpcpp/impl/codegen/server_callback_handlers.h>
#include <grpcpp/impl/codegen/service_type.h>
#include <grpcpp/support/byte_buffer.h>
#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "server/operations/access_table.h"
#include "server/operations/metrics.h"
#include "server/wire/fair_executor.h"
#include "server/wire/grpc/read_meter.h"

// gRPC calls in which waiting costs no thread, and nothing is read before its sender's rights.
//
// Every method, unary or not, is registered as a bidirectional stream of bytes: gRPC then hands a
// call over when its headers are there, before a message is read. What a caller shows is looked at
// first; a message is read, and its size compared with what the method needs, only afterwards.
namespace grpc {
class ServerBuilder;
}

namespace robostress {

class GrpcService;

// A call as a handler sees it. Of the thread that answers.
class GrpcCallView {
 public:
  virtual ~GrpcCallView() = default;
  virtual const Caller& caller() const = 0;
  virtual std::string peer() const = 0;
  // The client is gone, or a newer request replaced this one.
  virtual bool cancelled() const = 0;
  virtual void AddTrailingMetadata(const std::string& key, const std::string& value) = 0;
  // The stream serves this session from now on, until its end.
  virtual void Serves(const std::string& session_id) = 0;
};

// One method as a server answers it.
struct GrpcMethod {
  std::string name;  // "Predict"
  bool streams = false;
  size_t largest_request = 0;  // [bytes] longer ones are refused
  int at_once = 0;             // calls of one client; 0: as many as it may have calls
  FairExecutor* executor = nullptr;
  // One request. An error ends the call with its status, unless `as_answer` makes it an answer.
  std::function<absl::Status(GrpcCallView&, const google::protobuf::Message&,
                             google::protobuf::Message&)>
      answer;
  // Whether a stream whose first message names this session is read while it is answered: a request
  // that is followed by a newer one of its session is then not begun (ABORTED). Null: never.
  std::function<bool(const std::string& session_id)> reads_ahead;
  // Makes an error the response of a stream that goes on; false: the error ends it. Null: it does.
  std::function<bool(const google::protobuf::Message& request, const absl::Status& status,
                     bool read_ahead, google::protobuf::Message& response)>
      as_answer;
};

// `handler(view, request, response)` with the messages' own types.
template <class Request, class Response, class Handler>
auto TypedAnswer(Handler handler) {
  return [handler](GrpcCallView& view, const google::protobuf::Message& request,
                   google::protobuf::Message& response) -> absl::Status {
    return handler(view, static_cast<const Request&>(request), static_cast<Response&>(response));
  };
}

// Requests that a stream holds when it is read ahead.
inline constexpr size_t kReadAhead = 16;

struct GrpcServiceOptions {
  AccessRule::Wire wire = AccessRule::Wire::kPolicy;
  int calls_per_client = 1024;                         // open at a time
  absl::Duration message_timeout = absl::Seconds(30);  // for the message of a call that has one
  absl::Duration idle_timeout = absl::Minutes(15);     // of a stream on which nothing comes or goes
  // When a call that served a session begins to, and ends. Null: nobody asks.
  std::function<void(const std::string&session_id)> attach, detach;
};

// The calls of one service of the schema. Any thread.
class GrpcService : public grpc::Service {
 public:
  // `full_name`: "robostress.v1.PolicyService", whose every method must be in `methods`;
  // RS_CHECKed. What is pointed to outlives the server that it is registered with.
  GrpcService(const std::string& full_name, std::vector<GrpcMethod> methods,
              const GrpcServiceOptions& options, std::shared_ptr<const TokenStore> tokens,
              Metrics* metrics);
  ~GrpcService() override;

  int calls() const ABSL_LOCKS_EXCLUDED(mu_);
  int calls_per_client() const { return options_.calls_per_client; }
  size_t largest_request() const;  // of all methods [bytes]

 private:
  class Call;
  struct Registered;

  grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* Begin(
      const Registered* method, grpc::CallbackServerContext* context);
  // Counts a call of a client.
  absl::Status Enter(const std::shared_ptr<Call>& call, const std::string& client,
                     const GrpcMethod& method) ABSL_LOCKS_EXCLUDED(mu_);
  void Leave(const Call* call, const std::string& client, const GrpcMethod& method)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Ends calls on which nothing happens, and those that bring too much.
  void Watch() ABSL_LOCKS_EXCLUDED(mu_);

  const GrpcServiceOptions options_;
  const std::shared_ptr<const TokenStore> tokens_;
  const std::shared_ptr<Gauge> open_calls_;
  const std::shared_ptr<Counter> refused_, idled_;
  std::vector<std::unique_ptr<Registered>> methods_;
  ReadMeter meter_;

  mutable absl::Mutex mu_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  std::unordered_map<const Call*, std::weak_ptr<Call>> calls_ ABSL_GUARDED_BY(mu_);
  std::unordered_map<std::string, int> clients_ ABSL_GUARDED_BY(mu_);
  std::map<std::pair<std::string, std::string>, int> methods_of_clients_ ABSL_GUARDED_BY(mu_);
  std::thread watcher_;
};

// Of every connection of a server.
struct GrpcConnectionLimits {
  int calls = 1024;  // open at a time
  // A peer that sent nothing for `ping_after` is pinged, and cut when it does not answer for
  // `ping_timeout`: that finds half-open connections.
  absl::Duration ping_after = absl::Seconds(30), ping_timeout = absl::Seconds(20);
  absl::Duration idle = absl::Minutes(15);       // without a call
  absl::Duration handshake = absl::Seconds(20);  // until it speaks HTTP/2
};
void LimitConnections(grpc::ServerBuilder& builder, const GrpcConnectionLimits& limits);

}  // namespace robostress
