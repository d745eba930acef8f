#include "server/proxy/relay.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/connect.hpp>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <chrono>
#include <exception>
#include <list>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "common/wire/tls_client.h"
#include "common/wire/web_stream.h"
#include "common/wire/web_url.h"

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
constexpr auto kHandshake = std::chrono::seconds(30);
constexpr auto kProbe = std::chrono::seconds(2), kGoodbye = std::chrono::seconds(2);
constexpr int kGoodbyes = 50;  // looks, 20 ms apart
constexpr auto kSayAgain = std::chrono::seconds(10);
constexpr int kIdleProbes = 5;  // of probe_period, between two where the upstream was there
constexpr char kNoBrowsers[] = "a browser's page may not open a WebSocket here\n";

std::string Text(const boost::string_view& view) { return {view.data(), view.size()}; }

absl::StatusOr<Tcp::endpoint> EndpointOf(const std::string& listen) {
  const auto refuse = [&listen](const std::string& why) {
    return absl::UnavailableError(absl::StrCat("cannot listen on ", listen, ": ", why));
  };
  const size_t colon = listen.rfind(':');
  if (colon == std::string::npos || colon == 0 || colon + 1 == listen.size())
    return refuse("it must be HOST:PORT, e.g. 127.0.0.1:8001");
  std::string host = listen.substr(0, colon);
  if (host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  net::io_context io;
  Error error;
  const auto found =
      Tcp::resolver(io).resolve(host, listen.substr(colon + 1), Tcp::resolver::passive, error);
  if (error || found.empty()) return refuse(error.message());
  return found.begin()->endpoint();
}

// What may stand in a close frame; others are not said.
websocket::close_reason Passed(const websocket::close_reason& reason) {
  const auto code = static_cast<unsigned>(reason.code);
  const bool sayable =
      (code >= 1000 && code <= 1014 && code != 1004 && code != 1005 && code != 1006) ||
      (code >= 3000 && code <= 4999);
  return sayable ? reason : websocket::close_reason();
}

}  // namespace

// All of it but `figures_` is of the I/O thread, once that runs.
class Relay::Impl {
 public:
  Impl(const RelayOptions& options, WebUrl upstream, std::shared_ptr<SSL_CTX> tls,
       Tcp::endpoint endpoint, MakeTap make)
      : options_(options),
        upstream_(std::move(upstream)),
        upstream_tls_(std::move(tls)),
        endpoint_(std::move(endpoint)),
        make_(std::move(make)) {}
  ~Impl();

  absl::Status Start() {
    RS_RETURN_IF_ERROR(Reserve());
    net::post(io_, [this] { Probe(); });
    thread_ = std::thread([this] { Run(); });
    return absl::OkStatus();
  }

  int port() const { return port_; }
  RelayFigures figures() const { return {there_, clients_, accepted_, refused_, upstream_lost_}; }

 private:
  class Link;

  void Run() {
    pthread_setname_np(pthread_self(), "relay");
    while (true) {
      try {
        io_.run();
        return;
      } catch (const std::exception& failed) {  // memory that is not there: one connection's end
        spdlog::error("proxy: a connection ends: {}", failed.what());
      }
    }
  }

  // Binds and does not listen: who dials is refused, and nobody else takes the port.
  absl::Status Reserve() {
    Error error;
    acceptor_.emplace(io_);
    acceptor_->open(endpoint_.protocol(), error);
    if (!error) acceptor_->set_option(Tcp::acceptor::reuse_address(true), error);
    if (!error) acceptor_->bind(endpoint_, error);
    if (!error) endpoint_ = acceptor_->local_endpoint(error);
    if (error) {
      return absl::UnavailableError(absl::StrCat("cannot listen on ", options_.listen, ": ",
                                                 error.message(), "; use HOST:0 for a free port"));
    }
    port_ = endpoint_.port();
    return absl::OkStatus();
  }

  void Appear() {
    if (there_.exchange(true)) return;
    Error error;
    if (!acceptor_) {  // it could not be bound again
      if (!Reserve().ok()) {
        there_ = false;
        return;
      }
    }
    acceptor_->listen(net::socket_base::max_listen_connections, error);
    if (error) {
      spdlog::error("proxy: cannot listen on {}: {}", options_.listen, error.message());
      there_ = false;
      return;
    }
    spdlog::info("proxy: {} is there: clients may come", upstream_.text());
    Accept();
  }
  void Disappear(const std::string& why) {
    if (!there_.exchange(false)) {
      if (!std::exchange(said_absent_, true))
        spdlog::warn("proxy: {} is not there ({}): clients are refused until it is",
                     upstream_.text(), why);
      return;
    }
    spdlog::warn("proxy: {} is gone ({}): clients are refused until it is back", upstream_.text(),
                 why);
    Error ignored;
    acceptor_->close(ignored);
    if (const absl::Status bound = Reserve(); !bound.ok()) {
      spdlog::error("proxy: {}", std::string(bound.message()));
      acceptor_.reset();
    }
  }

  void ProbeIn(std::chrono::milliseconds pause) {
    probe_timer_.expires_after(pause);
    probe_timer_.async_wait([this](Error error) {
      if (!error && !stopped_) Probe();
    });
  }
  void NextProbe() {
    const auto period = absl::ToChronoMilliseconds(options_.probe_period);
    ProbeIn(there_ ? kIdleProbes * period : period);
  }

  // Whether somebody listens upstream. It is asked as a load balancer would ask openpi's server;
  // what he answers does not matter.
  struct Asked {
    explicit Asked(net::io_context& io) : resolver(io), socket(io), limit(io) {}
    Tcp::resolver resolver;
    Tcp::socket socket;
    net::steady_timer limit;
    std::string request;
    char answer[256] = {};
    bool over = false;
  };
  void Probe() {
    if (there_ && clients_ > 0) return NextProbe();  // their connections say it
    const auto asked = std::make_shared<Asked>(io_);
    const auto over = [this, asked](bool there, const std::string& why) {
      if (std::exchange(asked->over, true)) return;
      Error ignored;
      asked->limit.cancel();
      asked->resolver.cancel();
      asked->socket.close(ignored);
      if (stopped_) return;
      there ? Appear() : Disappear(why);
      NextProbe();
    };
    asked->limit.expires_after(kProbe);
    asked->limit.async_wait([asked, over](Error error) {
      if (!error) over(asked->socket.is_open() && !asked->request.empty(), "it does not answer");
    });
    asked->resolver.async_resolve(
        upstream_.host, absl::StrCat(upstream_.port),
        [this, asked, over](Error error, const Tcp::resolver::results_type& found) {
          if (error || asked->over) return over(false, error.message());
          net::async_connect(
              asked->socket, found, [this, asked, over](Error error, const Tcp::endpoint&) {
                if (error || upstream_.tls) return over(!error, error.message());
                asked->request =
                    absl::StrCat("GET /healthz HTTP/1.1\r\nHost: ", upstream_.authority(),
                                 "\r\nConnection: close\r\n\r\n");
                net::async_write(
                    asked->socket, net::buffer(asked->request), [asked, over](Error error, size_t) {
                      if (error) return over(true, "");
                      asked->socket.async_read_some(net::buffer(asked->answer),
                                                    [over](Error, size_t) { over(true, ""); });
                    });
              });
        });
  }

  void Accept() {
    acceptor_->async_accept([this](Error error, Tcp::socket socket) {
      if (stopped_ || error == net::error::operation_aborted) return;
      if (error) {  // out of descriptors: those open must end first
        if (Seldom(said_deaf_)) spdlog::warn("proxy: accept failed: {}", error.message());
        accept_again_.expires_after(std::chrono::milliseconds(50));
        accept_again_.async_wait([this](Error cancelled) {
          if (!cancelled && there_ && !stopped_) Accept();
        });
        return;
      }
      Accept();
      Add(std::move(socket));
    });
  }
  void Add(Tcp::socket socket);
  // The oldest connection that has not said yet what it wants goes; false: there is none.
  bool MakeRoom();
  // Whether what happens all the time was not said for a while.
  static bool Seldom(std::chrono::steady_clock::time_point& said) {
    const auto now = std::chrono::steady_clock::now();
    if (now - said < kSayAgain) return false;
    said = now;
    return true;
  }
  // Who does not say goodbye in time is cut.
  void StopWhenGone(int looks) {
    if (clients_ == 0 || looks == 0) return io_.stop();
    probe_timer_.expires_after(std::chrono::milliseconds(20));
    probe_timer_.async_wait([this, looks](Error) { StopWhenGone(looks - 1); });
  }

  const RelayOptions options_;
  const WebUrl upstream_;
  const std::shared_ptr<SSL_CTX> upstream_tls_;
  Tcp::endpoint endpoint_;
  const MakeTap make_;
  // Before `io_`, whose end is that of the links which it still holds.
  bool stopped_ = false, said_absent_ = false;
  std::chrono::steady_clock::time_point said_full_, said_deaf_;
  std::atomic<int> port_{0}, clients_{0};
  std::atomic<bool> there_{false};
  std::atomic<uint64_t> accepted_{0}, refused_{0}, upstream_lost_{0};
  net::io_context io_{1};
  net::executor_work_guard<net::io_context::executor_type> keep_running_{io_.get_executor()};
  std::optional<Tcp::acceptor> acceptor_;
  net::steady_timer probe_timer_{io_}, accept_again_{io_};
  std::list<std::weak_ptr<Link>> links_;
  std::thread thread_;
};

// One client and its upstream connection. Every operation under way holds it.
class Relay::Impl::Link : public std::enable_shared_from_this<Link> {
 public:
  Link(Impl& relay, Tcp::socket socket, std::string peer, const std::shared_ptr<SSL_CTX>& tls)
      : relay_(relay),
        options_(relay.options_),
        peer_(std::move(peer)),
        client_stream_(WebStream::Of(std::move(socket), tls)),
        resolver_(relay.io_),
        upstream_tcp_(relay.io_),
        limit_(relay.io_) {
    ++relay_.clients_;
  }
  ~Link() {
    Cut();
    --relay_.clients_;
  }

  void Start() {
    client_stream_.ExpireAfter(absl::FromChrono(kHandshake));
    client_stream_.Handshake([this, self = shared_from_this()](Error error) {
      if (error) return;
      parser_.body_limit(4096);
      http::async_read(client_stream_, http_buffer_, parser_,
                       [this, self](Error failed, size_t) { OnRequest(failed); });
    });
  }

  // It has not sent its request.
  bool silent() const { return !asked_ && !closing_; }
  void GoAway() {
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
    if (status != 200) ++relay_.refused_;
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
        relay_.upstream_.host, absl::StrCat(relay_.upstream_.port),
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
        WebStream::To(std::move(upstream_tcp_), relay_.upstream_tls_, relay_.upstream_.host));
    if (authorization_.empty() && !options_.secrets.token.empty()) {
      if (!relay_.upstream_.tls && !loopback) {
        spdlog::error("proxy: {}: without TLS the token is readable on the way; use wss://",
                      relay_.upstream_.text());
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
                    relay_.upstream_.text(), why.empty() ? failed.message() : why);
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
    if (relay_.upstream_.target != "/") target = relay_.upstream_.target;
    upstream_->async_handshake(upstream_response_, relay_.upstream_.authority(), target,
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
      if (relay_.make_) tap_ = relay_.make_(peer_);
      open_ = true;
      ++relay_.accepted_;
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
    ++relay_.upstream_lost_;
    if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow) {
      spdlog::warn("proxy: {} sends a message of more than {} bytes", relay_.upstream_.text(),
                   options_.max_message_bytes);
      return CloseClient(websocket::close_code::too_big);
    }
    spdlog::warn("proxy: {}: the upstream connection is lost: {}", peer_, error.message());
    Cut();
    relay_.ProbeIn(std::chrono::milliseconds(0));
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
    ++relay_.upstream_lost_;
    Cut();
    if (gone) relay_.Disappear(why);
    relay_.ProbeIn(absl::ToChronoMilliseconds(options_.probe_period));
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

  Impl& relay_;
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

void Relay::Impl::Add(Tcp::socket socket) {
  Error error;
  const Tcp::endpoint remote = socket.remote_endpoint(error);
  if (error) return;  // it is gone already
  if (clients_ >= options_.max_clients && !MakeRoom()) {
    ++refused_;
    if (Seldom(said_full_)) {
      spdlog::warn(
          "proxy: {} clients are connected, which is as many as may be (--max-clients); {} were "
          "refused so far",
          options_.max_clients, refused_.load());
    }
    return;  // the socket's end
  }
  socket.set_option(Tcp::no_delay(true), error);
  const std::shared_ptr<SSL_CTX> tls =
      options_.tls == nullptr ? nullptr : options_.tls->Get()->context;
  const auto link =
      std::make_shared<Link>(*this, std::move(socket),
                             absl::StrCat(remote.address().to_string(), ":", remote.port()), tls);
  links_.remove_if([](const std::weak_ptr<Link>& one) { return one.expired(); });
  links_.push_back(link);
  link->Start();
}

bool Relay::Impl::MakeRoom() {
  for (const std::weak_ptr<Link>& one : links_) {
    const std::shared_ptr<Link> link = one.lock();
    if (link == nullptr || !link->silent()) continue;
    link->GoAway();
    return true;
  }
  return false;
}

Relay::Impl::~Impl() {
  if (!thread_.joinable()) return;
  net::post(io_, [this] {
    stopped_ = true;
    Error ignored;
    if (acceptor_) acceptor_->close(ignored);
    probe_timer_.cancel();
    accept_again_.cancel();
    for (const std::weak_ptr<Link>& one : links_) {
      if (const std::shared_ptr<Link> link = one.lock()) link->GoAway();
    }
    StopWhenGone(kGoodbyes);
    keep_running_.reset();
  });
  thread_.join();
}

Relay::Relay(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Relay::~Relay() = default;
int Relay::port() const { return impl_->port(); }
RelayFigures Relay::figures() const { return impl_->figures(); }

absl::StatusOr<std::unique_ptr<Relay>> Relay::Start(const RelayOptions& options, MakeTap make) {
  if (options.max_clients < 1 || options.max_clients > 4096) {
    return absl::InvalidArgumentError(
        absl::StrCat("--max-clients is ", options.max_clients, ", must be 1..4096"));
  }
  RS_ASSIGN_OR_RETURN(WebUrl upstream, ParseWebUrl(options.upstream));
  std::shared_ptr<SSL_CTX> tls;
  if (upstream.tls) {
    RS_ASSIGN_OR_RETURN(tls, MakeTlsClient(options.secrets));
  }
  RS_ASSIGN_OR_RETURN(const Tcp::endpoint endpoint, EndpointOf(options.listen));
  auto impl = std::make_unique<Impl>(options, std::move(upstream), std::move(tls), endpoint,
                                     std::move(make));
  RS_RETURN_IF_ERROR(impl->Start());
  return std::unique_ptr<Relay>(new Relay(std::move(impl)));
}

}  // namespace robostress
