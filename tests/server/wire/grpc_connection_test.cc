// Limits of a gRPC connection, seen by a client that knows HTTP/2's frames (RFC 9113) by their
// bytes, with shortened times.
#include <grpcpp/generic/async_generic_service.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>

#include "server/wire/grpc/grpc_call.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using SteadyClock = std::chrono::steady_clock;

class GrpcConnectionTest : public ::testing::Test {
 protected:
  enum Type { kSettings = 4, kPing = 6, kGoAway = 7 };
  static constexpr char kAck = 1;
  struct Frame {
    int type = -1;  // -1: the connection ended
    char flags = 0;
    std::string payload;
  };

  void Start(const GrpcConnectionLimits& limits) {
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    LimitConnections(builder, limits);
    builder.RegisterCallbackGenericService(&service_);
    server_ = builder.BuildAndStart();
    ASSERT_NE(server_, nullptr);
    begin_ = SteadyClock::now();
    client_ = std::make_unique<WebClient>(port);
  }
  ~GrpcConnectionTest() override {
    if (server_ != nullptr) server_->Shutdown(std::chrono::system_clock::now());
  }

  void Send(Type type, char flags, const std::string& payload) {
    std::string bytes(9, '\0');  // size in 24 bits, type, flags, stream 0
    bytes[2] = static_cast<char>(payload.size());
    bytes[3] = static_cast<char>(type);
    bytes[4] = flags;
    client_->Send(bytes + payload);
  }
  void SayHello() {
    client_->Send("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n");
    Send(kSettings, 0, "");
  }
  Frame Read() {
    const std::string head = client_->Receive(9);
    if (head.size() < 9) return {};
    const auto byte = [&head](size_t i) { return static_cast<uint8_t>(head[i]); };
    const size_t size = static_cast<size_t>(byte(0)) << 16 | static_cast<size_t>(byte(1)) << 8 |
                        static_cast<size_t>(byte(2));
    return {byte(3), head[4], client_->Receive(size)};
  }
  double Elapsed() const {
    return std::chrono::duration<double>(SteadyClock::now() - begin_).count();
  }

  grpc::CallbackGenericService service_;  // answers that nothing is implemented
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<WebClient> client_;
  SteadyClock::time_point begin_;
};

constexpr absl::Duration kShort = absl::Milliseconds(300);

TEST_F(GrpcConnectionTest, CutsAPeerThatDoesNotAnswerAPing) {
  Start({.ping_after = kShort, .ping_timeout = kShort});
  SayHello();
  int pings = 0;
  for (Frame frame = Read(); frame.type != -1; frame = Read()) pings += frame.type == kPing;
  EXPECT_GE(pings, 1);
  EXPECT_GE(Elapsed(), 0.55) << "before the time that it has to answer";
  EXPECT_LT(Elapsed(), 15) << "the client's own limit";
}

TEST_F(GrpcConnectionTest, KeepsAPeerThatIsSilentButAnswersPings) {
  Start({.ping_after = kShort, .ping_timeout = kShort});
  SayHello();
  int pings = 0;
  while (pings < 4) {
    const Frame frame = Read();
    ASSERT_NE(frame.type, -1) << "cut after " << pings << " pings";
    if (frame.type != kPing || (frame.flags & kAck) != 0) continue;
    Send(kPing, kAck, frame.payload);
    ++pings;
  }
  EXPECT_GE(Elapsed(), 1.1) << "longer than a silent one lives";
}

TEST_F(GrpcConnectionTest, EndsAConnectionWithoutCalls) {
  Start({.idle = kShort});
  SayHello();
  bool goodbye = false;
  for (Frame frame = Read(); frame.type != -1; frame = Read()) {
    goodbye |= frame.type == kGoAway;
    // Told to go, it is asked whether it has understood.
    if (frame.type == kPing && (frame.flags & kAck) == 0) Send(kPing, kAck, frame.payload);
  }
  EXPECT_TRUE(goodbye);
  EXPECT_GE(Elapsed(), 0.25);
  EXPECT_LT(Elapsed(), 15);
}

TEST_F(GrpcConnectionTest, EndsAConnectionThatNeverSpeaks) {
  Start({.handshake = kShort});
  while (Read().type != -1) {
  }
  EXPECT_GE(Elapsed(), 0.25);
  EXPECT_LT(Elapsed(), 15);
}

}  // namespace
}  // namespace robostress
