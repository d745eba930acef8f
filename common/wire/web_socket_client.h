#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/client_secrets.h"

namespace robostress {

struct WebSocketOptions {
  ClientSecrets secrets;
  // "Authorization: SCHEME TOKEN": "Api-Key" for openpi's clients and servers, or "Bearer". A token
  // goes out under TLS, and to this machine itself.
  std::string token_scheme = "Api-Key";
  // For the address, the connection, TLS and the handshake together. A name that is looked up may
  // hold the client's end for longer.
  absl::Duration connect_timeout = absl::Seconds(10);
  absl::Duration send_timeout = absl::Seconds(30);  // until the peer has taken a message
  uint64_t max_message_bytes = 16 << 20;            // of what comes; the rest is not read
};

struct WebSocketMessage {
  bool text = false;  // else binary
  std::string bytes;
};

// A WebSocket client, of one thread. A thread of its own reads all the time, so that pings are
// answered while the caller computes. Errors name the address and what to do; after one the
// connection has ended, and every call returns it.
class WebSocketClient {
 public:
  // `url`: ParseWebUrl. UNAVAILABLE: nobody is there, or he speaks something else;
  // DEADLINE_EXCEEDED: not in time; UNAUTHENTICATED, PERMISSION_DENIED, NOT_FOUND: 401, 403, 404.
  static absl::StatusOr<std::unique_ptr<WebSocketClient>> Connect(
      const std::string& url, const WebSocketOptions& options = {});
  // Says goodbye (1000), and waits a second at most for the answer.
  ~WebSocketClient();

  // Sends one binary message; returns when the system has taken all of it.
  absl::Status Send(std::string message);
  // The next message. One that does not come within `limit` ends the connection: it would be taken
  // for the answer to the next question.
  absl::StatusOr<WebSocketMessage> Receive(absl::Duration limit);
  // Whether a message is there, or the end, before `limit` is over; it takes nothing and ends
  // nothing.
  bool Await(absl::Duration limit) const;
  // What has come already and nobody received; never waits.
  std::optional<WebSocketMessage> TakeUnread();

  const std::string& address() const;  // "ws://127.0.0.1:8000/"
  int close_code() const;              // the peer's; 0: it has not closed

 private:
  class Impl;
  explicit WebSocketClient(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
