#include "common/wire/web_url.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress {
namespace {

using ::testing::HasSubstr;

TEST(WebUrl, TakesWhatPeopleWrite) {
  struct Case {
    const char *text, *host;
    int port;
    const char* written;
  };
  for (const Case& c :
       {Case{"127.0.0.1:8000", "127.0.0.1", 8000, "ws://127.0.0.1:8000/"},
        {"ws://gpu.example", "gpu.example", 80, "ws://gpu.example:80/"},
        {"WSS://gpu.example/p/q?a=/b", "gpu.example", 443, "wss://gpu.example:443/p/q?a=/b"},
        {"ws://[::1]:9", "::1", 9, "ws://[::1]:9/"},
        {"ws://a:65535?x", "a", 65535, "ws://a:65535/?x"}}) {
    const auto url = ParseWebUrl(c.text);
    ASSERT_TRUE(url.ok()) << url.status();
    EXPECT_EQ(url->host, c.host);
    EXPECT_EQ(url->port, c.port);
    EXPECT_EQ(url->text(), c.written);
  }
}

TEST(WebUrl, SaysWhatIsWrong) {
  const auto refusal = [](const std::string& text) {
    return std::string(ParseWebUrl(text).status().message());
  };
  EXPECT_THAT(refusal(""), HasSubstr("names no host"));
  EXPECT_THAT(refusal("ws://:8000"), HasSubstr("names no host"));
  EXPECT_THAT(refusal("http://a:1"), HasSubstr("'http://a:1' is neither ws:// nor wss://"));
  EXPECT_THAT(refusal("a:0"), HasSubstr("1 to 65535"));
  EXPECT_THAT(refusal("a:65536"), HasSubstr("1 to 65535"));
  EXPECT_THAT(refusal("a:8000x"), HasSubstr("1 to 65535"));
  EXPECT_THAT(refusal("::1"), HasSubstr("without [ ]"));
  EXPECT_THAT(refusal("[::1:8"), HasSubstr("without its ']'"));
  EXPECT_THAT(refusal("ws://user:word@a:1"), HasSubstr("name or password"));
  EXPECT_THAT(refusal("a:1/\r\nX: y"), HasSubstr("a space"));
}

}  // namespace
}  // namespace robostress
