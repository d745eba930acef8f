#include "eval/launch/servers_elsewhere.h"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// Accepts connections at a port of its own until it is closed.
class Listener {
 public:
  Listener() : fd_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    EXPECT_EQ(::bind(fd_, reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(::listen(fd_, 64), 0);
    ::getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  }
  ~Listener() { Close(); }
  void Close() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  std::string url() const { return absl::StrCat("ws://127.0.0.1:", port_, "/policy"); }

 private:
  int fd_, port_ = 0;
};

TEST(ServersElsewhere, AreGivenInTurn) {
  const Listener a, b;
  ServersElsewhere servers({a.url(), b.url()});
  for (const Listener* expected : {&a, &b, &a}) EXPECT_EQ(servers.Next().address, expected->url());
  EXPECT_EQ(ServersElsewhere({a.url(), b.url()}, 1).Next().address, b.url());
}

TEST(ServersElsewhere, OneThatIsGoneIsPassedOverWhileAnotherIsThere) {
  Listener gone;
  const Listener there;
  ServersElsewhere servers({gone.url(), there.url()});
  EXPECT_FALSE(servers.Lost({gone.url(), "unknown"}));
  gone.Close();
  for (int i = 0; i < 3; ++i) EXPECT_EQ(servers.Next().address, there.url());
  EXPECT_TRUE(servers.Lost({gone.url(), "unknown"}));
  EXPECT_FALSE(servers.Lost({there.url(), "unknown"})) << "its failure is the unit's own";
}

TEST(ServersElsewhere, TheOnlyOneIsGivenWhateverItIs) {
  Listener only;
  ServersElsewhere servers({only.url()});
  only.Close();
  EXPECT_EQ(servers.Next().address, only.url()) << "the worker says what is wrong with it";
  EXPECT_FALSE(servers.Lost({only.url(), "unknown"}));
  EXPECT_TRUE(ServersElsewhere({}).empty());
  EXPECT_FALSE(Accepts("no address"));
}

}  // namespace
}  // namespace robostress
