#include "server/wire/grpc/grpc_call.h"

#include <gmock/gmock.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/notification.h"
#include "common/atomic_file.h"
#include "common/rollout/refusal.h"
#include "common/rpc/convert_sessions.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "tests/server/wire/raw_call.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr char kPredictPath[] = "/robostress.v1.PolicyService/Predict";

// A server whose Predict streams are answered by the test; every other method by nothing.
class GrpcCallTest : public ::testing::Test {
 protected:
  using Answer = std::function<absl::Status(const v1::PredictRequest& request,
                                            const std::function<bool()>& cancelled,
                                            v1::PredictResponse& response)>;

  void Start(const GrpcServiceOptions& options = {}, size_t largest = 1 << 20) {
    server_.reset();
    std::vector<GrpcMethod> methods;
    const auto* service = google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(
        "robostress.v1.PolicyService");
    for (int i = 0; i < service->method_count(); ++i) {
      GrpcMethod& method = methods.emplace_back();
      method.name = service->method(i)->name();
      method.largest_request = largest;
      method.executor = &executor_;
      method.answer = [](GrpcCallView&, const auto&, auto&) { return absl::OkStatus(); };
      if (method.name == "ImportAdapter") {
        method.at_once = 2;
        method.answer = [this](GrpcCallView&, const auto&, auto&) {
          imports_.WaitForNotification();
          return absl::OkStatus();
        };
      }
      if (method.name != "Predict") continue;
      method.streams = true;
      method.reads_ahead = [](const std::string& id) { return id == "async"; };
      method.answer = TypedAnswer<v1::PredictRequest, v1::PredictResponse>(
          [this](GrpcCallView& view, const v1::PredictRequest& request,
                 v1::PredictResponse& response) {
            if (request.session_id().empty()) return absl::InvalidArgumentError("no session");
            view.Serves(request.session_id());
            return answer_(
                request, [&view] { return view.cancelled(); }, response);
          });
      method.as_answer = [](const google::protobuf::Message& request, const absl::Status& status,
                            bool read_ahead, google::protobuf::Message& response) {
        if (!read_ahead && !IsRefusal(status)) return false;
        auto& refused = static_cast<v1::PredictResponse&>(response);
        refused.set_chunk(static_cast<const v1::PredictRequest&>(request).chunk());
        *refused.mutable_refusal() = ToRefusal(status);
        return true;
      };
    }
    service_ = std::make_unique<GrpcService>("robostress.v1.PolicyService", std::move(methods),
                                             options, tokens_, &metrics_);
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    LimitConnections(builder, {.calls = 1000});
    builder.SetMaxReceiveMessageSize(static_cast<int>(largest));
    builder.RegisterService(service_.get());
    server_ = builder.BuildAndStart();
    channel_ =
        grpc::CreateChannel(absl::StrCat("127.0.0.1:", port_), grpc::InsecureChannelCredentials());
    stub_ = v1::PolicyService::NewStub(channel_);
  }
  GrpcCallTest() { Start(); }
  ~GrpcCallTest() override {
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
  }

  static v1::PredictRequest Request(const std::string& session, uint32_t chunk) {
    v1::PredictRequest request;
    request.set_session_id(session);
    request.set_chunk(chunk);
    return request;
  }
  // True when no call is open any more.
  bool AwaitNoCalls() const {
    for (int i = 0; i < 2000 && service_->calls() > 0; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return service_->calls() == 0;
  }

  Answer answer_ = [](const v1::PredictRequest& request, const std::function<bool()>&,
                      v1::PredictResponse& response) {
    response.set_chunk(request.chunk());
    return absl::OkStatus();
  };
  absl::Notification imports_;  // are answered from then on
  const std::shared_ptr<TokenStore> tokens_ = std::make_shared<TokenStore>();
  Metrics metrics_;
  FairExecutor executor_{{.threads = 8, .per_client = 6, .per_session = 2}};
  std::unique_ptr<GrpcService> service_;
  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::PolicyService::Stub> stub_;
  grpc::ClientContext context_;
};

TEST_F(GrpcCallTest, ARefusalIsAnAnswerAndTheStreamGoesOn) {
  answer_ = [](const v1::PredictRequest& request, const std::function<bool()>&,
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

TEST_F(GrpcCallTest, AnErrorEndsTheStreamWithItsStatus) {
  answer_ = [](const v1::PredictRequest&, const std::function<bool()>&, v1::PredictResponse&) {
    return absl::ResourceExhaustedError("disk");
  };
  const auto stream = stub_->Predict(&context_);
  stream->Write(Request("lockstep", 0));
  v1::PredictResponse response;
  EXPECT_FALSE(stream->Read(&response));
  const grpc::Status status = stream->Finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(status.error_message(), "disk");
}

TEST_F(GrpcCallTest, OnAStreamThatIsReadAheadNewerObservationsReplaceThoseNotBegun) {
  absl::Notification begun;
  answer_ = [&begun](const v1::PredictRequest& request, const std::function<bool()>& cancelled,
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

TEST_F(GrpcCallTest, AClientThatGoesAwayCancelsItsPredictionAndTheHandlerEnds) {
  for (const char* session : {"lockstep", "async"}) {
    absl::Notification begun, ended;
    answer_ = [&](const v1::PredictRequest&, const std::function<bool()>& cancelled,
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

TEST_F(GrpcCallTest, ADamagedMessageEndsAStreamWithAnErrorAfterWhatCameBeforeIt) {
  for (const char* session : {"lockstep", "async"}) {
    RawCall call(channel_, kPredictPath);
    call.Write(Request(session, 7).SerializeAsString());
    EXPECT_EQ(call.Read().size(), v1::PredictResponse().SerializeAsString().size() + 2) << session;
    call.Write("\xff\xff\xff");
    const grpc::Status status = call.Finish();
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << session;
    EXPECT_THAT(status.error_message(),
                HasSubstr("3 bytes are not a robostress.v1.PredictRequest"));
  }
  RawCall unary(channel_, "/robostress.v1.PolicyService/GetStats");
  unary.Write("\xff\xff\xff");
  EXPECT_EQ(unary.Finish().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  RawCall empty(channel_, "/robostress.v1.PolicyService/GetStats");
  empty.WritesDone();
  EXPECT_EQ(empty.Finish().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(GrpcCallTest, AMessageLargerThanTheMethodNeedsIsRefusedWithBothSizes) {
  RawCall call(channel_, kPredictPath);
  call.Write(std::string((1 << 20) + 1, 'x'));
  EXPECT_EQ(call.Finish().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
}

int Threads() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.rfind("Threads:", 0) == 0) return std::stoi(line.substr(8));
  return -1;
}

TEST_F(GrpcCallTest, TwoHundredSilentStreamsCostNoThreadAndDelayNobody) {
  const int before = Threads();
  std::vector<std::unique_ptr<RawCall>> silent;
  for (int i = 0; i < 200; ++i) silent.push_back(std::make_unique<RawCall>(channel_, kPredictPath));
  for (int i = 0; i < 200; ++i) {  // half of them served something once
    if (i % 2 == 0) silent[i]->Write(Request(absl::StrCat("s", i), 1).SerializeAsString());
    if (i % 2 == 0) {
      EXPECT_FALSE(silent[i]->Read().empty());
    }
  }
  EXPECT_EQ(service_->calls(), 200);
  EXPECT_LE(Threads(), before + 8 + 4) << "the executor's, and gRPC's own";
  const auto stream = stub_->Predict(&context_);
  ASSERT_TRUE(stream->Write(Request("lockstep", 3)));
  v1::PredictResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.chunk(), 3u);
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
  silent.clear();
  EXPECT_TRUE(AwaitNoCalls());
}

TEST_F(GrpcCallTest, ACallOnWhichNothingComesIsEnded) {
  GrpcServiceOptions options;
  options.idle_timeout = absl::Milliseconds(300);
  options.message_timeout = absl::Milliseconds(100);
  Start(options);
  RawCall stream(channel_, kPredictPath), unary(channel_, "/robostress.v1.PolicyService/GetStats");
  stream.Write(Request("lockstep", 1).SerializeAsString());
  EXPECT_FALSE(stream.Read().empty());
  EXPECT_EQ(unary.Finish().error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  const grpc::Status status = stream.Finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_THAT(status.error_message(), HasSubstr("nothing came for 300ms"));
}

TEST_F(GrpcCallTest, AClientHasSoManyCallsAndNoMore) {
  GrpcServiceOptions options;
  options.calls_per_client = 3;
  Start(options);
  std::vector<std::unique_ptr<RawCall>> calls;
  for (int i = 0; i < 3; ++i) {
    calls.push_back(std::make_unique<RawCall>(channel_, kPredictPath));
    calls.back()->Write(Request("s", 1).SerializeAsString());
    EXPECT_FALSE(calls.back()->Read().empty());
  }
  RawCall fourth(channel_, kPredictPath);
  const grpc::Status status = fourth.Finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("--calls-per-client"));
  calls.clear();
  EXPECT_TRUE(AwaitNoCalls());
  RawCall again(channel_, kPredictPath);
  again.Write(Request("s", 1).SerializeAsString());
  EXPECT_FALSE(again.Read().empty());
}

double PeakMib() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.rfind("VmHWM:", 0) == 0) return std::stod(line.substr(7)) / 1024;
  return -1;
}

// gRPC itself would hold all of it before it compared it with the limit.
TEST_F(GrpcCallTest, AMessageThatIsTooLongIsNotHeldUntilItIsWhole) {
  const std::string bytes(size_t{200} << 20, 'x');
  [[maybe_unused]] const double before = PeakMib();
  for (int i = 0; i < 2; ++i) {
    RawCall call(channel_, kPredictPath);
    call.Write(bytes);
    EXPECT_EQ(call.Finish().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  }
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // which keep what was freed
  EXPECT_LT(PeakMib(), before + 200 + 150) << "the client's copy of it, and 50 ms of the loopback";
#endif
  RawCall well(channel_, kPredictPath);
  well.Write(Request("lockstep", 7).SerializeAsString());
  EXPECT_FALSE(well.Read().empty()) << "the connection goes on";
}

TEST_F(GrpcCallTest, APackedMessageIsRefusedBeforeItIsUnpacked) {
  const std::string bomb(size_t{100} << 20, '\0');  // 100 KiB on the wire
  const double before = PeakMib();
  RawCall call(channel_, kPredictPath, "", GRPC_COMPRESS_GZIP);
  call.Write(bomb);
  EXPECT_EQ(call.Finish().error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_LT(PeakMib(), before + 130) << "the client's copy";
}

TEST_F(GrpcCallTest, WhatAHandlerThrowsEndsItsCallAlone) {
  answer_ = [](const v1::PredictRequest& request, const std::function<bool()>&,
               v1::PredictResponse& response) -> absl::Status {
    if (request.chunk() == 1) throw std::bad_alloc();
    response.set_chunk(request.chunk());
    return absl::OkStatus();
  };
  RawCall thrown(channel_, kPredictPath), well(channel_, kPredictPath);
  thrown.Write(Request("lockstep", 1).SerializeAsString());
  EXPECT_EQ(thrown.Finish().error_code(), grpc::StatusCode::INTERNAL);
  well.Write(Request("lockstep", 2).SerializeAsString());
  EXPECT_FALSE(well.Read().empty());
}

// What a caller without a token sends is not read: the transport's window is all it can fill.
TEST_F(GrpcCallTest, RightsAreAskedForBeforeAMessageIsRead) {
  const auto tokens = AccessTokens::Parse(
      "t",
      absl::StrCat("tokens: [{name: arm, sha256: ", Sha256Hex("arm"), ", scopes: [predict]}]"));
  ASSERT_TRUE(tokens.ok()) << tokens.status();
  tokens_->Set(*tokens);
  for (const char* method : {"Predict", "OpenSession", "ImportAdapter", "GetServerInfo"}) {
    RawCall call(channel_, absl::StrCat("/robostress.v1.PolicyService/", method));
    EXPECT_EQ(call.Finish().error_code(), grpc::StatusCode::UNAUTHENTICATED)
        << method << ": answered before anything was sent";
  }
  RawCall scope(channel_, "/robostress.v1.PolicyService/ImportAdapter", "arm");
  EXPECT_EQ(scope.Finish().error_code(), grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(GrpcCallTest, AStreamOfATokenThatIsTakenBackEndsAtItsNextMessage) {
  const auto tokens = [](const char* name) {
    return *AccessTokens::Parse("t", absl::StrCat("tokens: [{name: ", name, ", sha256: ",
                                                  Sha256Hex(name), ", scopes: [predict]}]"));
  };
  tokens_->Set(tokens("arm"));
  RawCall call(channel_, kPredictPath, "arm");
  call.Write(Request("s", 1).SerializeAsString());
  EXPECT_FALSE(call.Read().empty());
  tokens_->Set(tokens("other"));
  call.Write(Request("s", 2).SerializeAsString());
  EXPECT_EQ(call.Finish().error_code(), grpc::StatusCode::UNAUTHENTICATED);
}

TEST_F(GrpcCallTest, AMethodIsAnsweredSoManyTimesAtOnceToOneClient) {
  constexpr char kImport[] = "/robostress.v1.PolicyService/ImportAdapter";
  tokens_->Set(*AccessTokens::Parse(
      "t", absl::StrCat("tokens: [{name: a, sha256: ", Sha256Hex("a"), ", scopes: [feedback]}, ",
                        "{name: b, sha256: ", Sha256Hex("b"), ", scopes: [feedback]}]")));
  const auto entered = [&](int calls) {
    for (int i = 0; i < 2000 && service_->calls() != calls; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return service_->calls() == calls;
  };
  RawCall first(channel_, kImport, "a"), second(channel_, kImport, "a");
  ASSERT_TRUE(entered(2));
  RawCall third(channel_, kImport, "a");
  const grpc::Status refused = third.Finish();
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(refused.error_message(), HasSubstr("ImportAdapter: 2 of this client are under way"));
  RawCall neighbour(channel_, kImport, "b");
  EXPECT_TRUE(entered(3)) << "another client has a count of its own";
  imports_.Notify();
  const auto succeeds = [](RawCall& call) {
    call.Write("");
    call.Read();
    return call.Finish().ok();
  };
  for (RawCall* call : {&first, &second, &neighbour}) EXPECT_TRUE(succeeds(*call));
  ASSERT_TRUE(AwaitNoCalls());
  RawCall again(channel_, kImport, "a");
  EXPECT_TRUE(succeeds(again));
}

TEST_F(GrpcCallTest, SaysWhichSessionsItsStreamsServe) {
  absl::Mutex mu;
  std::vector<std::string> events;
  GrpcServiceOptions options;
  options.attach = [&](const std::string& id) {
    absl::MutexLock lock(&mu);
    events.push_back("+" + id);
  };
  options.detach = [&](const std::string& id) {
    absl::MutexLock lock(&mu);
    events.push_back("-" + id);
  };
  Start(options);
  {
    RawCall call(channel_, kPredictPath);
    for (const char* session : {"a", "a", "b"}) {
      call.Write(Request(session, 1).SerializeAsString());
      EXPECT_FALSE(call.Read().empty());
    }
  }
  ASSERT_TRUE(AwaitNoCalls());
  absl::MutexLock lock(&mu);
  EXPECT_THAT(events, ::testing::ElementsAre("+a", "+b", "-a", "-b"));
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
