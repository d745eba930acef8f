#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/wire/openpi_value.h"
#include "common/wire/web_socket_client.h"

namespace robostress {

struct OpenpiConnectionOptions {
  WebSocketOptions socket;
  absl::Duration metadata_timeout = absl::Seconds(30);
  absl::Duration silence = absl::Seconds(5);  // then the log says what the server may be
};

// A client's side of openpi's wire: the server's metadata, then an answer for each message. One
// thread. After an error the connection is finished; connect again.
class OpenpiConnection {
 public:
  // Returns with the metadata. Errors as WebSocketClient::Connect's; INTERNAL with the server's
  // words where it sends text.
  static absl::StatusOr<std::unique_ptr<OpenpiConnection>> Connect(
      const std::string& url, const OpenpiConnectionOptions& options = {});

  // A map; empty from most servers. Valid as long as the connection.
  const OpenpiValue& metadata() const { return metadata_; }
  const std::string& address() const { return socket_->address(); }
  // The bytes that answer a message (WriteOpenpiObservation); DecodeOpenpiValue reads them.
  // DEADLINE_EXCEEDED after `limit`; INTERNAL where the server has sent what nobody asked for, so
  // that its answers can no longer be told apart.
  absl::StatusOr<std::string> Ask(std::string message, absl::Duration limit);

 private:
  explicit OpenpiConnection(std::unique_ptr<WebSocketClient> socket) : socket_(std::move(socket)) {}
  absl::StatusOr<std::string> Receive(absl::Duration limit);

  const std::unique_ptr<WebSocketClient> socket_;
  std::string metadata_bytes_;
  OpenpiValue metadata_;  // of those bytes
};

}  // namespace robostress
