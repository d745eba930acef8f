// Our client against a server made of openpi's own packages, from PyPI. It is skipped, with the
// reason, where they cannot be installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_dialect.h"
#include "tests/common/wire/openpi_venv.h"
#include "tests/common/wire/python_peer.h"

namespace robostress {
namespace {

constexpr absl::Duration kLong = absl::Seconds(30);

using ::testing::HasSubstr;

// openpi_peer_server.py
struct PeerServer : PythonPeer {
  explicit PeerServer(const char* dialect)
      : PythonPeer(OpenpiVenv::Get().python, {OPENPI_PEER_SERVER, dialect}) {}
};

class OpenpiPeer : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!OpenpiVenv::Get().failure.empty()) GTEST_SKIP() << OpenpiVenv::Get().failure;
  }
  static Observation Seen(int views, int state) {
    Observation observation;
    observation.instruction = "do something";
    for (int i = 0; i < views; ++i) {
      Image image{224, 224, std::vector<uint8_t>(3 * 224 * 224)};
      for (size_t k = 0; k < image.data.size(); ++k)
        image.data[k] = static_cast<uint8_t>(200 + i + k % 50);
      observation.views.push_back({absl::StrCat("camera", i), std::move(image)});
    }
    observation.proprioception = Eigen::VectorXf::LinSpaced(state, 0.5f, 8.5f);
    return observation;
  }
};

TEST_F(OpenpiPeer, AnswersWhatWeSendInEveryDialect) {
  struct Case {
    const char* dialect;
    int views, state, actions;
  };
  for (const Case& c : {Case{"libero", 2, 8, 7}, {"aloha", 3, 14, 14}, {"droid", 2, 8, 8}}) {
    const PeerServer server(c.dialect);
    const auto connection = OpenpiConnection::Connect(server.url());
    ASSERT_TRUE(connection.ok()) << c.dialect << connection.status();
    EXPECT_NE((*connection)->metadata().Find("reset_pose"), nullptr);
    const Observation seen = Seen(c.views, c.state);
    for (int i = 0; i < 3; ++i) {
      const auto bytes =
          (*connection)->Ask(*WriteOpenpiObservation(seen, *OpenpiDialectNamed(c.dialect)), kLong);
      ASSERT_TRUE(bytes.ok()) << c.dialect << bytes.status();
      const auto answer = ReadOpenpiAnswer(*DecodeOpenpiValue(*bytes), {1, 50}, c.actions);
      ASSERT_TRUE(answer.ok()) << c.dialect << answer.status();
      ASSERT_EQ(answer->actions.rows(), 10);
      EXPECT_EQ(answer->actions(3, 1), seen.proprioception[1] + 3);  // float64 there
      EXPECT_EQ(answer->actions(0, c.actions - 1), 200) << "the first pixel of the first view";
      EXPECT_EQ(answer->infer_ms, 1.5);
    }
  }
}

TEST_F(OpenpiPeer, KeepsUsWhileWeSimulate) {
  const PeerServer server("libero");
  const auto connection = OpenpiConnection::Connect(server.url());
  ASSERT_TRUE(connection.ok()) << connection.status();
  absl::SleepFor(absl::Seconds(1));  // it would cut us after 0.4 s
  const auto message = WriteOpenpiObservation(Seen(2, 8), *OpenpiDialectNamed("libero"));
  const auto answer = (*connection)->Ask(*message, kLong);
  EXPECT_TRUE(answer.ok()) << answer.status();
}

TEST_F(OpenpiPeer, TellsUsTheLastLineOfItsTraceback) {
  const PeerServer server("aloha");
  const auto connection = OpenpiConnection::Connect(server.url());
  ASSERT_TRUE(connection.ok()) << connection.status();
  const absl::Status failed =
      (*connection)
          ->Ask(*WriteOpenpiObservation(Seen(2, 8), *OpenpiDialectNamed("libero")), kLong)
          .status();
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(failed.message()),
              HasSubstr("/: the policy server failed: KeyError: 'images'"));
}

}  // namespace
}  // namespace robostress
