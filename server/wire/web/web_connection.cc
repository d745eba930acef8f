#include "server/wire/web/web_connection.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <exception>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using boost::system::error_code;

constexpr char kPlainText[] = "text/plain; charset=utf-8";

// What hundreds may ask for at once, and what is done in no time: it takes few workers of a client.
constexpr char kOpening[] = "opening ", kEnding[] = "ending ";

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
      421, kPlainText,
      absl::StrCat("this server does not go by the name '", absl::CHexEscape(header.substr(0, 256)),
                   "'; ask by its address, or start it with --allowed-hosts and that name\n")};
}

bool IsProbe(const std::string& path) { return path == "/healthz" || path == "/readyz"; }

}  // namespace

// A conversation that a worker opened, or why not.
struct WebConnection::Upgraded {
  absl::Status status;
  WebSocketSession::Opened opened;
};

WebConnection::WebConnection(const WebServices& services, WebStream stream, std::string peer,
                             Place place)
    : place_(std::move(place)),
      services_(services),
      stream_(std::move(stream)),
      peer_(std::move(peer)) {}

// A probe asks at once; whoever only sits in its place must leave it soon.
absl::Duration WebConnection::request_timeout() const {
  const absl::Duration limit = services_.options.request_timeout;
  return place_.health_only ? std::min(limit, absl::Seconds(2)) : limit;
}

void WebConnection::Start() {
  stream_.ExpireAfter(request_timeout());
  waiting_ = true;
  stream_.Handshake([this, self = shared_from_this()](Error error) {
    if (error) {
      spdlog::info("{}: {}: TLS handshake failed: {}", services_.options.name, peer_,
                   error.message());
      return;
    }
    certificate_owner_ = stream_.certificate_owner();
    Read();
  });
}

void WebConnection::GoAway() {
  going_away_ = true;
  if (socket_ != nullptr) {
    socket_->GoAway();
  } else if (waiting_) {
    stream_.Close();
  }
}

void WebConnection::Read() {
  if (going_away_) return;
  parser_.emplace();
  parser_->body_limit(4096);
  stream_.ExpireAfter(request_timeout());
  waiting_ = true;
  http::async_read(stream_, buffer_, *parser_,
                   [this, self = shared_from_this()](Error error, size_t) { OnRequest(error); });
}

void WebConnection::OnRequest(Error error) {
  waiting_ = false;
  if (error == http::error::end_of_stream || error == beast::error::timeout ||
      error == net::error::operation_aborted || error == net::error::connection_reset) {
    stream_.ShutdownSend();
    return;
  }
  keep_alive_ = head_only_ = false;
  if (error) {
    Reply({400, kPlainText, absl::StrCat("not an HTTP request: ", error.message(), "\n")});
    return;
  }
  const Request& request = parser_->get();
  head_only_ = request.method() == http::verb::head;
  keep_alive_ = request.keep_alive() && !place_.health_only;
  WebRequest seen;
  bool upgrades = false;
  if (std::optional<WebReply> refusal = Refuse(request, seen, upgrades)) {
    Reply(*std::move(refusal));
  } else if (upgrades) {
    Upgrade(std::move(seen));
  } else {
    AnswerPage(std::move(seen));
  }
}

std::optional<WebReply> WebConnection::Refuse(const Request& request, WebRequest& seen,
                                              bool& upgrades) const {
  const std::string target = View(request.target());
  const size_t mark = target.find('?');
  seen.path = target.substr(0, mark);
  if (mark != std::string::npos) seen.query = target.substr(mark + 1);
  seen.authorization = View(request[http::field::authorization]);
  seen.peer = peer_;
  seen.certificate_owner = certificate_owner_;
  if (request.method() != http::verb::get && request.method() != http::verb::head)
    return WebReply{405, kPlainText, "only GET is served here\n"};
  const bool probe = IsProbe(seen.path);
  if (place_.health_only && !probe) {
    return ErrorReply(absl::UnavailableError(
        "every connection of this server, or of this client, is taken (--max-connections, "
        "--connections-per-client), close one or try again"));
  }
  const std::string host = View(request[http::field::host]),
                    origin = View(request[http::field::origin]);
  const bool known = IsKnownHost(host, services_.options);
  // openpi's server answers /healthz before it looks for an upgrade, and upgrades anything else.
  upgrades = services_.upgrade && beast::websocket::is_upgrade(request) && seen.path != "/healthz";
  if (!upgrades) return probe || known ? std::nullopt : std::optional(UnknownHost(host));
  if (!origin.empty() && !known) return UnknownHost(host);
  if (FromElsewhere(origin, host)) {
    return ErrorReply(absl::PermissionDeniedError(
        "a browser's page from another origin may not open a WebSocket here"));
  }
  return std::nullopt;
}

void WebConnection::AnswerPage(WebRequest seen) {
  const bool probe = IsProbe(seen.path);
  const auto answer = [&page = services_.page, seen = std::move(seen)]() -> WebReply {
    try {
      return page(seen);
    } catch (const std::exception& failed) {
      return ErrorReply(absl::InternalError(failed.what()));
    }
  };
  if (probe) {  // it waits for nobody, and is answered when all workers are taken
    Reply(answer());
    return;
  }
  WorkThen(services_, place_.address, "", answer,
           [this, self = shared_from_this()](WebReply reply) { Reply(std::move(reply)); });
}

void WebConnection::Upgrade(WebRequest seen) {
  const auto open = [&services = services_, lease = place_.lease, address = place_.address,
                     seen = std::move(seen)]() -> Upgraded {
    Upgraded upgraded;
    WebSocketSession::Opened& opened = upgraded.opened;
    try {
      absl::StatusOr<std::unique_ptr<WebConversation>> made = services.upgrade(seen);
      if (!made.ok()) {
        upgraded.status = made.status();
        return upgraded;
      }
      opened.client = (*made)->client().empty() ? address : (*made)->client();
      // Its end may wait too, for a disk: it is a worker's, whoever lets go of it last.
      opened.conversation = {
          made->release(),
          [&workers = services.workers, lease, client = opened.client](WebConversation* ended) {
            workers.Post(client, absl::StrCat(kEnding, client), [ended, lease] { delete ended; });
          }};
      opened.greeting = opened.conversation->Greeting();
      opened.largest_message = opened.conversation->LargestMessage();
    } catch (const std::exception& failed) {
      upgraded.status = absl::InternalError(failed.what());
    }
    return upgraded;
  };
  WorkThen(
      services_, place_.address, absl::StrCat(kOpening, place_.address), open,
      [this, self = shared_from_this()](Upgraded upgraded) { OnUpgraded(std::move(upgraded)); });
}

void WebConnection::OnUpgraded(Upgraded upgraded) {
  if (upgraded.status.ok()) upgraded.status = place_.claim(upgraded.opened.client);
  if (!upgraded.status.ok()) {
    Reply(ErrorReply(upgraded.status));
    return;
  }
  socket_ = std::make_unique<WebSocketSession>(services_, stream_, std::move(upgraded.opened),
                                               peer_, weak_from_this());
  if (going_away_) socket_->GoAway();
  Request request = parser_->release();
  parser_.reset();
  buffer_ = {};
  socket_->Start(std::move(request));
}

void WebConnection::Reply(WebReply reply) {
  keep_alive_ = keep_alive_ && !going_away_;
  Response& response = response_.emplace(static_cast<http::status>(reply.status), 11);
  response.set(http::field::content_type, reply.content_type);
  response.set(http::field::cache_control, "no-store");
  response.set("X-Content-Type-Options", "nosniff");
  response.set("Content-Security-Policy",
               "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; "
               "connect-src 'self'; img-src 'self' data:");
  if (reply.status == 401)
    response.set(http::field::www_authenticate, "Basic realm=\"token as password\"");
  if (reply.status == 503) response.set(http::field::retry_after, "1");
  response.keep_alive(keep_alive_);
  response.body() = std::move(reply.body);
  response.prepare_payload();
  if (head_only_) response.body().clear();
  stream_.ExpireAfter(request_timeout());
  http::async_write(stream_, response, [this, self = shared_from_this()](Error error, size_t) {
    response_.reset();
    if (!error && keep_alive_) {
      Read();
    } else {
      stream_.ShutdownSend();
    }
  });
}

}  // namespace robostress
