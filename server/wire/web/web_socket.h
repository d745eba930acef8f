#pragma once

#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <boost/beast/websocket/stream_fwd.hpp>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/functional/any_invocable.h"
#include "absl/status/statusor.h"
#include "common/wire/web_stream.h"
#include "server/wire/web/web_server.h"
#include "server/wire/web/web_work.h"

namespace robostress {

// A WebSocket from its handshake to its end: greeting, then a message, its answer, the next
// message. Nothing is read while a message is answered, so that a client has one message here at a
// time, and only the answer takes a worker. Of the I/O thread, but for the conversation, which is
// the workers'.
class WebSocketSession {
 public:
  // An opened conversation with what a worker asked it.
  struct Opened {
    std::shared_ptr<WebConversation> conversation;
    std::string client, greeting;
    uint64_t largest_message = 0;  // [bytes] that is taken now
  };

  // `peer`: for the log. `owner` holds the session; each of its operations holds `owner`.
  WebSocketSession(const WebServices& services, WebStream stream, Opened opened, std::string peer,
                   std::weak_ptr<void> owner);
  ~WebSocketSession();

  // Answers the handshake, and goes on until the connection ends.
  void Start(boost::beast::http::request<boost::beast::http::string_body> request);
  // End after the answer that is under way.
  void GoAway();

 private:
  using Socket = boost::beast::websocket::stream<WebStream, true>;
  using Error = boost::system::error_code;
  struct Answered;

  std::shared_ptr<void> Hold() const { return owner_.lock(); }
  void LimitIdle(bool limit);
  void Read();
  void OnRead(Error error);
  void OnAnswered(Answered answered);
  // `then` runs when all of it is sent; what does not go out within the idle limit cuts.
  void Send(std::string message, absl::AnyInvocable<void()> then);
  void Close(const boost::beast::websocket::close_reason& reason);

  const WebServices& services_;
  WebStream stream_;  // the socket's
  Opened opened_;
  const std::string peer_;
  const std::weak_ptr<void> owner_;
  std::unique_ptr<Socket> socket_;
  boost::asio::steady_timer send_limit_;
  boost::beast::flat_buffer buffer_;  // the message that is read or answered
  std::string sending_;
  bool reading_ = false, closing_ = false, going_away_ = false;
};

}  // namespace robostress
