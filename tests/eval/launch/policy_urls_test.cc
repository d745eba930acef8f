#include "eval/launch/policy_urls.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "common/wire/openpi_dialect.h"
#include "tests/common/wire/heard_log.h"
#include "tests/common/wire/policy_peer.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kNobody[] = "ws://127.0.0.1:9";

std::string Serves(const std::string& model) {
  return OpenpiWriter().Map(1).Text("model").Text(model).Take();
}
std::string NoAnswer(int, int) { return ""; }

class PolicyUrls : public ::testing::Test {
 protected:
  PolicyUrls() {
    grid_.policies = {"pi05"};
    grid_.suites = {"libero_goal"};
    grid_.remote.dialect = *OpenpiDialectNamed("libero");
  }
  absl::Status Dial(const std::vector<std::string>& urls) { return DialPolicyUrls(urls, grid_); }

  SweepGrid grid_;
  HeardLog log_;
};

TEST_F(PolicyUrls, TwoThatServeOneModelAreTakenAsOne) {
  const PolicyPeer one(NoAnswer, Serves("a")), two(NoAnswer, Serves("a"));
  EXPECT_TRUE(Dial({one.url(), two.url()}).ok());
  EXPECT_THAT(log_.words(), Not(HasSubstr("do not say the same")));
}

TEST_F(PolicyUrls, TwoThatSayAnotherModelAreWarnedOf) {
  const PolicyPeer one(NoAnswer, Serves("a")), two(NoAnswer, Serves("a")),
      three(NoAnswer, Serves("b"));
  EXPECT_TRUE(Dial({one.url(), two.url(), three.url()}).ok());
  EXPECT_THAT(log_.words(), HasSubstr(one.url()));
  EXPECT_THAT(log_.words(), HasSubstr(three.url() + "/ do not say the same of the model"));
  EXPECT_THAT(log_.words(), Not(HasSubstr(two.url() + "/ do not say")));
}

TEST_F(PolicyUrls, OneThatIsNotThereIsWarnedOfWhileAnotherIs) {
  const PolicyPeer one(NoAnswer, Serves("a"));
  EXPECT_TRUE(Dial({kNobody, one.url()}).ok());
  EXPECT_THAT(log_.words(), HasSubstr("units go to the other servers meanwhile"));
}

TEST_F(PolicyUrls, NobodyThereIsTheFirstOnesError) {
  const absl::Status dialled = Dial({kNobody, "ws://127.0.0.1:10"});
  EXPECT_EQ(dialled.code(), absl::StatusCode::kUnavailable) << dialled;
  EXPECT_THAT(std::string(dialled.message()), HasSubstr("--policy-url: ws://127.0.0.1:9"));
}

TEST_F(PolicyUrls, OneThatServesSomethingElseIsAnErrorWhateverTheOthersSay) {
  const PolicyPeer one(NoAnswer, Serves("a")),
      two(NoAnswer,
          OpenpiWriter().Map(1).Text("output").Map(1).Text("action_dim").Integer(14).Take());
  const absl::Status dialled = Dial({one.url(), two.url()});
  EXPECT_FALSE(dialled.ok());
  EXPECT_THAT(std::string(dialled.message()),
              HasSubstr("says action_dim 14, remote.action_dim is 7"));
}

}  // namespace
}  // namespace robostress
