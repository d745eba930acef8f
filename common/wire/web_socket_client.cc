#include "common/wire/web_socket_client.h"

#include <pthread.h>

#include <algorithm>
#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/field.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <chrono>
#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "common/monotonic_wait.h"
#include "common/status_macros.h"
#include "common/wire/tls_client.h"
#include "common/wire/web_stream.h"
#include "common/wire/web_url.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace beast = boost::beast;
namespace websocket = beast::websocket;
using Tcp = net::ip::tcp;

// Answers come one by one, and perhaps a last word; a peer that sends more asks for memory.
constexpr size_t kMostUnread = 4;
constexpr size_t kWriteBytes = 64 << 10;  // are masked at a time
constexpr absl::Duration kGoodbye = absl::Seconds(1);

bool IsHeaderText(const std::string& text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c < 127; });
}

}  // namespace

// All that is not guarded by `mu_` is of the I/O thread, once it runs.
class WebSocketClient::Impl {
 public:
  Impl(WebUrl url, const WebSocketOptions& options, std::shared_ptr<SSL_CTX> tls)
      : options_(options), url_(std::move(url)), address_(url_.text()), tls_(std::move(tls)) {}

  ~Impl() {
    if (!thread_.joinable()) return;
    net::post(io_, [this] { SayGoodbye(); });
    thread_.join();
  }

  absl::Status Connect() ABSL_LOCKS_EXCLUDED(mu_) {
    net::post(io_, [this] { LookUp(); });
    thread_ = std::thread([this] {
      pthread_setname_np(pthread_self(), "web-client");
      io_.run();
    });
    const auto settled = [this] {
      mu_.AssertHeld();
      return open_ || !end_.ok();
    };
    absl::MutexLock lock(&mu_);
    mu_.Await(absl::Condition(&settled));
    return open_ ? absl::OkStatus() : end_;  // what ended it since then is the next call's
  }

  absl::Status Send(std::string message) ABSL_LOCKS_EXCLUDED(mu_) {
    {
      absl::MutexLock lock(&mu_);
      RS_RETURN_IF_ERROR(end_);
      sent_ = false;
    }
    net::post(io_, [this, message = std::move(message)]() mutable {
      sending_ = std::move(message);
      socket_->async_write(net::buffer(sending_), [this](Error error, size_t) {
        if (error) return Lost(error);
        absl::MutexLock lock(&mu_);
        sent_ = true;
      });
    });
    const auto settled = [this] {
      mu_.AssertHeld();
      return sent_ || !end_.ok();
    };
    absl::MutexLock lock(&mu_);
    if (!AwaitFor(mu_, settled, options_.send_timeout)) {
      EndLocked(absl::DeadlineExceededError(
          absl::StrCat(address_, " takes nothing for ", absl::FormatDuration(options_.send_timeout),
                       "; see what keeps the policy server busy, and connect again")));
    }
    return sent_ ? absl::OkStatus() : end_;
  }

  absl::StatusOr<WebSocketMessage> Receive(absl::Duration limit) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    if (!AwaitLocked(limit)) {
      EndLocked(absl::DeadlineExceededError(absl::StrCat(
          address_, " does not answer within ", absl::FormatDuration(limit),
          "; allow it more time, or see what keeps the policy server busy, and connect again")));
    }
    if (unread_.empty()) return end_;
    return TakeLocked();
  }

  bool Await(absl::Duration limit) const ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    return AwaitLocked(limit);
  }

  std::optional<WebSocketMessage> TakeUnread() ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    if (unread_.empty()) return std::nullopt;
    return TakeLocked();
  }

  const std::string& address() const { return address_; }
  int close_code() const ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    return close_code_;
  }

 private:
  using Socket = websocket::stream<WebStream, false>;
  using Error = boost::system::error_code;

  bool AwaitLocked(absl::Duration limit) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const auto settled = [this] {
      mu_.AssertHeld();
      return !unread_.empty() || !end_.ok();
    };
    return AwaitFor(mu_, settled, limit);
  }
  WebSocketMessage TakeLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    WebSocketMessage message = std::move(unread_.front());
    unread_.pop_front();
    return message;
  }

  // The connection's end, with the first reason that there was.
  void EndLocked(absl::Status reason) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (!end_.ok()) return;
    end_ = std::move(reason);
    net::post(io_, [this] { Cut(); });
  }
  void End(absl::Status reason) ABSL_LOCKS_EXCLUDED(mu_) {
    absl::MutexLock lock(&mu_);
    EndLocked(std::move(reason));
  }
  template <class... Parts>
  void Unavailable(const Parts&... parts) {
    End(absl::UnavailableError(absl::StrCat(address_, ": ", parts...)));
  }
  // What is under way fails, and the I/O thread runs out of work.
  void Cut() {
    Error ignored;
    limit_.cancel();
    resolver_.cancel();
    tcp_.close(ignored);
    if (stream_) stream_->Close();
  }
  void Limit(absl::Duration limit) {
    limit_.expires_after(absl::ToChronoMilliseconds(limit));
    limit_.async_wait([this, limit](Error error) {
      // It may have been put off after this was due.
      if (error || limit_.expiry() > std::chrono::steady_clock::now()) return;
      End(absl::DeadlineExceededError(absl::StrCat(address_, ": not open within ",
                                                   absl::FormatDuration(limit), ", while ", stage_,
                                                   "; is a policy server there?")));
    });
  }

  void LookUp() {
    stage_ = "its name is looked up";
    Limit(options_.connect_timeout);
    resolver_.async_resolve(url_.host, absl::StrCat(url_.port),
                            [this](Error error, const Tcp::resolver::results_type& found) {
                              if (error) {
                                Unavailable("cannot find ", url_.host, ": ", error.message(),
                                            "; check the name");
                              } else {
                                Dial(found);
                              }
                            });
  }

  void Dial(const Tcp::resolver::results_type& found) {
    stage_ = "it is dialled";
    net::async_connect(tcp_, found, [this](Error error, const Tcp::endpoint& peer) {
      if (error) {
        Unavailable(error.message(), "; start the policy server there, or correct the port");
        return;
      }
      if (!url_.tls && !options_.secrets.token.empty() && !peer.address().is_loopback()) {
        End(absl::FailedPreconditionError(
            absl::StrCat(address_, ": without TLS the token is readable on the way; use wss://")));
        return;
      }
      Error ignored;
      tcp_.set_option(Tcp::no_delay(true), ignored);
      Secure();
    });
  }

  void Secure() {
    stage_ = "TLS is opened";
    stream_.emplace(WebStream::To(std::move(tcp_), tls_, url_.host));
    stream_->ExpireAfter(absl::InfiniteDuration());  // `limit_` is the limit
    stream_->Handshake([this](Error error) {
      if (!error) return Shake();
      const std::string why = stream_->certificate_error();
      Unavailable("TLS: ", why.empty() ? error.message() : why,
                  why.empty() ? "; is it a wss server?"
                              : "; trust what signed the server's certificate with "
                                "ROBOSTRESS_TLS_CA, and dial the name that stands in it");
    });
  }

  void Shake() {
    stage_ = "the WebSocket is asked for";
    socket_.emplace(*stream_);
    websocket::stream_base::timeout timeout{};
    timeout.handshake_timeout = websocket::stream_base::none();
    timeout.idle_timeout = websocket::stream_base::none();
    timeout.keep_alive_pings = false;
    socket_->set_option(timeout);
    socket_->set_option(websocket::stream_base::decorator([this](websocket::request_type& request) {
      request.set(beast::http::field::user_agent, "robostress");
      if (options_.secrets.token.empty()) return;
      request.set(beast::http::field::authorization,
                  absl::StrCat(options_.token_scheme, " ", options_.secrets.token));
    }));
    socket_->async_handshake(response_, url_.authority(), url_.target, [this](Error error) {
      if (error) return Declined(error);
      limit_.cancel();
      socket_->auto_fragment(false);
      socket_->binary(true);
      socket_->write_buffer_bytes(kWriteBytes);
      socket_->read_message_max(options_.max_message_bytes);
      {
        absl::MutexLock lock(&mu_);
        open_ = true;
      }
      Read();
    });
  }

  void Declined(Error error) {
    if (error != websocket::error::upgrade_declined) {
      Unavailable("speaks no WebSocket: ", error.message(), "; is it a policy server's port?");
      return;
    }
    const int status = response_.result_int();
    std::string body = response_.body().substr(0, 512);
    absl::StripAsciiWhitespace(&body);
    const auto refuse = [&](absl::StatusCode code, const char* remedy) {
      End(absl::Status(code, absl::StrCat(address_, " answers HTTP ", status, " to a WebSocket",
                                          body.empty() ? "" : ": ", body, remedy)));
    };
    switch (status) {
      case 401:
        return refuse(absl::StatusCode::kUnauthenticated,
                      options_.secrets.token.empty()
                          ? "; name the file of its token in ROBOSTRESS_TOKEN_FILE"
                          : "; it does not know the token that ROBOSTRESS_TOKEN_FILE names");
      case 403:
        return refuse(absl::StatusCode::kPermissionDenied, "; ask for a token that may");
      case 404:
        return refuse(absl::StatusCode::kNotFound, "; check the path");
      default:
        return refuse(absl::StatusCode::kUnavailable,
                      status == 503 ? "; come back later" : "; is it a policy server's port?");
    }
  }

  void Read() {
    socket_->async_read(buffer_, [this](Error error, size_t) {
      if (error) return Lost(error);
      {
        absl::MutexLock lock(&mu_);
        const auto* const data = static_cast<const char*>(buffer_.data().data());
        if (unread_.size() <= kMostUnread)  // more may be on its way when it ends
          unread_.push_back({socket_->got_text(), std::string(data, buffer_.size())});
        if (unread_.size() > kMostUnread) {
          EndLocked(absl::ResourceExhaustedError(absl::StrCat(
              address_, " sends more than it is asked for; is it a policy server's port?")));
        }
      }
      buffer_.clear();
      Read();
    });
  }

  void Lost(Error error) {
    if (error == websocket::error::closed) {
      const websocket::close_reason& reason = socket_->reason();
      {
        absl::MutexLock lock(&mu_);
        close_code_ = reason.code;
      }
      Unavailable("closed with ", reason.code, reason.reason.empty() ? "" : ": ",
                  std::string(reason.reason.data(), reason.reason.size()), "; connect again");
    } else if (error == websocket::error::message_too_big ||
               error == websocket::error::buffer_overflow) {
      End(absl::ResourceExhaustedError(absl::StrCat(address_, " sends a message of more than ",
                                                    options_.max_message_bytes, " bytes")));
    } else {
      Unavailable("lost: ", error.message(), "; connect again when the policy server is back");
    }
  }

  void SayGoodbye() ABSL_LOCKS_EXCLUDED(mu_) {
    {
      absl::MutexLock lock(&mu_);
      if (!open_ || !end_.ok()) return Cut();
    }
    Limit(kGoodbye);
    socket_->async_close(websocket::close_code::normal, [this](Error) { Cut(); });
  }

  const WebSocketOptions options_;
  const WebUrl url_;
  const std::string address_;
  const std::shared_ptr<SSL_CTX> tls_;  // null: plain
  net::io_context io_{1};
  Tcp::resolver resolver_{io_};
  Tcp::socket tcp_{io_};
  net::steady_timer limit_{io_};
  const char* stage_ = "";
  std::optional<WebStream> stream_;
  std::optional<Socket> socket_;
  websocket::response_type response_;
  beast::flat_buffer buffer_;
  std::string sending_;
  std::thread thread_;

  mutable absl::Mutex mu_;
  bool open_ ABSL_GUARDED_BY(mu_) = false;
  bool sent_ ABSL_GUARDED_BY(mu_) = true;  // what was to be sent last
  absl::Status end_ ABSL_GUARDED_BY(mu_);
  std::deque<WebSocketMessage> unread_ ABSL_GUARDED_BY(mu_);
  int close_code_ ABSL_GUARDED_BY(mu_) = 0;
};

WebSocketClient::WebSocketClient(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
WebSocketClient::~WebSocketClient() = default;
absl::Status WebSocketClient::Send(std::string message) { return impl_->Send(std::move(message)); }
absl::StatusOr<WebSocketMessage> WebSocketClient::Receive(absl::Duration limit) {
  return impl_->Receive(limit);
}
bool WebSocketClient::Await(absl::Duration limit) const { return impl_->Await(limit); }
std::optional<WebSocketMessage> WebSocketClient::TakeUnread() { return impl_->TakeUnread(); }
const std::string& WebSocketClient::address() const { return impl_->address(); }
int WebSocketClient::close_code() const { return impl_->close_code(); }

absl::StatusOr<std::unique_ptr<WebSocketClient>> WebSocketClient::Connect(
    const std::string& url, const WebSocketOptions& options) {
  RS_ASSIGN_OR_RETURN(WebUrl parsed, ParseWebUrl(url));
  if (!IsHeaderText(options.secrets.token) || !IsHeaderText(options.token_scheme)) {
    return absl::InvalidArgumentError(
        "the token holds a space, or what is not ASCII; is it the right file?");
  }
  std::shared_ptr<SSL_CTX> tls;
  if (parsed.tls) {
    RS_ASSIGN_OR_RETURN(tls, MakeTlsClient(options.secrets));
  }
  auto impl = std::make_unique<Impl>(std::move(parsed), options, std::move(tls));
  RS_RETURN_IF_ERROR(impl->Connect());
  return std::unique_ptr<WebSocketClient>(new WebSocketClient(std::move(impl)));
}

}  // namespace robostress
