#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/operations/metrics.h"
#include "server/operations/tls_files.h"

namespace robostress {

// What a client asked for, as far as a page or an upgrade needs to know.
struct WebRequest {
  std::string path;                    // "/healthz", without the query
  std::string query;                   // after the '?'
  std::string authorization;           // the header's value; a secret, never to be logged
  std::string peer;                    // "127.0.0.1:51234"
  std::string certificate_owner = "";  // CertificateOwner of what the client showed (mTLS)
};

struct WebReply {
  int status = 200;
  std::string content_type = "text/plain; charset=utf-8";
  std::string body;
};
// An error in HTTP's terms: UNAUTHENTICATED 401, PERMISSION_DENIED 403, NOT_FOUND 404,
// RESOURCE_EXHAUSTED and UNAVAILABLE 503, INVALID_ARGUMENT 400, others 500.
WebReply ErrorReply(const absl::Status& status);

// One WebSocket client: greeted, then answered message by message, strictly in turn. Used by one
// thread at a time, each time perhaps by another one; all of it, its end included, may block.
class WebConversation {
 public:
  virtual ~WebConversation() = default;
  virtual std::string Greeting() = 0;
  // Bytes of the longest message that it takes now; asked before each.
  virtual uint64_t LargestMessage() const = 0;
  // Whose connection it is, for the bound on each client's; empty: its address says.
  virtual std::string client() const { return {}; }
  // `message` is one binary message. An error is sent as a text frame with its message, and closes
  // the conversation with 1011.
  virtual absl::StatusOr<std::string> Answer(std::string_view message) = 0;
};

struct WebServerOptions {
  std::string name = "web";  // of its threads and of its metrics' label "listener"
  std::string listen = "127.0.0.1:0";
  // What every new connection is opened with; null: plain.
  std::shared_ptr<const TlsStore> tls;
  // Each holds memory, and a worker while it is answered. What comes beyond them, or beyond a
  // client's share, gets one of kHealthPlaces, where only /healthz and /readyz are answered: a
  // probe is served by a server that is full. Others are answered 503.
  int max_connections = 256;
  static constexpr int kHealthPlaces = 8;
  // Of one client: by its address until it says who it is, then by WebConversation::client(). 0:
  // half of max_connections, so that no client keeps all others out.
  int max_connections_per_client = 0;
  // Threads that answer pages and messages, made when they are needed; one client gets three
  // quarters of them at most. What comes beyond waits, and nothing more is read of who sent it.
  int workers = 16;
  // Of a WebSocket message; longer ones close with 1009. 0: what the conversation takes.
  uint64_t max_message_bytes = 0;
  // Names by which browsers may ask for pages (but /healthz, /readyz) and WebSockets, besides
  // addresses, localhost and the host of `listen`; others are answered 421. A page of another site
  // whose name was made to resolve to this machine (DNS rebinding) bears that site's name.
  std::vector<std::string> allowed_hosts;
  // For the TLS and WebSocket handshakes, a request's header, and an answer to a page.
  absl::Duration request_timeout = absl::Seconds(30);
  // A WebSocket peer that neither sends, nor answers a ping, nor takes what is sent to it for this
  // long is cut off: half-open connections and readers that stopped reading.
  absl::Duration idle_timeout = absl::Seconds(60);
};

// HTTP/1.1 pages (GET and HEAD) and WebSockets on one port, with or without TLS. One thread reads,
// writes, encrypts and watches the time for all connections; workers answer. A browser's page from
// elsewhere (Origin other than Host) gets no WebSocket.
class WebServer {
 public:
  using Page = std::function<WebReply(const WebRequest&)>;
  // Null: plain HTTP only. A refusal is answered as ErrorReply.
  using Upgrade =
      std::function<absl::StatusOr<std::unique_ptr<WebConversation>>(const WebRequest&)>;

  // Both functions are called from several threads at once, and may block but for /healthz and
  // /readyz. `metrics` must outlive the server.
  static absl::StatusOr<std::unique_ptr<WebServer>> Start(const WebServerOptions& options,
                                                          Page page, Upgrade upgrade,
                                                          Metrics* metrics);
  ~WebServer();  // Stop with no grace

  int port() const;
  // Connections now.
  int connections() const;
  // Listens no more; answers that are under way are sent if they are ready within `grace`; says
  // "going away" (1001) to every WebSocket; joins.
  void Stop(absl::Duration grace);

 private:
  class Impl;
  explicit WebServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
