#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <functional>

#include "server/edge/web_server.h"

namespace robostress {

// One accepted connection: the TLS handshake, HTTP requests, and a WebSocket if one is asked for.
// It lives on one thread with an I/O context of its own, so that every step can have a deadline and
// code stays in a line.
class WebConnection {
 public:
  // Whether one more connection of this client has a place; called when it says who it is.
  using Claim = std::function<absl::Status(const std::string& client)>;

  // What is passed must outlive the connection. `health_only`: it stands in one of the places for
  // probes.
  WebConnection(const WebServerOptions& options, const WebServer::Page& page,
                const WebServer::Upgrade& upgrade, bool health_only)
      : options_(options), page_(page), upgrade_(upgrade), health_only_(health_only) {}

  // Until the connection ends. Takes `descriptor`.
  void Serve(boost::asio::ip::tcp protocol, int descriptor, Claim claim);
  // Any thread: end after the answer that is under way.
  void GoAway();
  // Any thread: end now; what is being computed is not sent.
  void Cut();

 private:
  absl::Duration request_timeout() const;
  template <class Stream>
  void ServeHttp(Stream& stream);
  template <class Request>
  bool Asks(const Request& request, WebRequest& seen, WebReply& refusal);
  template <class Stream, class Request>
  void ServeWebSocket(Stream& stream, const Request& request,
                      std::unique_ptr<WebConversation> conversation);
  // Starts an asynchronous operation and waits for its end.
  template <class Start>
  boost::system::error_code Run(Start&& start);

  const WebServerOptions& options_;
  const WebServer::Page& page_;
  const WebServer::Upgrade& upgrade_;
  const bool health_only_;
  boost::asio::io_context context_{1};
  Claim claim_;
  std::string peer_, certificate_owner_;
  // Of this connection's thread; GoAway and Cut post to it.
  bool going_away_ = false, cut_ = false;
  std::function<void()> go_away_;  // how the step under way is told
  std::function<void()> cut_stream_;
};

}  // namespace robostress
