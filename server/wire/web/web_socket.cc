#include "server/wire/web/web_socket.h"

#include <spdlog/spdlog.h>

#include <boost/beast/websocket/stream.hpp>
#include <chrono>
#include <exception>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace websocket = boost::beast::websocket;

// The reason that openpi's server closes with; its clients only look at the text frame before it.
constexpr char kErrorReason[] = "Internal server error. Traceback included in previous frame.";

// A buffer may hold this much beyond the message that is being read.
constexpr size_t kReadAheadBytes = 4096;

}  // namespace

struct WebSocketSession::Answered {
  absl::StatusOr<std::string> answer;
  uint64_t largest_message = 0;
};

WebSocketSession::WebSocketSession(const WebServices& services, WebStream stream, Opened opened,
                                   std::string peer, std::weak_ptr<void> owner)
    : services_(services),
      stream_(std::move(stream)),
      opened_(std::move(opened)),
      peer_(std::move(peer)),
      owner_(std::move(owner)),
      socket_(std::make_unique<Socket>(stream_)),
      send_limit_(services.io) {}

WebSocketSession::~WebSocketSession() = default;

// Pings, and the end of a peer that does not answer them, only while something is read: a peer is
// not blamed for the time that its answer takes. The closing handshake keeps its limit.
void WebSocketSession::LimitIdle(bool limit) {
  websocket::stream_base::timeout timeout{};
  timeout.handshake_timeout = absl::ToChronoMilliseconds(services_.options.request_timeout);
  timeout.idle_timeout = limit ? absl::ToChronoMilliseconds(services_.options.idle_timeout)
                               : websocket::stream_base::none();
  timeout.keep_alive_pings = true;
  socket_->set_option(timeout);
}

void WebSocketSession::Start(boost::beast::http::request<boost::beast::http::string_body> request) {
  stream_.ExpireAfter(absl::InfiniteDuration());  // the WebSocket has limits of its own
  LimitIdle(false);
  socket_->auto_fragment(false);
  socket_->binary(true);
  auto kept = std::make_unique<decltype(request)>(std::move(request));
  const auto& asked = *kept;
  socket_->async_accept(asked, [this, kept = std::move(kept), hold = Hold()](Error error) {
    if (!error) Send(std::move(opened_.greeting), [this] { Read(); });
  });
}

void WebSocketSession::Read() {
  if (going_away_) {
    Close(websocket::close_code::going_away);
    return;
  }
  const uint64_t largest = services_.options.max_message_bytes != 0
                               ? services_.options.max_message_bytes
                               : opened_.largest_message;
  socket_->read_message_max(largest);
  // Without it the buffer would double past the limit; with a session's smaller limit it shrinks.
  buffer_.clear();
  buffer_.max_size(largest + kReadAheadBytes);
  if (buffer_.capacity() > buffer_.max_size()) buffer_.shrink_to_fit();
  LimitIdle(true);
  reading_ = true;
  socket_->async_read(buffer_, [this, hold = Hold()](Error error, size_t) { OnRead(error); });
}

void WebSocketSession::OnRead(Error error) {
  reading_ = false;
  LimitIdle(false);
  if (error) {
    if (error != websocket::error::closed && !going_away_)
      spdlog::info("{}: {}: cut: {}", services_.options.name, peer_, error.message());
    return;
  }
  if (socket_->got_text()) {
    OnAnswered({absl::InvalidArgumentError(
                    "text frame: observations are binary frames with a msgpack map"),
                0});
    return;
  }
  const std::string_view message(static_cast<const char*>(buffer_.data().data()), buffer_.size());
  const auto answer = [conversation = opened_.conversation.get(), message] {
    Answered answered;
    try {
      answered.answer = conversation->Answer(message);
      answered.largest_message = conversation->LargestMessage();
    } catch (const std::exception& failed) {  // out of memory: this client's end, not the server's
      answered.answer =
          absl::InternalError(absl::StrCat("the message was not answered: ", failed.what()));
    }
    return answered;
  };
  WorkThen(services_, opened_.client, "", answer,
           [this, hold = Hold()](Answered answered) { OnAnswered(std::move(answered)); });
}

void WebSocketSession::OnAnswered(Answered answered) {
  if (answered.answer.ok()) {
    opened_.largest_message = answered.largest_message;
    Send(*std::move(answered.answer), [this] { Read(); });
    return;
  }
  socket_->text(true);
  Send(std::string(answered.answer.status().message()), [this] {
    Close({websocket::close_code::internal_error, kErrorReason});
  });
}

void WebSocketSession::Send(std::string message, absl::AnyInvocable<void()> then) {
  sending_ = std::move(message);
  send_limit_.expires_after(absl::ToChronoMilliseconds(services_.options.idle_timeout));
  send_limit_.async_wait([this, owner = owner_](Error error) {
    if (error) return;
    const std::shared_ptr<void> hold = owner.lock();
    // It may have been put off after this was due.
    if (hold == nullptr || send_limit_.expiry() > std::chrono::steady_clock::now()) return;
    spdlog::info("{}: {}: takes no answer", services_.options.name, peer_);
    stream_.Close();
  });
  socket_->async_write(net::buffer(sending_),
                       [this, then = std::move(then), hold = Hold()](Error error, size_t) mutable {
                         send_limit_.expires_at(std::chrono::steady_clock::time_point::max());
                         if (error) {
                           spdlog::info("{}: {}: cut while it was answered: {}",
                                        services_.options.name, peer_, error.message());
                           return;
                         }
                         then();
                       });
}

void WebSocketSession::Close(const websocket::close_reason& reason) {
  if (closing_) return;
  closing_ = true;
  socket_->async_close(reason, [hold = Hold()](Error) {});
}

void WebSocketSession::GoAway() {
  going_away_ = true;
  if (reading_) Close(websocket::close_code::going_away);
}

}  // namespace robostress
