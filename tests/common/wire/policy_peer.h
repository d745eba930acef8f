#pragma once

#include <fcntl.h>
#include <sys/socket.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/wire/openpi_value.h"
#include "common/wire/openpi_writer.h"
#include "tests/common/wire/scripted_peer.h"

namespace robostress {

// A policy server that greets every connection and keeps what it was told. `answer` gets the number
// of the connection and of the message on it, from 0; an empty answer ends the connection, one that
// begins with T goes out as text.
class PolicyPeer {
 public:
  using Socket = ScriptedPeer::Socket;
  using Script = std::function<std::string(int connection, int message)>;

  explicit PolicyPeer(Script answer, const std::string& metadata = OpenpiWriter().Map(0).Take())
      : PolicyPeer(std::move(answer), [metadata](int) { return metadata; }) {}
  PolicyPeer(Script answer, uint16_t port)
      : PolicyPeer(
            std::move(answer), [](int) { return OpenpiWriter().Map(0).Take(); }, port) {}
  PolicyPeer(Script answer, std::function<std::string(int)> metadata, uint16_t port = 0)
      : acceptor_(io_, {boost::asio::ip::make_address("127.0.0.1"), port}),
        thread_([this, answer = std::move(answer), metadata = std::move(metadata)] {
          for (int connection = 0; !ended_; ++connection) {
            ScriptedPeer::Error error;
            ScriptedPeer::Tcp::socket socket(io_);
            acceptor_.accept(socket, error);
            if (error || ended_) return;
            Socket web(std::move(socket));
            live_ = web.next_layer().native_handle();
            web.accept(error);
            web.binary(true);
            ScriptedPeer::Write(web, metadata(connection));
            for (int message = 0;; ++message) {
              const std::string told = ScriptedPeer::Read(web);
              if (told.empty()) break;
              {
                const std::lock_guard<std::mutex> lock(mutex_);
                told_.push_back(told);
              }
              const std::string reply = answer(connection, message);
              if (reply.empty()) break;
              web.text(reply[0] == 'T');
              ScriptedPeer::Write(web, reply);
            }
          }
        }) {
    // The port is free when this ends, whatever program a test has started.
    ::fcntl(acceptor_.native_handle(), F_SETFD, FD_CLOEXEC);
  }
  ~PolicyPeer() {
    ended_ = true;
    ::shutdown(live_, SHUT_RDWR);  // whatever it waits for
    ScriptedPeer::Error ignored;
    ScriptedPeer::Tcp::socket(io_).connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }
  std::string url() const { return absl::StrCat("ws://127.0.0.1:", port()); }
  uint16_t port() const { return acceptor_.local_endpoint().port(); }
  std::vector<std::string> told() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return told_;
  }
  int64_t Integer(size_t message, const char* key) const {
    const std::string bytes = told().at(message);
    const OpenpiValue value = *DecodeOpenpi(std::string_view(bytes));
    return std::get<int64_t>(value.Find(key)->value);
  }

 private:
  boost::asio::io_context io_;
  ScriptedPeer::Tcp::acceptor acceptor_;
  std::atomic<bool> ended_ = false;
  std::atomic<int> live_ = -1;  // descriptor of the last connection
  mutable std::mutex mutex_;
  std::vector<std::string> told_;
  std::thread thread_;
};

}  // namespace robostress
