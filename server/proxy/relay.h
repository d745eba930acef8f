#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "common/client_secrets.h"
#include "server/operations/access_tokens.h"
#include "server/operations/tls_files.h"

namespace robostress {

// What looks on while one client talks with the server. Of the relay's thread; it waits for
// nothing. What it throws ends nothing: the message goes on as it is.
class RelayTap {
 public:
  virtual ~RelayTap() = default;
  virtual void FromClient(std::string_view message, bool text) = 0;
  // What the client gets instead, of the same kind; nothing: the message itself.
  virtual std::optional<std::string> FromServer(std::string_view message, bool text) = 0;
  // FromClient or FromServer threw this.
  virtual void Threw(const std::string& words) = 0;
};

struct RelayOptions {
  std::string listen = "127.0.0.1:8001";
  std::string upstream;                // ws:// or wss://
  std::shared_ptr<TlsStore> tls;       // of the own port; null: plain
  std::shared_ptr<TokenStore> tokens;  // null: everybody may come, and his token goes on
  // For the upstream: whom it trusts and what it shows; the token where the client brings none, or
  // where it was for the own port.
  ClientSecrets secrets;
  std::string token_scheme = "Api-Key";
  int max_clients = 64;
  uint64_t max_message_bytes = uint64_t{64} << 20;
  absl::Duration connect_timeout = absl::Seconds(30);  // for the whole upstream handshake
  // A client that answers no ping, and reads and sends nothing, is cut after this; the upstream,
  // which may compile its network, after the other.
  absl::Duration client_idle = absl::Minutes(2), upstream_idle = absl::Minutes(10);
  absl::Duration probe_period = absl::Seconds(1);
};

struct RelayFigures {
  bool upstream_there = false;
  int clients = 0;
  uint64_t accepted = 0, refused = 0, upstream_lost = 0;
};

// Carries WebSockets between clients and a server: every message, text or binary, as the bytes that
// it was, close codes, pings, the path and its query, `Authorization`, a sub-protocol, and the
// server's refusal of a handshake. Each client has an upstream connection of its own, which lives
// and dies with it. While nobody listens upstream nobody listens here: a client that dials is
// refused, as by its own server, and waits as for that one. One thread.
class Relay {
 public:
  using MakeTap = std::function<std::unique_ptr<RelayTap>(const std::string& peer)>;

  // UNAVAILABLE: cannot bind `listen`; INVALID_ARGUMENT: addresses, secrets. The upstream need not
  // be there. `make` is called on the relay's thread for every client that is let in; null: none.
  static absl::StatusOr<std::unique_ptr<Relay>> Start(const RelayOptions& options, MakeTap make);
  // Every client is told "going away" (1001).
  ~Relay();

  int port() const;
  RelayFigures figures() const;

 private:
  class Impl;
  explicit Relay(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
