// proxy_overhead [CHUNKS]: what a proxy adds to an answer. One client asks a server directly and
// through a relay with everything on, in turns, with LIBERO's two views of 224 x 224; the server
// answers at once. Prints p50 and p99 of both and of the difference of each pair.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>

#include "common/image.h"
#include "common/statistics.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/web_socket_client.h"
#include "server/proxy/proxy_board.h"
#include "server/proxy/relay.h"
#include "tests/server/proxy/proxy_policy.h"

namespace robostress {
namespace {

double Ask(WebSocketClient& client, const std::string& message) {
  const auto begin = std::chrono::steady_clock::now();
  if (!client.Send(message).ok() || !client.Receive(absl::Seconds(10)).ok()) std::abort();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
      .count();
}

void Say(const char* what, std::vector<double> ms) {
  std::sort(ms.begin(), ms.end());
  std::printf("%-12s p50 %.3f ms  p99 %.3f ms\n", what, Quantile(ms, 0.5), Quantile(ms, 0.99));
}

int Main(int chunks) {
  const Upstream upstream(LeadToGoal);
  Metrics metrics;
  const ArmProfile profile = LiberoProfile();
  ProxyBoard board(profile, *MethodOf(profile), false, &metrics, nullptr);
  RelayOptions options;
  options.listen = "127.0.0.1:0";
  options.upstream = upstream.url();
  const auto relay =
      Relay::Start(options, [&board](const std::string& peer) { return board.Tap(peer); });
  if (!relay.ok()) return 1;
  while (!(*relay)->figures().upstream_there)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  auto direct = WebSocketClient::Connect(upstream.url());
  auto proxied = WebSocketClient::Connect(absl::StrCat("ws://127.0.0.1:", (*relay)->port()));
  if (!direct.ok() || !proxied.ok() || !(*direct)->Receive(absl::Seconds(10)).ok() ||
      !(*proxied)->Receive(absl::Seconds(10)).ok())
    return 1;
  Observation seen;
  seen.instruction = "do something";
  for (int i = 0; i < 2; ++i) {
    Image view{224, 224, std::vector<uint8_t>(3 * 224 * 224)};
    for (size_t k = 0; k < view.data.size(); ++k) view.data[k] = static_cast<uint8_t>(7 * k);
    seen.views.push_back({"view", std::move(view)});
  }
  std::vector<double> of_direct, of_proxied, difference;
  for (int i = 0; i < chunks; ++i) {
    seen.proprioception = Eigen::VectorXf::Zero(8);
    seen.proprioception[0] = 1e-3f * static_cast<float>(std::abs(i % 100 - 50));  // no jump
    const std::string message = *WriteOpenpiObservation(seen, *OpenpiDialectNamed("libero"));
    of_direct.push_back(Ask(**direct, message));
    of_proxied.push_back(Ask(**proxied, message));
    difference.push_back(of_proxied.back() - of_direct.back());
  }
  Say("direct", of_direct);
  Say("proxied", of_proxied);
  Say("difference", difference);
  std::printf("the proxy's own work p50 %.3f ms p99 %.3f ms; %d chunks\n",
              1e3 * QuantileOf(board.held(), 0.5), 1e3 * QuantileOf(board.held(), 0.99), chunks);
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc > 1 ? std::atoi(argv[1]) : 1000); }
