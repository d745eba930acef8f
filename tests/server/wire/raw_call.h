#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <chrono>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"

namespace robostress {

// A call of any method as bytes, so that what no client of ours would send can be sent. One thread;
// ended by its destructor, as by a client that goes away.
class RawCall {
 public:
  RawCall(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
          const std::string& token = "",
          grpc_compression_algorithm compression = GRPC_COMPRESS_NONE)
      : stub_(channel) {
    context_.set_compression_algorithm(compression);
    if (!token.empty()) context_.AddMetadata("authorization", absl::StrCat("Bearer ", token));
    context_.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    call_ = stub_.PrepareCall(&context_, method, &queue_);
    call_->StartCall(Tag(1));
    Await(1);
  }
  ~RawCall() {
    context_.TryCancel();
    queue_.Shutdown();
    void* tag = nullptr;
    bool ok = false;
    while (queue_.Next(&tag, &ok)) {
    }
  }

  bool Write(const std::string& bytes) { return Write(grpc::Slice(bytes)); }
  bool Write(const grpc::Slice& slice) {
    call_->Write(grpc::ByteBuffer(&slice, 1), Tag(2));
    return Await(2);
  }
  void WritesDone() {
    call_->WritesDone(Tag(3));
    Await(3);
  }
  // Empty: the call has ended. A message of no bytes cannot be told from that.
  std::string Read() {
    grpc::ByteBuffer buffer;
    call_->Read(&buffer, Tag(4));
    if (!Await(4)) return "";
    grpc::Slice slice;
    if (!buffer.DumpToSingleSlice(&slice).ok()) return "";
    return {reinterpret_cast<const char*>(slice.begin()), slice.size()};
  }
  grpc::Status Finish() {
    grpc::Status status;
    call_->Finish(&status, Tag(5));
    Await(5);
    return status;
  }

 private:
  static void* Tag(uintptr_t n) { return reinterpret_cast<void*>(n); }
  bool Await(uintptr_t n) {
    void* tag = nullptr;
    bool ok = false;
    while (queue_.Next(&tag, &ok))
      if (tag == Tag(n)) return ok;
    return false;
  }

  grpc::GenericStub stub_;
  grpc::ClientContext context_;
  grpc::CompletionQueue queue_;
  std::unique_ptr<grpc::GenericClientAsyncReaderWriter> call_;
};

}  // namespace robostress
