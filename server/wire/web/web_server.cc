#include "server/wire/web/web_server.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <exception>
#include <list>
#include <optional>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "common/monotonic_wait.h"
#include "common/status_macros.h"
#include "common/wire/web_stream.h"
#include "server/wire/fair_executor.h"
#include "server/wire/web/web_connection.h"
#include "server/wire/web/web_work.h"

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
                                     {{"listener", options.name}})),
        workers_({.name = absl::StrCat(options.name.substr(0, 10), "-work"),
                  .threads = options.workers,
                  .per_client = std::max(1, options.workers * 3 / 4)}) {}

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
    if (options_.workers < 1) {
      return absl::InvalidArgumentError(
          absl::StrCat(options_.name, ": workers is ", options_.workers, ", must be at least 1"));
    }
    RS_ASSIGN_OR_RETURN(Tcp::acceptor acceptor, Listen(io_, options_.listen));
    error_code error;
    port_ = acceptor.local_endpoint(error).port();
    acceptor_.emplace(std::move(acceptor));
    Accept();
    thread_ = std::thread([this] { Run(); });
    return absl::OkStatus();
  }

  void Stop(absl::Duration grace) {
    if (!thread_.joinable()) return;
    net::post(io_, [this] {
      error_code ignored;
      acceptor_->close(ignored);
      accept_again_.cancel();
      ForEach([](WebConnection& connection) { connection.GoAway(); });
      absl::MutexLock lock(&mu_);
      closed_ = true;
    });
    {
      absl::MutexLock lock(&mu_);
      const auto gone = [this] {
        mu_.AssertHeld();
        return Gone();
      };
      if (!AwaitFor(mu_, gone, grace)) {
        net::post(io_, [this] { ForEach([](WebConnection& connection) { connection.Cut(); }); });
        mu_.Await(absl::Condition(this, &Impl::Gone));
      }
    }
    workers_.Stop();
    keep_running_.reset();
    thread_.join();
  }

  int port() const { return port_; }
  int connections() {
    absl::MutexLock lock(&mu_);
    return open_;
  }

 private:
  struct Entry {
    std::weak_ptr<WebConnection> connection;
    std::string client;
    bool health_only = false;
  };
  using Entries = std::list<Entry>;

  bool Gone() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    mu_.AssertHeld();
    return closed_ && open_ == 0;
  }

  // The I/O thread. What throws (memory that is not there) ends the connection that it was about.
  void Run() {
    pthread_setname_np(pthread_self(), options_.name.substr(0, 15).c_str());
    while (true) {
      try {
        io_.run();
        return;
      } catch (const std::exception& failed) {
        spdlog::error("{}: a connection ends: {}", options_.name, failed.what());
      }
    }
  }

  // All below: of the I/O thread.
  template <class Action>
  void ForEach(Action action) {
    for (Entry& entry : entries_) {
      if (const std::shared_ptr<WebConnection> connection = entry.connection.lock())
        action(*connection);
    }
  }

  int PerClient() const {
    return options_.max_connections_per_client != 0 ? options_.max_connections_per_client
                                                    : std::max(1, options_.max_connections / 2);
  }
  bool HasPlace(const std::string& client) const {
    return std::count_if(entries_.begin(), entries_.end(), [&client](const Entry& entry) {
             return !entry.health_only && entry.client == client;
           }) < PerClient();
  }
  // A connection whose client has said who it is.
  absl::Status Claim(Entry& entry, const std::string& client) {
    if (client == entry.client) return absl::OkStatus();
    if (!HasPlace(client)) {
      refused_->Increment();
      return absl::ResourceExhaustedError(
          absl::StrCat("this client holds ", PerClient(),
                       " connections, which is as many as one may; close one, or start the server "
                       "with more --connections-per-client"));
    }
    entry.client = client;
    return absl::OkStatus();
  }

  void Accept() {
    acceptor_->async_accept([this](error_code error, Tcp::socket socket) {
      if (!acceptor_->is_open()) return;
      if (error) {  // out of descriptors: those open must end first
        spdlog::warn("{}: accept failed: {}", options_.name, error.message());
        accept_again_.expires_after(std::chrono::milliseconds(50));
        accept_again_.async_wait([this](error_code cancelled) {
          if (!cancelled && acceptor_->is_open()) Accept();
        });
        return;
      }
      Accept();
      Add(std::move(socket));
    });
  }

  void Add(Tcp::socket socket) ABSL_LOCKS_EXCLUDED(mu_) {
    error_code error;
    const Tcp::endpoint remote = socket.remote_endpoint(error);
    if (error) return;  // it is gone already
    const std::string address = remote.address().to_string();
    const auto probes = static_cast<int>(std::count_if(
        entries_.begin(), entries_.end(), [](const Entry& entry) { return entry.health_only; }));
    const auto open = static_cast<int>(entries_.size()) - probes;
    const bool health_only = open >= options_.max_connections || !HasPlace(address);
    if (health_only && probes >= WebServerOptions::kHealthPlaces) {
      refused_->Increment();
      error_code ignored;
      socket.non_blocking(true, ignored);
      constexpr std::string_view kFull =
          "HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\n"
          "Connection: close\r\n\r\n";
      if (options_.tls == nullptr) socket.write_some(net::buffer(kFull), ignored);
      return;
    }
    socket.set_option(Tcp::no_delay(true), error);
    const auto entry = entries_.insert(entries_.end(), Entry{{}, address, health_only});
    WebConnection::Place place = {
        address, health_only,
        [this, entry](const std::string& client) { return Claim(*entry, client); }, Lease(entry)};
    const std::shared_ptr<SSL_CTX> tls =
        options_.tls == nullptr ? nullptr : options_.tls->Get()->context;
    const auto connection = std::make_shared<WebConnection>(
        services_, WebStream::Of(std::move(socket), tls), absl::StrCat(address, ":", remote.port()),
        std::move(place));
    entry->connection = connection;
    connection->Start();
  }

  // Its end, on any thread, frees the place.
  std::shared_ptr<void> Lease(Entries::iterator entry) ABSL_LOCKS_EXCLUDED(mu_) {
    connections_->Increment();
    {
      absl::MutexLock lock(&mu_);
      ++open_;
    }
    return {nullptr, [this, entry](std::nullptr_t) {
              net::post(io_, [this, entry] {
                entries_.erase(entry);
                connections_->Decrement();
                absl::MutexLock lock(&mu_);
                --open_;
              });
            }};
  }

  const WebServerOptions options_;
  const Page page_;
  const Upgrade upgrade_;
  const std::shared_ptr<Gauge> connections_;
  const std::shared_ptr<Counter> refused_;
  FairExecutor workers_;
  net::io_context io_{1};
  net::executor_work_guard<net::io_context::executor_type> keep_running_{io_.get_executor()};
  const WebServices services_{options_, page_, upgrade_, io_, workers_};
  std::optional<Tcp::acceptor> acceptor_;
  net::steady_timer accept_again_{io_};
  Entries entries_;
  std::thread thread_;
  int port_ = 0;

  absl::Mutex mu_;
  int open_ ABSL_GUARDED_BY(mu_) = 0;         // entries, as other threads may know them
  bool closed_ ABSL_GUARDED_BY(mu_) = false;  // no entry will come
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
