#include "server/edge/web_server.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <list>
#include <optional>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/clock.h"
#include "common/monotonic_wait.h"
#include "common/status_macros.h"
#include "server/edge/web_connection.h"

namespace robostress {
namespace {

namespace net = boost::asio;
using Tcp = net::ip::tcp;
using boost::system::error_code;

absl::StatusOr<Tcp::acceptor> Listen(net::io_context& context, const std::string& listen) {
  const auto refuse = [&listen](const std::string& why) {
    return absl::UnavailableError(absl::StrCat("cannot listen on ", listen, ": ", why));
  };
  const size_t colon = listen.rfind(':');
  if (colon == std::string::npos || colon == 0 || colon + 1 == listen.size())
    return refuse("it must be HOST:PORT, e.g. 127.0.0.1:8000");
  std::string host = listen.substr(0, colon);
  if (host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  error_code error;
  Tcp::resolver resolver(context);
  const auto found =
      resolver.resolve(host, listen.substr(colon + 1), Tcp::resolver::passive, error);
  if (error || found.empty()) return refuse(error.message());
  const Tcp::endpoint endpoint = found.begin()->endpoint();
  Tcp::acceptor acceptor(context);
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(Tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(net::socket_base::max_listen_connections, error);
  if (error) return refuse(absl::StrCat(error.message(), "; use HOST:0 for a free port"));
  return acceptor;
}

}  // namespace

WebReply ErrorReply(const absl::Status& status) {
  WebReply reply;
  switch (status.code()) {
    case absl::StatusCode::kUnauthenticated:
      reply.status = 401;
      break;
    case absl::StatusCode::kPermissionDenied:
      reply.status = 403;
      break;
    case absl::StatusCode::kNotFound:
      reply.status = 404;
      break;
    case absl::StatusCode::kInvalidArgument:
      reply.status = 400;
      break;
    case absl::StatusCode::kResourceExhausted:
    case absl::StatusCode::kUnavailable:
      reply.status = 503;
      break;
    default:
      reply.status = 500;
  }
  reply.body = absl::StrCat(status.message(), "\n");
  return reply;
}

class WebServer::Impl {
 public:
  Impl(const WebServerOptions& options, Page page, Upgrade upgrade, Metrics* metrics)
      : options_(options),
        page_(std::move(page)),
        upgrade_(std::move(upgrade)),
        connections_(metrics->AddGauge("robostress_connections", "Connections open now.",
                                       {{"listener", options.name}})),
        refused_(metrics->AddCounter("robostress_connections_refused_total",
                                     "Connections beyond the limit.",
                                     {{"listener", options.name}})) {}

  absl::Status Start() {
    if (options_.max_connections < 1 || options_.max_connections > 65536) {
      return absl::InvalidArgumentError(absl::StrCat(
          options_.name, ": max_connections is ", options_.max_connections, ", must be 1..65536"));
    }
    if (options_.max_connections_per_client < 0 ||
        options_.max_connections_per_client > options_.max_connections) {
      return absl::InvalidArgumentError(absl::StrCat(
          options_.name, ": --connections-per-client is ", options_.max_connections_per_client,
          ", must be 0 (half of them) to ", options_.max_connections, " (--max-connections)"));
    }
    RS_ASSIGN_OR_RETURN(Tcp::acceptor acceptor, Listen(context_, options_.listen));
    error_code error;
    port_ = acceptor.local_endpoint(error).port();
    acceptor_.emplace(std::move(acceptor));
    thread_ = std::thread([this] { Accept(); });
    return absl::OkStatus();
  }

  void Stop(absl::Duration grace) {
    if (!thread_.joinable()) return;
    net::post(context_, [this] {
      error_code ignored;
      acceptor_->close(ignored);
    });
    thread_.join();
    {
      absl::MutexLock lock(&mu_);
      for (Entry& entry : entries_) entry.connection->GoAway();
      const auto gone = [this] {
        mu_.AssertHeld();
        return NoEntries();
      };
      if (!AwaitFor(mu_, gone, grace)) {
        for (Entry& entry : entries_) entry.connection->Cut();
        mu_.Await(absl::Condition(this, &Impl::NoEntries));
      }
    }
    JoinLeaving();
  }

  int port() const { return port_; }
  int connections() {
    absl::MutexLock lock(&mu_);
    return static_cast<int>(entries_.size());
  }

 private:
  struct Entry {
    std::shared_ptr<WebConnection> connection;
    std::thread thread;
    std::string client;
    bool health_only = false;
  };

  bool NoEntries() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    mu_.AssertHeld();
    return entries_.empty();
  }

  int PerClient() const {
    return options_.max_connections_per_client != 0 ? options_.max_connections_per_client
                                                    : std::max(1, options_.max_connections / 2);
  }
  bool HasPlace(const std::string& client) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return std::count_if(entries_.begin(), entries_.end(), [&client](const Entry& entry) {
             return !entry.health_only && entry.client == client;
           }) < PerClient();
  }
  // A connection whose client has said who it is.
  absl::Status Claim(Entry& entry, const std::string& client) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    if (client.empty() || client == entry.client) return absl::OkStatus();
    if (!HasPlace(client)) {
      refused_->Add();
      return absl::ResourceExhaustedError(
          absl::StrCat("this client holds ", PerClient(),
                       " connections, which is as many as one may; close one, or start the server "
                       "with more --connections-per-client"));
    }
    entry.client = client;
    return absl::OkStatus();
  }

  void Accept() {
    pthread_setname_np(pthread_self(),
                       absl::StrCat(options_.name, "-accept").substr(0, 15).c_str());
    while (true) {
      Tcp::socket socket(context_);
      error_code error;
      bool done = false;
      acceptor_->async_accept(socket, [&](error_code e) {
        error = e;
        done = true;
      });
      context_.restart();
      while (!done) context_.run_one();
      JoinLeaving();
      if (error == net::error::operation_aborted || error == net::error::bad_descriptor) return;
      if (error) {  // out of descriptors: those open must end first
        spdlog::warn("{}: accept failed: {}", options_.name, error.message());
        absl::SleepFor(absl::Milliseconds(50));  // there is nothing to wait for but time
        continue;
      }
      Add(std::move(socket));
    }
  }

  void Add(Tcp::socket socket) ABSL_LOCKS_EXCLUDED(mu_) {
    error_code error;
    const std::string peer = socket.remote_endpoint(error).address().to_string(error);
    absl::MutexLock lock(&mu_);
    const auto probes = static_cast<int>(std::count_if(
        entries_.begin(), entries_.end(), [](const Entry& entry) { return entry.health_only; }));
    const auto open = static_cast<int>(entries_.size()) - probes;
    const bool health_only = open >= options_.max_connections || !HasPlace(peer);
    if (health_only && probes >= WebServerOptions::kHealthPlaces) {
      refused_->Add();
      error_code ignored;
      socket.non_blocking(true, ignored);
      constexpr std::string_view kFull =
          "HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\n"
          "Connection: close\r\n\r\n";
      if (options_.tls == nullptr) socket.write_some(net::buffer(kFull), ignored);
      return;
    }
    connections_->Add(1);
    const auto entry = entries_.emplace(entries_.end());
    entry->client = peer;
    entry->health_only = health_only;
    entry->connection = std::make_shared<WebConnection>(options_, page_, upgrade_, health_only);
    // The descriptor moves to the connection's own context: one thread runs one connection.
    const auto protocol = socket.local_endpoint(error).protocol();
    const int descriptor = socket.release(error);
    entry->thread = std::thread([this, entry, protocol, descriptor] {
      entry->connection->Serve(protocol, descriptor, [this, entry](const std::string& client) {
        return Claim(*entry, client);
      });
      connections_->Add(-1);
      absl::MutexLock lock(&mu_);
      leaving_.splice(leaving_.end(), entries_, entry);
    });
  }

  void JoinLeaving() ABSL_LOCKS_EXCLUDED(mu_) {
    std::list<Entry> left;
    {
      absl::MutexLock lock(&mu_);
      left.swap(leaving_);
    }
    for (Entry& entry : left) entry.thread.join();
  }

  const WebServerOptions options_;
  const Page page_;
  const Upgrade upgrade_;
  const std::shared_ptr<Gauge> connections_;
  const std::shared_ptr<Counter> refused_;
  net::io_context context_{1};
  std::optional<Tcp::acceptor> acceptor_;
  std::thread thread_;
  int port_ = 0;

  absl::Mutex mu_;
  std::list<Entry> entries_ ABSL_GUARDED_BY(mu_);
  std::list<Entry> leaving_ ABSL_GUARDED_BY(mu_);  // served; their threads are to be joined
};

WebServer::WebServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
WebServer::~WebServer() { Stop(absl::ZeroDuration()); }
int WebServer::port() const { return impl_->port(); }
int WebServer::connections() const { return impl_->connections(); }
void WebServer::Stop(absl::Duration grace) { impl_->Stop(grace); }

absl::StatusOr<std::unique_ptr<WebServer>> WebServer::Start(const WebServerOptions& options,
                                                            Page page, Upgrade upgrade,
                                                            Metrics* metrics) {
  auto impl = std::make_unique<Impl>(options, std::move(page), std::move(upgrade), metrics);
  RS_RETURN_IF_ERROR(impl->Start());
  return std::unique_ptr<WebServer>(new WebServer(std::move(impl)));
}

}  // namespace robostress
