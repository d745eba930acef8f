#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "common/rpc/grpc_status.h"

namespace robostress {

// The client's end of a bidirectional stream with a deadline on every message, which gRPC's
// synchronous streams lack. One thread. A read is always outstanding; after an error the stream is
// dead and says why again on every call.
template <class Request, class Response>
class DeadlineStream {
 public:
  using Clock = std::chrono::system_clock;
  using Call = grpc::ClientAsyncReaderWriter<Request, Response>;

  // start(context, queue) prepares the call, e.g. stub.PrepareAsyncPredict(context, queue). `name`
  // and `peer` name the stream in errors.
  template <class Prepare>
  DeadlineStream(std::string name, std::string peer, Prepare prepare)
      : name_(std::move(name)), peer_(std::move(peer)), call_(prepare(&context_, &queue_)) {
    call_->StartCall(Tag(kStart));
    pending_ |= kStart;
  }

  ~DeadlineStream() {
    context_.TryCancel();
    Drain();
    queue_.Shutdown();
    void* tag = nullptr;
    bool ok = false;
    while (queue_.Next(&tag, &ok)) {
    }
  }
  DeadlineStream(const DeadlineStream&) = delete;
  DeadlineStream& operator=(const DeadlineStream&) = delete;

  // Returns when the transport has taken the message.
  absl::Status Write(const Request& request, Clock::time_point deadline) {
    if (!dead_.ok()) return dead_;
    if (absl::Status status = AwaitStart(deadline); !status.ok()) return status;
    call_->Write(request, Tag(kWrite));
    pending_ |= kWrite;
    return Await(kWrite, deadline);
  }

  // The next message.
  absl::Status Read(Response& response, Clock::time_point deadline) {
    if (!dead_.ok()) return dead_;
    if (absl::Status status = AwaitStart(deadline); !status.ok()) return status;
    while (!have_message_) {
      if (absl::Status status = Await(kRead, deadline); !status.ok()) return status;
    }
    response = std::move(message_);
    have_message_ = false;
    StartRead();
    return absl::OkStatus();
  }

  // True when a message is there without waiting; a dead stream is reported by the next Read.
  bool Poll() {
    if (!dead_.ok() || have_message_) return true;
    if ((pending_ & kStart) || pending_ == 0) return false;
    const bool idle = PumpOnce(Clock::now()) == Pumped::kTimeout;
    return !idle && (!dead_.ok() || have_message_);
  }

 private:
  enum Operation : unsigned { kStart = 1, kWrite = 2, kRead = 4, kFinish = 8 };
  enum class Pumped { kEvent, kTimeout };

  static void* Tag(Operation operation) {
    return reinterpret_cast<void*>(static_cast<uintptr_t>(operation));
  }

  void StartRead() {
    call_->Read(&message_, Tag(kRead));
    pending_ |= kRead;
  }

  absl::Status AwaitStart(Clock::time_point deadline) {
    if (absl::Status status = Await(kStart, deadline); !status.ok()) return status;
    if (!(pending_ & kRead) && !have_message_) StartRead();
    return absl::OkStatus();
  }

  absl::Status Await(Operation operation, Clock::time_point deadline) {
    while (pending_ & operation) {
      if (PumpOnce(deadline) == Pumped::kTimeout) {
        dead_ = absl::DeadlineExceededError(
            absl::StrCat("the policy server at ", peer_, " did not answer on the ", name_,
                         " stream in time; it may hang or be overloaded: look at "
                         "its output and start it again"));
        context_.TryCancel();
        return dead_;
      }
      if (!dead_.ok()) return dead_;
    }
    return dead_;
  }

  // Takes one event from the queue; a failed operation kills the stream with the server's status.
  Pumped PumpOnce(Clock::time_point deadline) {
    void* tag = nullptr;
    bool ok = false;
    if (queue_.AsyncNext(&tag, &ok, deadline) != grpc::CompletionQueue::GOT_EVENT)
      return Pumped::kTimeout;
    const auto operation = static_cast<Operation>(reinterpret_cast<uintptr_t>(tag));
    pending_ &= ~static_cast<unsigned>(operation);
    if (operation == kRead && ok) have_message_ = true;
    if (!ok && operation != kFinish && dead_.ok()) dead_ = FinishStatus();
    return Pumped::kEvent;
  }

  // Why the stream ended.
  absl::Status FinishStatus() {
    dead_ = absl::CancelledError("the stream ended");  // stops recursion from PumpOnce
    Drain();
    grpc::Status status;
    call_->Finish(&status, Tag(kFinish));
    pending_ |= kFinish;
    const Clock::time_point deadline = Clock::now() + std::chrono::seconds(10);
    while (pending_ & kFinish) {
      if (PumpOnce(deadline) == Pumped::kTimeout) {
        context_.TryCancel();
        Drain();
      }
    }
    if (status.ok())
      return absl::UnavailableError(
          absl::StrCat("the policy server at ", peer_, " closed the ", name_, " stream"));
    if (status.error_code() == grpc::StatusCode::UNAVAILABLE) {
      return absl::UnavailableError(
          absl::StrCat("lost the policy server at ", peer_, " (", status.error_message(),
                       "); start it again with `robostress serve` and repeat the command: "
                       "what is finished is kept"));
    }
    return FromGrpc(status);
  }

  // Waits for what is outstanding; cancelled or failed operations return at once.
  void Drain() {
    while (pending_ != 0) {
      if (PumpOnce(Clock::now() + std::chrono::seconds(10)) == Pumped::kTimeout)
        context_.TryCancel();
    }
  }

  const std::string name_, peer_;
  grpc::ClientContext context_;
  grpc::CompletionQueue queue_;
  std::unique_ptr<Call> call_;
  unsigned pending_ = 0;  // operations whose tag is not back yet
  bool have_message_ = false;
  Response message_;
  absl::Status dead_;
};

}  // namespace robostress
