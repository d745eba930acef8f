#pragma once

#include <grpcpp/support/sync_stream.h>

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "proto/robostress/v1/policy.pb.h"

namespace grpc {
class ServerContext;
class Status;
}  // namespace grpc

namespace robostress {

// What answers the messages of Predict streams.
struct PredictHandlers {
  // Of a session in async mode: its stream is read ahead.
  std::function<bool(const std::string& session_id)> reads_ahead;
  // Any thread. `cancelled` is asked while the prediction waits.
  std::function<absl::Status(const v1::PredictRequest& request,
                             const std::function<bool()>& cancelled, v1::PredictResponse& response)>
      answer;
};

// Serves one Predict stream to its end: one response per request, in order.
//
// A refusal (common/rpc/refusal.h) is a response, and the stream goes on. Any other error ends the
// stream with its status. Where the first message's session is read ahead, the stream is read while
// predictions are computed: a request that a newer one of its session follows is refused with
// ABORTED as long as its computation has not begun, errors are responses too, and reading stops at
// kReadAhead messages.
inline constexpr size_t kReadAhead = 16;
grpc::Status ServePredictStream(
    grpc::ServerContext* context,
    grpc::ServerReaderWriter<v1::PredictResponse, v1::PredictRequest>* stream,
    const PredictHandlers& handlers);

}  // namespace robostress
