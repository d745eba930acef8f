// What a prediction costs beside its computation, over gRPC and over openpi's WebSocket, for one
// observation of openpi's LIBERO client: two 224 x 224 views, 8 numbers, a prompt (301 kB).
//   wire_benchmark [--rounds 1000]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/policy_client.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_dialect.h"
#include "server/sessions/read_spec.h"
#include "server/web_endpoints.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;

// The fake policy with two cameras: what it computes takes about a tenth of a millisecond.
class SeeingPolicy : public FakePolicy {
 public:
  SeeingPolicy() : spec_(FakePolicy::spec()) {
    spec_.cameras = {"agentview", "wrist"};
    spec_.image_width = spec_.image_height = 224;
    spec_.state_dim = 8;
    spec_.horizon = kHorizon;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    Observation state = observation;
    state.proprioception = observation.proprioception.head(kState);
    state.views.clear();
    return FakePolicy::Encode(state);
  }

 private:
  PolicySpec spec_;
};

void Print(const char* wire, std::vector<double> ms, size_t bytes_out, size_t bytes_in) {
  std::sort(ms.begin(), ms.end());
  const auto at = [&ms](double q) {
    return ms[static_cast<size_t>(q * static_cast<double>(ms.size() - 1))];
  };
  std::printf("%-22s %8zu %8zu %8.3f %8.3f %8.3f\n", wire, bytes_out, bytes_in, at(0.5), at(0.9),
              at(0.99));
}

double Milliseconds(Clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

int Run(int rounds) {
  const auto policy = std::make_shared<SeeingPolicy>();
  auto server = PolicyServer::Start({}, {policy});
  if (!server.ok()) return std::fprintf(stderr, "%s\n", server.status().ToString().c_str()), 1;
  WebEndpointsOptions web_options;
  web_options.websocket_listen = "127.0.0.1:0";
  web_options.openpi.session = Spec("base");
  web_options.openpi.session.mode = ExecutionMode::kAsync;
  auto web = WebEndpoints::Start(web_options, server->get());
  if (!web.ok()) return std::fprintf(stderr, "%s\n", web.status().ToString().c_str()), 1;

  Observation observation;
  observation.instruction = "put the bowl on the plate";
  for (const char* camera : {"agentview", "wrist"}) {
    Image image{224, 224, std::vector<uint8_t>(3 * 224 * 224)};
    for (size_t i = 0; i < image.data.size(); ++i) image.data[i] = static_cast<uint8_t>(i * 7 / 3);
    observation.views.push_back({camera, image});
  }
  observation.proprioception = Eigen::VectorXf::LinSpaced(8, 0, 1);
  std::printf("%-22s %8s %8s %8s %8s %8s\n", "wire", "B out", "B in", "p50 ms", "p90 ms", "p99 ms");

  // The session itself, without a wire.
  std::vector<double> direct, grpc_ms, websocket_ms;
  const auto opened = (*server)->host().Open(Anybody(), web_options.openpi.session);
  if (!opened.ok()) return 1;
  const auto session = (*server)->host().Use(Anybody(), opened->id);
  if (!session.ok() || !(*session)->StartEpisode({0, 0}, 0).ok()) return 1;
  const auto shared = std::make_shared<const Observation>(observation);
  PolicyClientOptions address;
  address.address = absl::StrCat("127.0.0.1:", (*server)->port());
  auto client = GrpcPolicyClient::Connect(address, RequestOf(web_options.openpi.session));
  if (!client.ok() || !(*client)->StartEpisode({0, 0}).ok()) return 1;
  auto socket =
      OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", (*web)->websocket_port()));
  const auto message = WriteOpenpiObservation(observation, *OpenpiDialectNamed("libero"));
  if (!socket.ok() || !message.ok()) return 1;
  size_t reply_bytes = 0;
  // In turn, so that what else the machine does falls on all three alike.
  for (int i = 0; i < rounds; ++i) {
    Clock::time_point begin = Clock::now();
    if (!(*session)->Predict(shared, {{0, 0}, i}, 0, {}, begin).ok()) return 1;
    direct.push_back(Milliseconds(begin));
    begin = Clock::now();
    if (!(*client)->Predict(observation, i).ok()) return 1;
    grpc_ms.push_back(Milliseconds(begin));
    begin = Clock::now();
    const auto reply = (*socket)->Ask(*message, absl::Seconds(30));
    websocket_ms.push_back(Milliseconds(begin));
    if (!reply.ok()) return std::fprintf(stderr, "%s\n", reply.status().ToString().c_str()), 1;
    reply_bytes = reply->size();
  }
  v1::PredictRequest request;
  *request.mutable_observation() = ToProto(observation);
  PredictedChunk shape;
  shape.actions = shape.policy_actions = Eigen::MatrixXf::Zero(FakePolicy::kHorizon, 7);
  Print("none (session alone)", direct, 0, 0);
  Print("gRPC", grpc_ms, request.ByteSizeLong(), ToProto(shape, 0).ByteSizeLong());
  Print("openpi WebSocket", websocket_ms, message->size(), reply_bytes);
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Run(argc > 2 ? std::atoi(argv[2]) : 1000); }
