#include "server/predict_stream.h"

#include <grpcpp/grpcpp.h>
#include <pthread.h>

#include <algorithm>
#include <deque>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "common/rpc/convert.h"
#include "common/rpc/grpc_status.h"
#include "common/rpc/refusal.h"
#include "proto/robostress/v1/policy.grpc.pb.h"

namespace robostress {
namespace {

using Stream = grpc::ServerReaderWriter<v1::PredictResponse, v1::PredictRequest>;

v1::PredictResponse RefusedResponse(const v1::PredictRequest& request, const absl::Status& status) {
  v1::PredictResponse response;
  response.set_chunk(request.chunk());
  *response.mutable_refusal() = ToRefusal(status);
  return response;
}

absl::Status ReplacedError() {
  return Refusal(
      absl::AbortedError("a newer observation of the session came before this one was computed"));
}

// The requests that were read and not answered yet.
class Inbox {
 public:
  // Waits for room.
  void Push(v1::PredictRequest request) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    const auto room = [this] {
      mu_.AssertHeld();
      return waiting_.size() < kReadAhead || closed_;
    };
    mu_.Await(absl::Condition(&room));
    if (!closed_) waiting_.push_back(std::move(request));
  }
  // No more comes.
  void Close() ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    closed_ = true;
  }
  // False: nothing more comes.
  bool Pop(v1::PredictRequest& request) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    const auto ready = [this] {
      mu_.AssertHeld();
      return !waiting_.empty() || closed_;
    };
    mu_.Await(absl::Condition(&ready));
    if (waiting_.empty()) return false;
    request = std::move(waiting_.front());
    waiting_.pop_front();
    return true;
  }
  // Whether a newer request of the session waits behind.
  bool HasNewer(const std::string& session_id) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    return std::any_of(waiting_.begin(), waiting_.end(), [&](const v1::PredictRequest& request) {
      return request.session_id() == session_id;
    });
  }

 private:
  absl::Mutex mu_;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
  std::deque<v1::PredictRequest> waiting_ ABSL_GUARDED_BY(mu_);
};

// Answers what the inbox holds until it is closed and empty, or the client is gone.
void AnswerInbox(grpc::ServerContext* context, Stream* stream, const PredictHandlers& handlers,
                 Inbox& inbox) {
  pthread_setname_np(pthread_self(), "answer");
  v1::PredictRequest request;
  while (inbox.Pop(request)) {
    const auto replaced = [&] { return inbox.HasNewer(request.session_id()); };
    v1::PredictResponse response;
    absl::Status status;
    if (replaced()) {
      status = ReplacedError();
    } else {
      status = handlers.answer(
          request, [&] { return context->IsCancelled() || replaced(); }, response);
      if (absl::IsCancelled(status) && !context->IsCancelled() && replaced())
        status = ReplacedError();
    }
    if (!status.ok()) response = RefusedResponse(request, status);
    if (!stream->Write(response)) break;
  }
  inbox.Close();
}

grpc::Status ReadAhead(grpc::ServerContext* context, Stream* stream,
                       const PredictHandlers& handlers, v1::PredictRequest request) {
  Inbox inbox;
  std::thread answering([&] { AnswerInbox(context, stream, handlers, inbox); });
  do {
    inbox.Push(std::move(request));
  } while (stream->Read(&request));
  inbox.Close();
  answering.join();
  return grpc::Status::OK;
}

}  // namespace

grpc::Status ServePredictStream(grpc::ServerContext* context, Stream* stream,
                                const PredictHandlers& handlers) {
  v1::PredictRequest request;
  if (!stream->Read(&request)) return grpc::Status::OK;
  if (handlers.reads_ahead(request.session_id()))
    return ReadAhead(context, stream, handlers, std::move(request));
  do {
    v1::PredictResponse response;
    const absl::Status status = handlers.answer(
        request, [context] { return context->IsCancelled(); }, response);
    if (IsRefusal(status)) {
      response = RefusedResponse(request, status);
    } else if (!status.ok()) {
      return ToGrpc(status);
    }
    if (!stream->Write(response)) break;
  } while (stream->Read(&request));
  return grpc::Status::OK;
}

}  // namespace robostress
