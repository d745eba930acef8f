#include "server/predict_stream.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/notification.h"
#include "common/rpc/convert.h"
#include "common/rpc/refusal.h"
#include "proto/robostress/v1/policy.grpc.pb.h"

namespace robostress {
namespace {

// A server whose Predict streams are answered by the test.
class PredictStreamTest : public ::testing::Test, public v1::PolicyService::Service {
 protected:
  PredictStreamTest() {
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
    stub_ = v1::PolicyService::NewStub(
        grpc::CreateChannel(absl::StrCat("127.0.0.1:", port), grpc::InsecureChannelCredentials()));
    handlers_.reads_ahead = [](const std::string& id) { return id == "async"; };
  }
  ~PredictStreamTest() override {
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
  }

  grpc::Status Predict(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::PredictResponse, v1::PredictRequest>* stream) override {
    return ServePredictStream(context, stream, handlers_);
  }

  static v1::PredictRequest Request(const std::string& session, uint32_t chunk) {
    v1::PredictRequest request;
    request.set_session_id(session);
    request.set_chunk(chunk);
    return request;
  }

  PredictHandlers handlers_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<v1::PolicyService::Stub> stub_;
  grpc::ClientContext context_;
};

TEST_F(PredictStreamTest, ARefusalIsAnAnswerAndTheStreamGoesOn) {
  handlers_.answer = [](const v1::PredictRequest& request, const std::function<bool()>&,
                        v1::PredictResponse& response) -> absl::Status {
    if (request.chunk() == 0) return OverloadedError("full", absl::Milliseconds(40));
    response.set_chunk(request.chunk());
    return absl::OkStatus();
  };
  const auto stream = stub_->Predict(&context_);
  v1::PredictResponse response;
  ASSERT_TRUE(stream->Write(Request("lockstep", 0)));
  ASSERT_TRUE(stream->Read(&response));
  ASSERT_TRUE(response.has_refusal());
  const absl::Status refusal = ToStatus(response.refusal());
  EXPECT_TRUE(absl::IsResourceExhausted(refusal)) << refusal;
  EXPECT_EQ(RetryAfter(refusal), absl::Milliseconds(40));
  ASSERT_TRUE(stream->Write(Request("lockstep", 1)));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_FALSE(response.has_refusal());
  EXPECT_EQ(response.chunk(), 1u);
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

TEST_F(PredictStreamTest, AnErrorEndsTheStreamWithItsStatus) {
  handlers_.answer = [](const v1::PredictRequest&, const std::function<bool()>&,
                        v1::PredictResponse&) { return absl::ResourceExhaustedError("disk"); };
  const auto stream = stub_->Predict(&context_);
  stream->Write(Request("lockstep", 0));
  v1::PredictResponse response;
  EXPECT_FALSE(stream->Read(&response));
  const grpc::Status status = stream->Finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(status.error_message(), "disk");
}

TEST_F(PredictStreamTest, OnAStreamThatIsReadAheadNewerObservationsReplaceThoseNotBegun) {
  absl::Notification begun;
  handlers_.answer = [&begun](const v1::PredictRequest& request,
                              const std::function<bool()>& cancelled,
                              v1::PredictResponse& response) -> absl::Status {
    if (request.chunk() == 0) {  // waits in the queue until it is replaced
      begun.Notify();
      while (!cancelled()) std::this_thread::yield();
      return absl::CancelledError("gone");
    }
    if (request.chunk() == 3) return absl::InvalidArgumentError("proprioception");
    response.set_chunk(request.chunk());
    return absl::OkStatus();
  };
  const auto stream = stub_->Predict(&context_);
  ASSERT_TRUE(stream->Write(Request("async", 0)));
  begun.WaitForNotification();
  ASSERT_TRUE(stream->Write(Request("async", 1)));
  v1::PredictResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.chunk(), 0u);
  EXPECT_TRUE(absl::IsAborted(ToStatus(response.refusal())));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.chunk(), 1u);
  EXPECT_FALSE(response.has_refusal());
  for (const auto& [chunk, invalid] : {std::pair(3, true), std::pair(4, false)}) {
    ASSERT_TRUE(stream->Write(Request("async", static_cast<uint32_t>(chunk))));
    ASSERT_TRUE(stream->Read(&response));
    EXPECT_EQ(response.chunk(), static_cast<uint32_t>(chunk));
    EXPECT_EQ(response.refusal().code(), invalid ? 3 : 0);  // the stream survives the error
  }
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

TEST_F(PredictStreamTest, AClientThatGoesAwayCancelsItsPredictionAndTheHandlerEnds) {
  for (const char* session : {"lockstep", "async"}) {
    absl::Notification begun, ended;
    handlers_.answer = [&](const v1::PredictRequest&, const std::function<bool()>& cancelled,
                           v1::PredictResponse&) -> absl::Status {
      begun.Notify();
      while (!cancelled()) std::this_thread::yield();
      ended.Notify();
      return absl::CancelledError("gone");
    };
    grpc::ClientContext context;
    const auto stream = stub_->Predict(&context);
    stream->Write(Request(session, 0));
    begun.WaitForNotification();
    context.TryCancel();
    ended.WaitForNotification();
    EXPECT_FALSE(stream->Finish().ok());
  }
}

TEST(Refusal, KeepsCodeMessageAndTimeOverTheWireAndRefusesNonsense) {
  const absl::Status sent = OverloadedError("256 wait", absl::Milliseconds(1500));
  const absl::Status received = ToStatus(ToRefusal(sent));
  EXPECT_EQ(received.code(), sent.code());
  EXPECT_EQ(received.message(), sent.message());
  EXPECT_EQ(RetryAfter(received), absl::Milliseconds(1500));
  EXPECT_TRUE(IsRefusal(received));
  EXPECT_FALSE(IsRefusal(absl::ResourceExhaustedError("disk")));
  v1::Refusal nonsense;
  for (const int code : {0, -1, 17}) {
    nonsense.set_code(code);
    EXPECT_TRUE(absl::IsInvalidArgument(ToStatus(nonsense))) << code;
  }
}

}  // namespace
}  // namespace robostress
