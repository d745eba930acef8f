#include "server/edge/web_connection.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <chrono>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using boost::system::error_code;

// The reason that openpi's server closes with; its clients only look at the text frame before it.
constexpr char kErrorReason[] = "Internal server error. Traceback included in previous frame.";

std::string View(beast::string_view text) { return {text.data(), text.size()}; }

// A page of another site, opened in a browser that reaches this port, must not talk to a robot.
bool FromElsewhere(const std::string& origin, const std::string& host) {
  if (origin.empty()) return false;  // no browser
  const size_t scheme = origin.find("://");
  return scheme == std::string::npos || origin.substr(scheme + 3) != host;
}

// "name:80", "[::1]:80" -> "name", "::1".
std::string WithoutPort(std::string host) {
  if (!host.empty() && host.front() == '[') return host.substr(1, host.find(']') - 1);
  const size_t colon = host.rfind(':');
  if (colon != std::string::npos && host.find(':') == colon) host.resize(colon);
  return host;
}

// By which a request may name this server. Addresses are safe: a rebound name is never one.
bool IsKnownHost(const std::string& header, const WebServerOptions& options) {
  const std::string host = WithoutPort(header);
  error_code error;
  net::ip::make_address(host, error);
  if (!error) return true;
  const auto same = [&host](const std::string& name) { return absl::EqualsIgnoreCase(name, host); };
  return same("localhost") || (!host.empty() && same(WithoutPort(options.listen))) ||
         std::any_of(options.allowed_hosts.begin(), options.allowed_hosts.end(), same);
}

WebReply UnknownHost(const std::string& header) {
  return {
      421, "text/plain; charset=utf-8",
      absl::StrCat("this server does not go by the name '", absl::CHexEscape(header.substr(0, 256)),
                   "'; ask by its address, or start it with --allowed-hosts and that name\n")};
}

bool IsProbe(const std::string& path) { return path == "/healthz" || path == "/readyz"; }

// A buffer may hold this much beyond the message that is being read.
constexpr size_t kReadAheadBytes = 4096;

}  // namespace

template <class Start>
error_code WebConnection::Run(Start&& start) {
  error_code result;
  bool done = false;
  start([&result, &done](error_code error, auto&&...) {
    result = error;
    done = true;
  });
  while (!done) {
    context_.restart();
    context_.run_one();
  }
  return cut_ ? error_code(net::error::operation_aborted) : result;
}

void WebConnection::GoAway() {
  net::post(context_, [this] {
    going_away_ = true;
    if (go_away_) go_away_();
  });
}

void WebConnection::Cut() {
  net::post(context_, [this] {
    cut_ = true;
    if (cut_stream_) cut_stream_();
  });
}

// A probe asks at once; whoever only sits in its place must leave it soon.
absl::Duration WebConnection::request_timeout() const {
  return health_only_ ? std::min(options_.request_timeout, absl::Seconds(2))
                      : options_.request_timeout;
}

void WebConnection::Serve(net::ip::tcp protocol, int descriptor, Claim claim) {
  claim_ = std::move(claim);
  pthread_setname_np(pthread_self(), options_.name.substr(0, 15).c_str());
  error_code error;
  beast::tcp_stream tcp(context_);
  tcp.socket().assign(protocol, descriptor, error);
  if (error) return;
  tcp.socket().set_option(net::ip::tcp::no_delay(true), error);
  const auto endpoint = tcp.socket().remote_endpoint(error);
  if (!error) peer_ = absl::StrCat(endpoint.address().to_string(), ":", endpoint.port());
  const absl::Cleanup forget = [this] {
    go_away_ = nullptr;
    cut_stream_ = nullptr;
  };
  if (options_.tls == nullptr) {
    ServeHttp(tcp);
    return;
  }
  const std::shared_ptr<const TlsSnapshot> tls = options_.tls->Get();
  SSL_CTX_up_ref(tls->context.get());  // of which Asio's context takes one
  net::ssl::context context(tls->context.get());
  beast::ssl_stream<beast::tcp_stream> stream(std::move(tcp), context);
  cut_stream_ = [&stream] { beast::get_lowest_layer(stream).close(); };
  beast::get_lowest_layer(stream).expires_after(absl::ToChronoMilliseconds(request_timeout()));
  error = Run([&](auto done) { stream.async_handshake(net::ssl::stream_base::server, done); });
  if (error) {
    spdlog::info("{}: {}: TLS handshake failed: {}", options_.name, peer_, error.message());
    return;
  }
  X509* const shown = SSL_get1_peer_certificate(stream.native_handle());
  certificate_owner_ = CertificateOwner(shown);
  X509_free(shown);
  ServeHttp(stream);
}

// False: answered with `refusal`.
template <class Request>
bool WebConnection::Asks(const Request& request, WebRequest& seen, WebReply& refusal) {
  const std::string target = View(request.target());
  const size_t mark = target.find('?');
  seen.path = target.substr(0, mark);
  if (mark != std::string::npos) seen.query = target.substr(mark + 1);
  seen.authorization = View(request[http::field::authorization]);
  seen.peer = peer_;
  seen.certificate_owner = certificate_owner_;
  if (request.method() != http::verb::get && request.method() != http::verb::head) {
    refusal = {405, "text/plain; charset=utf-8", "only GET is served here\n"};
    return false;
  }
  return true;
}

template <class Stream>
void WebConnection::ServeHttp(Stream& stream) {
  beast::tcp_stream& tcp = beast::get_lowest_layer(stream);
  bool reading = false;
  cut_stream_ = [&tcp] { tcp.close(); };
  go_away_ = [&tcp, &reading] {
    if (reading) tcp.cancel();  // no request is under way
  };
  beast::flat_buffer buffer;
  while (!going_away_) {
    http::request_parser<http::string_body> parser;
    parser.body_limit(4096);
    tcp.expires_after(absl::ToChronoMilliseconds(request_timeout()));
    reading = true;
    const error_code error =
        Run([&](auto done) { http::async_read(stream, buffer, parser, done); });
    reading = false;
    if (error == http::error::end_of_stream || error == beast::error::timeout ||
        error == net::error::operation_aborted || error == net::error::connection_reset) {
      break;
    }
    WebReply reply;
    WebRequest seen;
    bool keep_alive = false;
    http::verb method = http::verb::get;
    if (error) {
      reply = {400, "text/plain; charset=utf-8",
               absl::StrCat("not an HTTP request: ", error.message(), "\n")};
    } else {
      const auto& request = parser.get();
      method = request.method();
      keep_alive = request.keep_alive() && !health_only_;
      const std::string host = View(request[http::field::host]),
                        origin = View(request[http::field::origin]);
      if (Asks(request, seen, reply)) {
        // openpi's server answers /healthz before it looks for an upgrade, and upgrades anything
        // else.
        if (health_only_ && !IsProbe(seen.path)) {
          reply = ErrorReply(absl::UnavailableError(
              "every connection of this server, or of this client, is taken (--max-connections, "
              "--connections-per-client), close one or try again"));
        } else if (upgrade_ && websocket::is_upgrade(request) && seen.path != "/healthz") {
          if (!origin.empty() && !IsKnownHost(host, options_)) {
            reply = UnknownHost(host);
          } else if (FromElsewhere(origin, host)) {
            reply = ErrorReply(absl::PermissionDeniedError(
                "a browser's page from another origin may not open a WebSocket here"));
          } else if (auto conversation = upgrade_(seen); !conversation.ok()) {
            reply = ErrorReply(conversation.status());
          } else if (absl::Status place = claim_((*conversation)->client()); !place.ok()) {
            reply = ErrorReply(place);
          } else {
            ServeWebSocket(stream, request, *std::move(conversation));
            return;
          }
        } else if (!IsProbe(seen.path) && !IsKnownHost(host, options_)) {
          reply = UnknownHost(host);
        } else {
          reply = page_(seen);
        }
      }
    }
    http::response<http::string_body> response(static_cast<http::status>(reply.status), 11);
    response.set(http::field::content_type, reply.content_type);
    response.set(http::field::cache_control, "no-store");
    response.set("X-Content-Type-Options", "nosniff");
    response.set("Content-Security-Policy",
                 "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; "
                 "connect-src 'self'; img-src 'self' data:");
    if (reply.status == 401)
      response.set(http::field::www_authenticate, "Basic realm=\"token as password\"");
    if (reply.status == 503) response.set(http::field::retry_after, "1");
    keep_alive = keep_alive && !going_away_;
    response.keep_alive(keep_alive);
    response.body() = std::move(reply.body);
    response.prepare_payload();
    if (method == http::verb::head) response.body().clear();
    tcp.expires_after(absl::ToChronoMilliseconds(request_timeout()));
    if (Run([&](auto done) { http::async_write(stream, response, done); }) || !keep_alive) break;
  }
  error_code ignored;
  tcp.socket().shutdown(net::ip::tcp::socket::shutdown_send, ignored);
}

template <class Stream, class Request>
void WebConnection::ServeWebSocket(Stream& stream, const Request& request,
                                   std::unique_ptr<WebConversation> conversation) {
  beast::get_lowest_layer(stream).expires_never();  // the WebSocket has timeouts of its own
  websocket::stream<Stream&> socket(stream);
  websocket::stream_base::timeout timeout{};
  timeout.handshake_timeout = absl::ToChronoMilliseconds(options_.request_timeout);
  timeout.idle_timeout = absl::ToChronoMilliseconds(options_.idle_timeout);
  timeout.keep_alive_pings = true;
  socket.set_option(timeout);
  socket.auto_fragment(false);
  socket.binary(true);
  if (Run([&](auto done) { socket.async_accept(request, done); })) return;

  bool reading = false, closed = false;
  go_away_ = [&] {
    if (!reading) return;  // the answer under way goes out first
    closed = true;
    socket.async_close(websocket::close_code::going_away, [](error_code) {});
  };
  const auto send = [&](const std::string& message) {
    return Run([&](auto done) { socket.async_write(net::buffer(message), done); });
  };
  const auto close = [&](const websocket::close_reason& reason) {
    if (closed) return;
    closed = true;
    Run([&](auto done) { socket.async_close(reason, done); });
  };
  if (send(conversation->Greeting())) return;
  beast::flat_buffer buffer;
  while (!going_away_) {
    const uint64_t largest = options_.max_message_bytes != 0 ? options_.max_message_bytes
                                                             : conversation->LargestMessage();
    socket.read_message_max(largest);
    // Without it the buffer would double past the limit; with a session's smaller limit it shrinks.
    buffer.clear();
    buffer.max_size(largest + kReadAheadBytes);
    if (buffer.capacity() > buffer.max_size()) buffer.shrink_to_fit();
    reading = true;
    const error_code error = Run([&](auto done) { socket.async_read(buffer, done); });
    reading = false;
    if (error) {
      if (error != websocket::error::closed && !going_away_) {
        spdlog::info("{}: {}: cut: {}", options_.name, peer_, error.message());
      }
      return;
    }
    const std::string_view message(static_cast<const char*>(buffer.data().data()), buffer.size());
    absl::StatusOr<std::string> answer =
        absl::InvalidArgumentError("text frame: observations are binary frames with a msgpack map");
    try {
      if (!socket.got_text()) answer = conversation->Answer(message);
    } catch (const std::exception& failed) {  // out of memory: this client's end, not the server's
      answer = absl::InternalError(absl::StrCat("the message was not answered: ", failed.what()));
    }
    if (!answer.ok()) {
      socket.text(true);
      send(std::string(answer.status().message()));
      close({websocket::close_code::internal_error, kErrorReason});
      return;
    }
    if (const error_code failed = send(*answer)) {
      spdlog::info("{}: {}: cut while it was answered: {}", options_.name, peer_, failed.message());
      return;
    }
  }
  close(websocket::close_code::going_away);
}

}  // namespace robostress
