#pragma once

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <functional>
#include <string>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {

// A server of one connection on a loopback port that does what a test says: the other end of a
// client, without any code of our server.
class ScriptedPeer {
 public:
  using Tcp = boost::asio::ip::tcp;
  using Socket = boost::beast::websocket::stream<Tcp::socket>;
  using Error = boost::system::error_code;

  // `script` runs on a thread of its own, with a connection that is accepted.
  explicit ScriptedPeer(std::function<void(Tcp::socket)> script)
      : thread_([this, script = std::move(script)] {
          Error error;
          Tcp::socket socket(io_);
          acceptor_.accept(socket, error);
          if (!error) script(std::move(socket));
        }) {}
  // The same with a WebSocket that is open.
  static ScriptedPeer WebSocket(std::function<void(Socket&)> script) {
    return ScriptedPeer([script = std::move(script)](Tcp::socket socket) {
      Socket web(std::move(socket));
      Error error;
      web.accept(error);
      web.binary(true);
      if (!error) script(web);
    });
  }
  ~ScriptedPeer() {
    // Whoever still waits for a connection gets one that ends at once.
    Error ignored;
    Tcp::socket(io_).connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }
  std::string url() const {
    return absl::StrCat("ws://127.0.0.1:", acceptor_.local_endpoint().port());
  }
  static std::string Read(Socket& web) {
    boost::beast::flat_buffer buffer;
    Error error;
    web.read(buffer, error);
    return error ? std::string()
                 : std::string(static_cast<const char*>(buffer.data().data()), buffer.size());
  }
  static void Write(Socket& web, const std::string& message) {
    Error ignored;
    web.write(boost::asio::buffer(message), ignored);
  }
  // Until the client is gone.
  static void AwaitEnd(Socket& web) {
    while (!Read(web).empty()) {
    }
  }

 private:
  boost::asio::io_context io_;
  Tcp::acceptor acceptor_{io_, Tcp::endpoint(boost::asio::ip::make_address("127.0.0.1"), 0)};
  std::thread thread_;
};

}  // namespace robostress
