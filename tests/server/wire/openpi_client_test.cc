// openpi's own client, from PyPI, against this server: what its examples/simple_client does. It is
// skipped, with the reason, where it cannot be installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "server/wire/openpi/openpi_conversation.h"
#include "tests/common/wire/openpi_venv.h"
#include "tests/server/serve_process.h"
#include "tests/server/sessions/fake_session_host.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class OpenpiClient : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!OpenpiVenv::Get().failure.empty()) GTEST_SKIP() << OpenpiVenv::Get().failure;
  }
  // Output and exit code.
  static std::pair<std::string, int> Drive(int port, const std::string& env, int steps) {
    return RunProgram(
        OpenpiVenv::Get().python,
        absl::StrCat(OPENPI_CLIENT_TESTS "/openpi_client_driver.py ", port, " ", env, " ", steps));
  }
};

TEST_F(OpenpiClient, RunsLiberoAndDroidOnNano) {
  const ServeProcess server(SERVE_PROGRAM, {"--policy", "nano", "--websocket-listen", "127.0.0.1:0",
                                            "--websocket-resize"});
  for (const char* env : {"libero", "droid"}) {
    const auto [output, code] = Drive(server.port("websocket"), env, 5);
    EXPECT_EQ(code, 0) << output;
    EXPECT_THAT(output, AllOf(HasSubstr("'image_width': 64"), HasSubstr("'resizes_images': True"),
                              HasSubstr("served 5 chunks")));
    std::cout << output;
  }
  // nano's state has 8 numbers: it cannot take ALOHA's, and says so.
  const auto [output, code] = Drive(server.port("websocket"), "aloha", 1);
  EXPECT_NE(code, 0);
  EXPECT_THAT(output, HasSubstr("state: holds 14 numbers, policy nano wants 8"));
}

TEST_F(OpenpiClient, IsToldBothWaysToHaveItsImagesResized) {
  const ServeProcess server(SERVE_PROGRAM, {"--websocket-listen", "127.0.0.1:0"});
  const auto [output, code] = Drive(server.port("websocket"), "libero", 1);
  EXPECT_NE(code, 0);
  EXPECT_THAT(output,
              AllOf(HasSubstr("observation/image: is 224 x 224, policy nano:random takes 64 x 64"),
                    HasSubstr("session: {resize: true}"), HasSubstr("--websocket-resize")));
}

TEST_F(OpenpiClient, RunsAlohaOnAPolicyThatTakesIt) {
  Metrics metrics;
  FakeSessionHost host;
  host.spec.cameras = {"cam_high", "cam_left_wrist", "cam_right_wrist"};
  host.spec.image_width = host.spec.image_height = 224;
  host.spec.state_dim = host.spec.action_dim = 14;
  const auto server = WebServer::Start(
      {}, [](const WebRequest&) { return WebReply(); },
      [&](const WebRequest&) -> absl::StatusOr<std::unique_ptr<WebConversation>> {
        return std::make_unique<OpenpiConversation>(OpenpiOptions(), &host, &metrics, Anybody());
      },
      &metrics);
  ASSERT_TRUE(server.ok()) << server.status();
  const auto [output, code] = Drive((*server)->port(), "aloha", 5);
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("served 5 chunks of (10, 14)"));
}

}  // namespace
}  // namespace robostress
