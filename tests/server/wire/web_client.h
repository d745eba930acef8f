#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>

namespace robostress {

// A client on a plain socket that knows HTTP and WebSocket frames (RFC 6455) by their bytes alone.
class WebClient {
 public:
  explicit WebClient(int port, double timeout_s = 20) {
    fd_ = socket(AF_INET, SOCK_STREAM, 0);
    timeval timeout{static_cast<time_t>(timeout_s),
                    static_cast<suseconds_t>(1e6 * (timeout_s - static_cast<int>(timeout_s)))};
    setsockopt(fd_, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(fd_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  }
  virtual ~WebClient() { Close(); }
  WebClient(const WebClient&) = delete;
  WebClient& operator=(const WebClient&) = delete;

  int fd() const { return fd_; }
  void Close() {
    if (fd_ >= 0) close(fd_);
    fd_ = -1;
  }
  bool Send(const std::string& bytes) {
    size_t sent = 0;
    while (sent < bytes.size()) {
      const ssize_t n = Write(bytes.data() + sent, bytes.size() - sent);
      if (n <= 0) return false;
      sent += static_cast<size_t>(n);
    }
    return true;
  }
  // What comes until the end; empty bytes at the end or after the timeout.
  std::string Receive(size_t size) {
    std::string bytes;
    while (bytes.size() < size) {
      char buffer[65536];
      const ssize_t n = ReadSome(buffer, std::min(size - bytes.size(), sizeof buffer));
      if (n <= 0) break;
      bytes.append(buffer, static_cast<size_t>(n));
    }
    return bytes;
  }

  // Status and body of a request; the connection is closed after it.
  std::pair<int, std::string> Get(const std::string& target, const std::string& headers = "",
                                  const std::string& method = "GET",
                                  const std::string& host = "127.0.0.1") {
    Send(method + " " + target + " HTTP/1.1\r\nHost: " + host + "\r\nConnection: close\r\n" +
         headers + "\r\n");
    const std::string answer = Receive(SIZE_MAX);
    const size_t body = answer.find("\r\n\r\n");
    if (answer.size() < 12 || body == std::string::npos) return {0, answer};
    head_ = answer.substr(0, body);
    return {std::stoi(answer.substr(9, 3)), answer.substr(body + 4)};
  }
  const std::string& head() const { return head_; }

  // The status line's number: 101 when the WebSocket is open.
  int Upgrade(const std::string& headers = "", const std::string& host = "127.0.0.1") {
    Send("GET / HTTP/1.1\r\nHost: " + host +
         "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
         "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" +
         headers + "\r\n");
    head_.clear();
    while (head_.find("\r\n\r\n") == std::string::npos) {
      const std::string byte = Receive(1);
      if (byte.empty()) return 0;
      head_ += byte;
    }
    return std::stoi(head_.substr(9, 3));
  }

  enum Opcode { kText = 1, kBinary = 2, kClose = 8, kPing = 9, kPong = 10 };
  struct Frame {
    int opcode = -1;  // -1: the connection ended
    std::string payload;
    int close_code() const {
      return payload.size() < 2
                 ? 0
                 : static_cast<uint8_t>(payload[0]) << 8 | static_cast<uint8_t>(payload[1]);
    }
  };
  // One whole message, masked as a client must.
  static std::string FrameBytes(const std::string& payload, Opcode opcode = kBinary) {
    std::string bytes(1, static_cast<char>(0x80 | opcode));
    const uint64_t size = payload.size();
    if (size < 126) {
      bytes += static_cast<char>(0x80 | size);
    } else if (size < 65536) {
      bytes += static_cast<char>(0x80 | 126);
      for (int i = 1; i >= 0; --i) bytes += static_cast<char>(size >> (8 * i));
    } else {
      bytes += static_cast<char>(0x80 | 127);
      for (int i = 7; i >= 0; --i) bytes += static_cast<char>(size >> (8 * i));
    }
    const char mask[] = {0x12, 0x34, 0x56, 0x78};
    bytes.append(mask, 4);
    const size_t begin = bytes.size();
    bytes += payload;
    for (size_t i = 0; i < payload.size(); ++i) bytes[begin + i] ^= mask[i % 4];
    return bytes;
  }
  bool SendFrame(const std::string& payload, Opcode opcode = kBinary) {
    return Send(FrameBytes(payload, opcode));
  }
  Frame Read() {
    Frame frame;
    const std::string head = Receive(2);
    if (head.size() < 2) return frame;
    uint64_t size = static_cast<uint8_t>(head[1]) & 0x7f;
    if (size >= 126) {
      const std::string more = Receive(size == 126 ? 2 : 8);
      size = 0;
      for (const char c : more) size = size << 8 | static_cast<uint8_t>(c);
    }
    frame.payload = Receive(size);
    frame.opcode = static_cast<uint8_t>(head[0]) & 0x0f;
    return frame;
  }

 private:
  // What goes over the socket; a subclass may encrypt it.
  virtual ssize_t Write(const char* bytes, size_t size) {
    return send(fd_, bytes, size, MSG_NOSIGNAL);
  }
  virtual ssize_t ReadSome(char* bytes, size_t size) { return recv(fd_, bytes, size, 0); }

  int fd_ = -1;
  std::string head_;
};

}  // namespace robostress
