#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"

namespace robostress {

// A policy server of the tests' own on a loopback port: any number of WebSockets, each with a
// thread that does what the test says. What is no WebSocket is answered 200, as openpi's /healthz.
class Upstream {
 public:
  using Tcp = boost::asio::ip::tcp;
  using Socket = boost::beast::websocket::stream<Tcp::socket>;
  using Error = boost::system::error_code;
  using Request = boost::beast::http::request<boost::beast::http::string_body>;

  // `script` of an open socket, with the request that opened it. `refuse`: an HTTP status instead.
  explicit Upstream(std::function<void(Socket&, const Request&)> script, int port = 0,
                    unsigned refuse = 0)
      : script_(std::move(script)),
        refuse_(refuse),
        acceptor_(io_, Tcp::endpoint(boost::asio::ip::make_address("127.0.0.1"),
                                     static_cast<uint16_t>(port))),
        port_(acceptor_.local_endpoint().port()),
        thread_([this] { Accept(); }) {}
  ~Upstream() {
    stopped_ = true;
    Error ignored;
    {
      boost::asio::io_context io;
      Tcp::socket(io).connect(Tcp::endpoint(boost::asio::ip::make_address("127.0.0.1"), port_),
                              ignored);
    }
    thread_.join();
    acceptor_.close(ignored);
    CutAll();
    for (std::thread& talk : talks_) talk.join();
  }
  // Every connection ends without a word.
  void CutAll() {
    const std::lock_guard lock(mutex_);
    Error ignored;
    for (Tcp::socket* socket : sockets_) socket->shutdown(Tcp::socket::shutdown_both, ignored);
  }

  int port() const { return port_; }
  std::string url() const { return absl::StrCat("ws://127.0.0.1:", port_); }
  int opened() const { return opened_; }

  struct Message {
    bool text = false;
    std::string bytes;
  };
  // Nothing: the client is gone.
  static std::optional<Message> Read(Socket& socket) {
    boost::beast::flat_buffer buffer;
    Error error;
    socket.read(buffer, error);
    if (error) return std::nullopt;
    return Message{socket.got_text(),
                   {static_cast<const char*>(buffer.data().data()), buffer.size()}};
  }
  static void Write(Socket& socket, const std::string& bytes, bool text = false) {
    Error ignored;
    socket.text(text);
    socket.write(boost::asio::buffer(bytes), ignored);
  }

 private:
  void Accept() {
    while (true) {
      Error error;
      Tcp::socket socket(io_);
      acceptor_.accept(socket, error);
      if (stopped_ || error) return;
      socket.set_option(Tcp::no_delay(true), error);
      const std::lock_guard lock(mutex_);
      talks_.emplace_back([this, socket = std::move(socket)]() mutable { Talk(socket); });
    }
  }
  void Talk(Tcp::socket& plain) {
    namespace http = boost::beast::http;
    Remember(&plain, true);
    Error error;
    boost::beast::flat_buffer buffer;
    Request request;
    http::read(plain, buffer, request, error);
    if (!error && (!boost::beast::websocket::is_upgrade(request) || refuse_ != 0)) {
      http::response<http::string_body> answer(
          static_cast<http::status>(refuse_ == 0 ? 200 : refuse_), 11);
      answer.body() = refuse_ == 0 ? "OK\n" : "go away\n";
      answer.prepare_payload();
      http::write(plain, answer, error);
      error = boost::beast::http::error::end_of_stream;
    }
    Remember(&plain, false);
    if (error) return;
    Socket socket(std::move(plain));
    Remember(&socket.next_layer(), true);
    socket.read_message_max(uint64_t{256} << 20);
    socket.accept(request, error);
    socket.binary(true);
    if (!error) {
      ++opened_;
      script_(socket, request);
    }
    Remember(&socket.next_layer(), false);
  }
  void Remember(Tcp::socket* socket, bool open) {
    const std::lock_guard lock(mutex_);
    if (open) {
      sockets_.push_back(socket);
    } else {
      std::erase(sockets_, socket);
    }
  }

  const std::function<void(Socket&, const Request&)> script_;
  const unsigned refuse_;
  boost::asio::io_context io_;
  Tcp::acceptor acceptor_;
  const int port_;
  std::atomic<bool> stopped_{false};
  std::atomic<int> opened_{0};
  std::mutex mutex_;
  std::vector<std::thread> talks_;
  std::vector<Tcp::socket*> sockets_;
  std::thread thread_;
};

}  // namespace robostress
