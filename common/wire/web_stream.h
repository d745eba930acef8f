#pragma once

#include <openssl/ssl.h>

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/async_base.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/container/static_vector.hpp>
#include <memory>
#include <string>
#include <utility>

#include "absl/functional/any_invocable.h"
#include "absl/time/time.h"

namespace robostress {

// The bytes of one connection, plain or under TLS, of either side, as Beast's algorithms want a
// stream. What they call is erased, so that HTTP and WebSockets are compiled once for both. A
// handle: a copy is the same stream, which lives as long as one of its operations. Of the I/O
// thread.
class WebStream {
 public:
  using executor_type = boost::asio::ip::tcp::socket::executor_type;
  using Error = boost::system::error_code;
  using Done = absl::AnyInvocable<void(Error)>;
  using Moved = absl::AnyInvocable<void(Error, size_t)>;  // bytes
  // At most so many pieces go out in one operation; the rest follow in the next one.
  using Pieces = boost::container::static_vector<boost::asio::const_buffer, 16>;

  // An accepted connection. `tls` null: plain.
  static WebStream Of(boost::asio::ip::tcp::socket socket, const std::shared_ptr<SSL_CTX>& tls);
  // One to `host`, whose certificate must name it.
  static WebStream To(boost::asio::ip::tcp::socket socket, const std::shared_ptr<SSL_CTX>& tls,
                      const std::string& host);

  executor_type get_executor() { return layer_->executor(); }
  // Succeeds at once where there is no TLS.
  void Handshake(Done done) { layer_->Handshake(std::move(done)); }
  // What is wrong with the certificate that the peer showed; empty: nothing.
  std::string certificate_error() { return layer_->certificate_error(); }
  // CertificateOwner of what the peer showed; empty: nothing.
  std::string certificate_owner() { return layer_->certificate_owner(); }
  // Operations begun from now on fail when `limit` from now is over; infinite: never.
  void ExpireAfter(absl::Duration limit) { layer_->ExpireAfter(limit); }
  // Nothing more is sent.
  void ShutdownSend() { layer_->ShutdownSend(); }
  // What is under way fails.
  void Close() { layer_->Close(); }

  template <class Buffers, class Handler>
  auto async_read_some(const Buffers& buffers, Handler&& handler)
      -> BOOST_BEAST_ASYNC_RESULT2(Handler) {
    return boost::asio::async_initiate<Handler, void(Error, size_t)>(
        [layer = layer_](auto&& moved, const Buffers& into) {
          boost::asio::mutable_buffer piece;
          const auto end = boost::asio::buffer_sequence_end(into);
          for (auto at = boost::asio::buffer_sequence_begin(into); at != end; ++at) {
            piece = *at;
            if (piece.size() > 0) break;
          }
          layer->Read(piece, std::forward<decltype(moved)>(moved));
        },
        handler, buffers);
  }
  template <class Buffers, class Handler>
  auto async_write_some(const Buffers& buffers, Handler&& handler)
      -> BOOST_BEAST_ASYNC_RESULT2(Handler) {
    return boost::asio::async_initiate<Handler, void(Error, size_t)>(
        [layer = layer_](auto&& moved, const Buffers& from) {
          Pieces pieces;
          const auto end = boost::asio::buffer_sequence_end(from);
          for (auto at = boost::asio::buffer_sequence_begin(from);
               at != end && pieces.size() < pieces.capacity(); ++at) {
            const boost::asio::const_buffer piece = *at;
            if (piece.size() > 0) pieces.push_back(piece);
          }
          layer->Write(pieces, std::forward<decltype(moved)>(moved));
        },
        handler, buffers);
  }

  // What a WebSocket asks of the stream below it.
  friend void beast_close_socket(WebStream& stream) { stream.Close(); }
  template <class Handler>
  friend void async_teardown(boost::beast::role_type, WebStream& stream, Handler&& handler) {
    stream.layer_->Teardown(std::forward<Handler>(handler));
  }

 private:
  class Layer {
   public:
    virtual ~Layer() = default;
    virtual executor_type executor() = 0;
    virtual void Handshake(Done done) = 0;
    virtual std::string certificate_error() = 0;
    virtual std::string certificate_owner() = 0;
    virtual void ExpireAfter(absl::Duration limit) = 0;
    virtual void ShutdownSend() = 0;
    virtual void Close() = 0;
    virtual void Read(boost::asio::mutable_buffer into, Moved moved) = 0;
    virtual void Write(const Pieces& from, Moved moved) = 0;
    // Says goodbye, and reads what still comes until the peer's end.
    virtual void Teardown(Done done) = 0;
  };
  template <class Stream>
  class LayerOf;
  class PlainLayer;
  class TlsLayer;

  explicit WebStream(std::shared_ptr<Layer> layer) : layer_(std::move(layer)) {}

  std::shared_ptr<Layer> layer_;
};

}  // namespace robostress
