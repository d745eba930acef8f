#include "common/wire/web_stream.h"

#include <openssl/x509v3.h>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/ssl/ssl_stream.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <boost/beast/websocket/teardown.hpp>

#include "common/wire/tls_pem.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace beast = boost::beast;
using Tcp = net::ip::tcp;

// The context of a connection, which may outlive its replacement by another one.
net::ssl::context ContextOf(SSL_CTX* tls) {
  SSL_CTX_up_ref(tls);  // of which Asio's context takes one
  return net::ssl::context(tls);
}

}  // namespace

// What both share. An operation under way holds its layer: a stream must not go before it.
template <class Stream>
class WebStream::LayerOf : public Layer, public std::enable_shared_from_this<LayerOf<Stream>> {
 public:
  template <class... Arguments>
  explicit LayerOf(beast::role_type role, Arguments&&... arguments)
      : role_(role), stream_(std::forward<Arguments>(arguments)...) {}

  executor_type executor() override { return stream_.get_executor(); }
  std::string certificate_error() override { return {}; }
  std::string certificate_owner() override { return {}; }
  void ExpireAfter(absl::Duration limit) override {
    if (limit == absl::InfiniteDuration()) {
      tcp().expires_never();
    } else {
      tcp().expires_after(absl::ToChronoMilliseconds(limit));
    }
  }
  void ShutdownSend() override {
    Error ignored;
    tcp().socket().shutdown(Tcp::socket::shutdown_send, ignored);
  }
  void Close() override { tcp().close(); }
  void Read(net::mutable_buffer into, Moved moved) override {
    stream_.async_read_some(into, [moved = std::move(moved), self = this->shared_from_this()](
                                      Error error, size_t bytes) mutable { moved(error, bytes); });
  }
  void Write(const Pieces& from, Moved moved) override {
    stream_.async_write_some(from, [moved = std::move(moved), self = this->shared_from_this()](
                                       Error error, size_t bytes) mutable { moved(error, bytes); });
  }
  void Teardown(Done done) override {
    using beast::websocket::async_teardown;
    async_teardown(role_, stream_,
                   [done = std::move(done), self = this->shared_from_this()](Error error) mutable {
                     done(error);
                   });
  }

 protected:
  beast::tcp_stream& tcp() { return beast::get_lowest_layer(stream_); }

  const beast::role_type role_;
  Stream stream_;
};

class WebStream::PlainLayer final : public LayerOf<beast::tcp_stream> {
 public:
  using LayerOf::LayerOf;
  void Handshake(Done done) override {
    net::post(executor(), [done = std::move(done)]() mutable { done({}); });
  }
};

class WebStream::TlsLayer final : public LayerOf<beast::ssl_stream<beast::tcp_stream>> {
 public:
  TlsLayer(beast::role_type role, Tcp::socket socket, net::ssl::context context)
      : LayerOf(role, std::move(socket), context) {}
  // Whose certificate is taken; without it any that the context trusts.
  void Expect(const std::string& host) {
    SSL* const ssl = stream_.native_handle();
    Error error;
    net::ip::make_address(host, error);
    if (error) {
      SSL_set_tlsext_host_name(ssl, host.c_str());
      SSL_set1_host(ssl, host.c_str());
    } else {
      X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(ssl), host.c_str());
    }
  }
  void Handshake(Done done) override {
    stream_.async_handshake(
        role_ == beast::role_type::server ? net::ssl::stream_base::server
                                          : net::ssl::stream_base::client,
        [done = std::move(done), self = shared_from_this()](Error error) mutable { done(error); });
  }
  std::string certificate_error() override {
    const long result = SSL_get_verify_result(stream_.native_handle());
    return result == X509_V_OK ? "" : X509_verify_cert_error_string(result);
  }
  std::string certificate_owner() override {
    X509* const shown = SSL_get1_peer_certificate(stream_.native_handle());
    std::string owner = CertificateOwner(shown);
    X509_free(shown);
    return owner;
  }
};

WebStream WebStream::Of(Tcp::socket socket, const std::shared_ptr<SSL_CTX>& tls) {
  constexpr auto kRole = beast::role_type::server;
  if (tls == nullptr) return WebStream(std::make_shared<PlainLayer>(kRole, std::move(socket)));
  // The connection's SSL holds the context from here on.
  return WebStream(std::make_shared<TlsLayer>(kRole, std::move(socket), ContextOf(tls.get())));
}

WebStream WebStream::To(Tcp::socket socket, const std::shared_ptr<SSL_CTX>& tls,
                        const std::string& host) {
  constexpr auto kRole = beast::role_type::client;
  if (tls == nullptr) return WebStream(std::make_shared<PlainLayer>(kRole, std::move(socket)));
  auto layer = std::make_shared<TlsLayer>(kRole, std::move(socket), ContextOf(tls.get()));
  layer->Expect(host);
  return WebStream(std::move(layer));
}

}  // namespace robostress
