#include "server/proxy/relay_link.h"

#include <spdlog/spdlog.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <exception>
#include <optional>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/wire/web_stream.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using Tcp = net::ip::tcp;
using Error = boost::system::error_code;
using ClientSocket = websocket::stream<WebStream, true>;
using ServerSocket = websocket::stream<WebStream, false>;

constexpr size_t kMaskedBytes = 64 << 10;  // at a time, of what goes upstream
constexpr size_t kReadAheadBytes = 4096;   // beyond the longest message
constexpr auto kHandshake = std::chrono::seconds(30), kGoodbye = std::chrono::seconds(2);
constexpr char kNoBrowsers[] = "a browser's page may not open a WebSocket here\n";

std::string Text(const boost::string_view& view) { return {view.data(), view.size()}; }

// What may stand in a close frame; others are not said.
websocket::close_reason Passed(const websocket::close_reason& reason) {
  const auto code = static_cast<unsigned>(reason.code);
  const bool sayable =
      (code >= 1000 && code <= 1014 && code != 1004 && code != 1005 && code != 1006) ||
      (code >= 3000 && code <= 4999);
  return sayable ? reason : websocket::close_reason();
}

class Link : public RelayLink, public std::enable_shared_from_this<Link> {
 public:
  Link(RelayLinks& relay, net::io_context& io, Tcp::socket socket, std::string peer,
       const std::shared_ptr<SSL_CTX>& tls)
      : relay_(relay),
        options_(relay.options),
        peer_(std::move(peer)),
        client_stream_(WebStream::Of(std::move(socket), tls)),
        resolver_(io),
        upstream_tcp_(io),
        limit_(io) {
    ++relay_.clients;
  }
  ~Link() override {
    Cut();
    --relay_.clients;
  }

  void Begin() {
    client_stream_.ExpireAfter(absl::FromChrono(kHandshake));
    client_stream_.Handshake([this, self = shared_from_this()](Error error) {
      if (error) return;
      parser_.body_limit(4096);
      http::async_read(client_stream_, http_buffer_, parser_,
                       [this, self](Error failed, size_t) { OnRequest(failed); });
    });
  }

  bool silent() const override { return !asked_ && !closing_; }
  void GoAway() override {
    const websocket::close_reason going(websocket::close_code::going_away);
    if (!open_) return Cut();
    CloseUpstream(going);
    CloseClient(going);
  }

 private:
  // The handshakes.

  void OnRequest(Error error) {
    if (error) return;
    asked_ = true;
    const auto& request = parser_.get();
    if (!websocket::is_upgrade(request)) {
      const bool health = request.target() == "/healthz";
      return Refuse(health ? 200 : 426, health ? "OK\n" : "a policy's WebSocket is served here\n");
    }
    if (!request[http::field::origin].empty()) return Refuse(403, kNoBrowsers);
    authorization_ = Text(request[http::field::authorization]);
    if (options_.tokens != nullptr) {
      const absl::Status known = options_.tokens->Get()->Check(authorization_, Scope::kPredict);
      if (!known.ok())
        return Refuse(absl::IsPermissionDenied(known) ? 403 : 401,
                      absl::StrCat(known.message(), "\n"));
      authorization_.clear();  // it was for this port
    }
    Dial();
  }

  void Refuse(unsigned status, const std::string& body, const std::string& type = "text/plain") {
    if (status != 200) ++relay_.refused;
    response_.emplace(static_cast<http::status>(status), 11);
    response_->set(http::field::content_type, type);
    if (status == 401) response_->set(http::field::www_authenticate, "Api-Key");
    if (status == 426) response_->set(http::field::upgrade, "websocket");
    response_->keep_alive(false);
    response_->body() = body;
    response_->prepare_payload();
    http::async_write(client_stream_, *response_, [this, self = shared_from_this()](Error, size_t) {
      client_stream_.ShutdownSend();
    });
  }

  void Dial() {
    limit_.expires_after(absl::ToChronoMilliseconds(options_.connect_timeout));
    limit_.async_wait([this, weak = weak_from_this()](Error error) {
      const auto self = weak.lock();
      if (error || self == nullptr || open_) return;
      Lost("not open within the limit", false);
    });
    resolver_.async_resolve(
        relay_.upstream.host, absl::StrCat(relay_.upstream.port),
        [this, self = shared_from_this()](Error error, const Tcp::resolver::results_type& found) {
          if (error) return Lost(error.message(), true);
          net::async_connect(upstream_tcp_, found,
                             [this, self](Error failed, const Tcp::endpoint&) {
                               if (failed) return Lost(failed.message(), true);
                               Error ignored;
                               upstream_tcp_.set_option(Tcp::no_delay(true), ignored);
                               Secure();
                             });
        });
  }

  void Secure() {
    Error error;
    const bool loopback = upstream_tcp_.remote_endpoint(error).address().is_loopback();
    upstream_stream_.emplace(
        WebStream::To(std::move(upstream_tcp_), relay_.upstream_tls, relay_.upstream.host));
    if (authorization_.empty() && !options_.secrets.token.empty()) {
      if (!relay_.upstream.tls && !loopback) {
        spdlog::error("proxy: {}: without TLS the token is readable on the way; use wss://",
                      relay_.upstream.text());
        return Refuse(502, "the proxy's token goes out under TLS only\n");
      }
      authorization_ = absl::StrCat(options_.token_scheme, " ", options_.secrets.token);
    }
    upstream_stream_->ExpireAfter(absl::InfiniteDuration());  // `limit_` is the limit
    upstream_stream_->Handshake([this, self = shared_from_this()](Error failed) {
      if (closing_) return;
      if (!failed) return ShakeUpstream();
      const std::string why = upstream_stream_->certificate_error();
      spdlog::error("proxy: {}: TLS: {}; trust what signed its certificate with ROBOSTRESS_TLS_CA",
                    relay_.upstream.text(), why.empty() ? failed.message() : why);
      Refuse(502, "the policy server's certificate is not trusted\n");
    });
  }

  void ShakeUpstream() {
    const auto& request = parser_.get();
    upstream_.emplace(*upstream_stream_);
    websocket::stream_base::timeout timeout{};
    timeout.handshake_timeout = kHandshake;
    timeout.idle_timeout = absl::ToChronoMilliseconds(options_.upstream_idle);
    timeout.keep_alive_pings = true;
    upstream_->set_option(timeout);
    const std::string protocol = Text(request[http::field::sec_websocket_protocol]),
                      agent = Text(request[http::field::user_agent]);
    upstream_->set_option(websocket::stream_base::decorator(
        [protocol, agent, authorization = authorization_](websocket::request_type& out) {
          if (!agent.empty()) out.set(http::field::user_agent, agent);
          if (!protocol.empty()) out.set(http::field::sec_websocket_protocol, protocol);
          if (!authorization.empty()) out.set(http::field::authorization, authorization);
        }));
    std::string target = Text(request.target());
    if (relay_.upstream.target != "/") target = relay_.upstream.target;
    upstream_->async_handshake(upstream_response_, relay_.upstream.authority(), target,
                               [this, self = shared_from_this()](Error error) {
                                 limit_.cancel();
                                 if (error == websocket::error::upgrade_declined) {
                                   return Refuse(
                                       upstream_response_.result_int(), upstream_response_.body(),
                                       Text(upstream_response_[http::field::content_type]));
                                 }
                                 if (error) return Lost(error.message(), false);
                                 AcceptClient();
                               });
  }

  void AcceptClient() {
    client_stream_.ExpireAfter(absl::InfiniteDuration());  // the WebSocket has limits of its own
    client_.emplace(client_stream_);
    websocket::stream_base::timeout timeout{};
    timeout.handshake_timeout = kHandshake;
    timeout.idle_timeout = absl::ToChronoMilliseconds(options_.client_idle);
    timeout.keep_alive_pings = true;
    client_->set_option(timeout);
    const std::string protocol = Text(upstream_response_[http::field::sec_websocket_protocol]);
    client_->set_option(
        websocket::stream_base::decorator([protocol](websocket::response_type& out) {
          if (!protocol.empty()) out.set(http::field::sec_websocket_protocol, protocol);
        }));
    SetUp(*client_);
    SetUp(*upstream_);
    upstream_->write_buffer_bytes(kMaskedBytes);
    client_->async_accept(parser_.get(), [this, self = shared_from_this()](Error error) {
      if (error) return Cut();
      if (relay_.make) tap_ = relay_.make(peer_);
      open_ = true;
      ++relay_.accepted;
      PassControl(*client_, *upstream_, pinging_upstream_,
                  [this](const websocket::close_reason& reason) { CloseUpstream(reason); });
      PassControl(*upstream_, *client_, pinging_client_,
                  [this](const websocket::close_reason& reason) { CloseClient(reason); });
      ReadClient();
      ReadUpstream();
    });
  }

  template <class Socket>
  void SetUp(Socket& socket) {
    socket.auto_fragment(false);
    socket.read_message_max(options_.max_message_bytes);
  }
  // A ping is answered here, and goes on as well: whether the other end lives is seen there. A
  // close goes on when it comes, not when its sender has let go of the connection.
  template <class From, class To, class CloseOther>
  void PassControl(From& from, To& to, bool& pinging, CloseOther close_other) {
    from.control_callback([this, &from, &to, &pinging, close_other](websocket::frame_type kind,
                                                                    beast::string_view payload) {
      if (closing_) return;
      if (kind == websocket::frame_type::close) return close_other(from.reason());
      if (kind != websocket::frame_type::ping || pinging) return;
      pinging = true;
      to.async_ping(websocket::ping_data(payload.data(), payload.size()),
                    [&pinging, self = shared_from_this()](Error) { pinging = false; });
    });
  }

  // Messages.

  void ReadClient() {
    from_client_.max_size(options_.max_message_bytes + kReadAheadBytes);
    client_->async_read(from_client_, [this, self = shared_from_this()](Error error, size_t) {
      if (error) return ClientEnded(error);
      const bool text = client_->got_text();
      const std::string_view message(static_cast<const char*>(from_client_.data().data()),
                                     from_client_.size());
      Tapped([&] { tap_->FromClient(message, text); });
      upstream_->text(text);
      upstream_->async_write(from_client_.data(), [this, self](Error failed, size_t) {
        if (failed) return UpstreamEnded(failed);
        Clear(from_client_);
        ReadClient();
      });
    });
  }

  void ReadUpstream() {
    from_upstream_.max_size(options_.max_message_bytes + kReadAheadBytes);
    upstream_->async_read(from_upstream_, [this, self = shared_from_this()](Error error, size_t) {
      if (error) return UpstreamEnded(error);
      const bool text = upstream_->got_text();
      const std::string_view message(static_cast<const char*>(from_upstream_.data().data()),
                                     from_upstream_.size());
      replaced_.reset();
      Tapped([&] { replaced_ = tap_->FromServer(message, text); });
      client_->text(text);
      const std::string_view passed = replaced_ ? std::string_view(*replaced_) : message;
      client_->async_write(net::const_buffer(passed.data(), passed.size()),
                           [this, self](Error failed, size_t) {
                             if (failed) return ClientEnded(failed);
                             Clear(from_upstream_);
                             ReadUpstream();
                           });
    });
  }

  // The largest message of a connection is seldom its usual one.
  static void Clear(beast::flat_buffer& buffer) {
    constexpr size_t kKept = size_t{4} << 20;
    buffer.clear();
    if (buffer.capacity() > kKept) buffer.shrink_to_fit();
  }

  template <class Look>
  void Tapped(const Look& look) {
    if (tap_ == nullptr) return;
    try {
      look();
    } catch (const std::exception& failed) {
      replaced_.reset();
      tap_->Threw(failed.what());
    }
  }

  // Ends: each is passed on as what it was.

  void ClientEnded(Error error) {
    client_over_ = true;
    if (closing_) return CutWhenOver();
    if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow) {
      spdlog::warn("proxy: {} sends a message of more than {} bytes", peer_,
                   options_.max_message_bytes);
      return CloseUpstream(websocket::close_code::going_away);
    }
    Cut();
  }

  void UpstreamEnded(Error error) {
    upstream_over_ = true;
    if (closing_) return CutWhenOver();
    ++relay_.upstream_lost;
    if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow) {
      spdlog::warn("proxy: {} sends a message of more than {} bytes", relay_.upstream.text(),
                   options_.max_message_bytes);
      return CloseClient(websocket::close_code::too_big);
    }
    spdlog::warn("proxy: {}: the upstream connection is lost: {}", peer_, error.message());
    Cut();
    relay_.look_in(std::chrono::milliseconds(0));
  }

  void CloseUpstream(const websocket::close_reason& reason) {
    Closing();
    upstream_->async_close(Passed(reason), [this, self = shared_from_this()](Error) {
      upstream_over_ = true;
      CutWhenOver();
    });
  }
  void CloseClient(const websocket::close_reason& reason) {
    Closing();
    client_->async_close(Passed(reason), [this, self = shared_from_this()](Error) {
      client_over_ = true;
      CutWhenOver();
    });
  }
  // Both ends say goodbye; who takes his time is cut.
  void Closing() {
    closing_ = true;
    limit_.expires_after(kGoodbye);
    limit_.async_wait([weak = weak_from_this()](Error error) {
      const auto self = weak.lock();
      if (!error && self != nullptr) self->Cut();
    });
  }
  void CutWhenOver() {
    if (client_over_ && upstream_over_) Cut();
  }

  // Nobody is there to talk with: the client is let go of, without a word, as by a server that
  // died.
  void Lost(const std::string& why, bool gone) {
    if (closing_) return;
    ++relay_.upstream_lost;
    Cut();
    if (gone) relay_.gone(why);
    relay_.look_in(absl::ToChronoMilliseconds(options_.probe_period));
  }
  void Cut() {
    Error ignored;
    closing_ = true;
    limit_.cancel();
    resolver_.cancel();
    upstream_tcp_.close(ignored);
    if (upstream_stream_) upstream_stream_->Close();
    client_stream_.Close();
  }

  RelayLinks& relay_;
  const RelayOptions& options_;
  const std::string peer_;
  WebStream client_stream_;
  Tcp::resolver resolver_;
  Tcp::socket upstream_tcp_;
  net::steady_timer limit_;
  beast::flat_buffer http_buffer_;
  http::request_parser<http::string_body> parser_;
  std::optional<http::response<http::string_body>> response_;
  websocket::response_type upstream_response_;
  std::string authorization_;
  std::optional<WebStream> upstream_stream_;
  std::optional<ClientSocket> client_;
  std::optional<ServerSocket> upstream_;
  std::unique_ptr<RelayTap> tap_;
  beast::flat_buffer from_client_, from_upstream_;
  std::optional<std::string> replaced_;
  bool asked_ = false, open_ = false, closing_ = false, client_over_ = false,
       upstream_over_ = false;
  bool pinging_upstream_ = false, pinging_client_ = false;
};

}  // namespace

std::shared_ptr<RelayLink> RelayLink::Start(RelayLinks& relay, net::io_context& io,
                                            Tcp::socket socket, std::string peer,
                                            const std::shared_ptr<SSL_CTX>& tls) {
  auto link = std::make_shared<Link>(relay, io, std::move(socket), std::move(peer), tls);
  link->Begin();
  return link;
}

}  // namespace robostress
