#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/wire/web_url.h"
#include "server/proxy/relay.h"

namespace robostress {

// What the links of one relay share. All of it but the figures is of the relay's thread.
struct RelayLinks {
  RelayOptions options;
  WebUrl upstream;
  std::shared_ptr<SSL_CTX> upstream_tls;  // null: ws://
  Relay::MakeTap make;
  std::function<void(const std::string& why)> gone;              // nobody listens upstream
  std::function<void(std::chrono::milliseconds pause)> look_in;  // look after it there
  std::atomic<int> clients{0};                                   // links that live
  std::atomic<uint64_t> accepted{0}, refused{0}, upstream_lost{0};
};

// One client and its upstream connection: who may connect, the two handshakes, the messages, the
// ends. Every operation under way holds it, so `relay` outlives `io`.
class RelayLink {
 public:
  // `tls`: of the client's connection; null: plain.
  static std::shared_ptr<RelayLink> Start(RelayLinks& relay, boost::asio::io_context& io,
                                          boost::asio::ip::tcp::socket socket, std::string peer,
                                          const std::shared_ptr<SSL_CTX>& tls);
  virtual ~RelayLink() = default;

  // It has not sent its request.
  virtual bool silent() const = 0;
  // "Going away" (1001) to both ends.
  virtual void GoAway() = 0;
};

}  // namespace robostress
