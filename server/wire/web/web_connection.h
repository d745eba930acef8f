#pragma once

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/string_body.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "common/wire/web_stream.h"
#include "server/wire/web/web_server.h"
#include "server/wire/web/web_socket.h"
#include "server/wire/web/web_work.h"

namespace robostress {

// One accepted connection: the TLS handshake, HTTP requests, and a WebSocket if one is asked for.
// Every step is an asynchronous operation with a limit in time that holds the connection; it ends
// when none is left. Of the I/O thread.
class WebConnection : public std::enable_shared_from_this<WebConnection> {
 public:
  // Whether one more connection of this client has a place; called when it says who it is.
  using Claim = std::function<absl::Status(const std::string& client)>;
  struct Place {
    std::string address;       // of the peer, without its port
    bool health_only = false;  // one of the places for probes
    Claim claim;
    // The place itself: let go of when connection and conversation have ended.
    std::shared_ptr<void> lease;
  };

  // `peer`: "127.0.0.1:51234".
  WebConnection(const WebServices& services, WebStream stream, std::string peer, Place place);
  ~WebConnection() { stream_.Close(); }

  void Start();
  // End after the answer that is under way.
  void GoAway();
  // End now; what is being computed is not sent.
  void Cut() { stream_.Close(); }

 private:
  using Error = boost::system::error_code;
  using Request = boost::beast::http::request<boost::beast::http::string_body>;
  using Response = boost::beast::http::response<boost::beast::http::string_body>;
  struct Upgraded;

  absl::Duration request_timeout() const;
  void Read();
  void OnRequest(Error error);
  // An answer that needs no page; none: `seen` is to be answered, by an upgrade if `upgrades`.
  std::optional<WebReply> Refuse(const Request& request, WebRequest& seen, bool& upgrades) const;
  void AnswerPage(WebRequest seen);
  void Upgrade(WebRequest seen);
  void OnUpgraded(Upgraded upgraded);
  void Reply(WebReply reply);

  const Place place_;  // first: it goes last
  const WebServices& services_;
  WebStream stream_;
  const std::string peer_;
  std::string certificate_owner_;
  boost::beast::flat_buffer buffer_;
  std::optional<boost::beast::http::request_parser<boost::beast::http::string_body>> parser_;
  std::optional<Response> response_;
  bool keep_alive_ = false, head_only_ = false;  // of the request that is answered
  bool waiting_ = false, going_away_ = false;    // for the peer, that is: no request is under way
  std::unique_ptr<WebSocketSession> socket_;
};

}  // namespace robostress
