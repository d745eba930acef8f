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
#include <chrono>
#include <exception>
#include <list>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "common/wire/tls_client.h"
#include "common/wire/web_url.h"
#include "server/proxy/relay_link.h"

namespace robostress {
namespace {

namespace net = boost::asio;
using Tcp = net::ip::tcp;
using Error = boost::system::error_code;

constexpr auto kProbe = std::chrono::seconds(2);
constexpr int kGoodbyes = 50;  // looks, 20 ms apart
constexpr auto kSayAgain = std::chrono::seconds(10);
constexpr int kIdleProbes = 5;  // of probe_period, between two where the upstream was there

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

}  // namespace

// All of it but `figures_` is of the I/O thread, once that runs.
class Relay::Impl {
 public:
  Impl(const RelayOptions& options, WebUrl upstream, std::shared_ptr<SSL_CTX> tls,
       Tcp::endpoint endpoint, MakeTap make)
      : endpoint_(std::move(endpoint)) {
    links_.options = options;
    links_.upstream = std::move(upstream);
    links_.upstream_tls = std::move(tls);
    links_.make = std::move(make);
    links_.gone = [this](const std::string& why) { Disappear(why); };
    links_.look_in = [this](std::chrono::milliseconds pause) { ProbeIn(pause); };
  }
  ~Impl();

  absl::Status Start() {
    RS_RETURN_IF_ERROR(Reserve());
    net::post(io_, [this] { Probe(); });
    thread_ = std::thread([this] { Run(); });
    return absl::OkStatus();
  }

  int port() const { return port_; }
  RelayFigures figures() const {
    return {there_, links_.clients, links_.accepted, links_.refused, links_.upstream_lost};
  }

 private:
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
      return absl::UnavailableError(absl::StrCat("cannot listen on ", links_.options.listen, ": ",
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
      spdlog::error("proxy: cannot listen on {}: {}", links_.options.listen, error.message());
      there_ = false;
      return;
    }
    spdlog::info("proxy: {} is there: clients may come", links_.upstream.text());
    Accept();
  }
  void Disappear(const std::string& why) {
    if (!there_.exchange(false)) {
      if (!std::exchange(said_absent_, true))
        spdlog::warn("proxy: {} is not there ({}): clients are refused until it is",
                     links_.upstream.text(), why);
      return;
    }
    spdlog::warn("proxy: {} is gone ({}): clients are refused until it is back",
                 links_.upstream.text(), why);
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
    const auto period = absl::ToChronoMilliseconds(links_.options.probe_period);
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
    if (there_ && links_.clients > 0) return NextProbe();  // their connections say it
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
        links_.upstream.host, absl::StrCat(links_.upstream.port),
        [this, asked, over](Error error, const Tcp::resolver::results_type& found) {
          if (error || asked->over) return over(false, error.message());
          net::async_connect(
              asked->socket, found, [this, asked, over](Error error, const Tcp::endpoint&) {
                if (error || links_.upstream.tls) return over(!error, error.message());
                asked->request =
                    absl::StrCat("GET /healthz HTTP/1.1\r\nHost: ", links_.upstream.authority(),
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
    if (links_.clients == 0 || looks == 0) return io_.stop();
    probe_timer_.expires_after(std::chrono::milliseconds(20));
    probe_timer_.async_wait([this, looks](Error) { StopWhenGone(looks - 1); });
  }

  Tcp::endpoint endpoint_;
  // Before `io_`, whose end is that of the links which it still holds.
  RelayLinks links_;
  bool stopped_ = false, said_absent_ = false;
  std::chrono::steady_clock::time_point said_full_, said_deaf_;
  std::atomic<int> port_{0};
  std::atomic<bool> there_{false};
  net::io_context io_{1};
  net::executor_work_guard<net::io_context::executor_type> keep_running_{io_.get_executor()};
  std::optional<Tcp::acceptor> acceptor_;
  net::steady_timer probe_timer_{io_}, accept_again_{io_};
  std::list<std::weak_ptr<RelayLink>> all_;
  std::thread thread_;
};

void Relay::Impl::Add(Tcp::socket socket) {
  Error error;
  const Tcp::endpoint remote = socket.remote_endpoint(error);
  if (error) return;  // it is gone already
  if (links_.clients >= links_.options.max_clients && !MakeRoom()) {
    ++links_.refused;
    if (Seldom(said_full_)) {
      spdlog::warn(
          "proxy: {} clients are connected, which is as many as may be (--max-clients); {} were "
          "refused so far",
          links_.options.max_clients, links_.refused.load());
    }
    return;  // the socket's end
  }
  socket.set_option(Tcp::no_delay(true), error);
  const std::shared_ptr<SSL_CTX> tls =
      links_.options.tls == nullptr ? nullptr : links_.options.tls->Get()->context;
  all_.remove_if([](const std::weak_ptr<RelayLink>& one) { return one.expired(); });
  all_.push_back(RelayLink::Start(links_, io_, std::move(socket),
                                  absl::StrCat(remote.address().to_string(), ":", remote.port()),
                                  tls));
}

bool Relay::Impl::MakeRoom() {
  for (const std::weak_ptr<RelayLink>& one : all_) {
    const std::shared_ptr<RelayLink> link = one.lock();
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
    for (const std::weak_ptr<RelayLink>& one : all_) {
      if (const std::shared_ptr<RelayLink> link = one.lock()) link->GoAway();
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
