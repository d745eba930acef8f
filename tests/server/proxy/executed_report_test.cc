// What clients say was executed: stale, twice, of another chunk, or not of what the actions are.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "server/proxy/action_block.h"
#include "server/proxy/proxied_arm.h"
#include "tests/server/proxy/proxy_messages.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

// One joint that hangs 0.02 rad below what it is told, and its client, which reports.
class ReportingJoint {
 public:
  // A message with `executed` of the last chunk as `report` writes it; none: it is left out.
  AnswerReport Ask(const std::function<void(OpenpiBytes&)>& report = nullptr) {
    OpenpiBytes message;
    message.Map(report ? 3 : 2).Text("state").Numbers<double>("<f8", {2}, {q_, 0});
    message.Text("prompt").Text("do something");
    if (report) report(message.Text("executed"));
    proxy_.Observed(message.bytes(), false, 0, ProxyMode::kOn);
    OpenpiBytes answer;
    answer.Map(2).Text("actions").Numbers<double>("<f8", {1, 2}, {0.3, 0});
    answer.Text("adapter").Map(1).Text("prediction_id").Integer(++prediction_);
    const std::string sent =
        proxy_.Answered(answer.bytes(), false, 0, ProxyMode::kOn).value_or(answer.bytes());
    given_ = ReadActions(sent, *FindActions(sent))(0, 0);
    return proxy_.report();
  }
  // It plays the chunk.
  void Play() {
    before_ = q_;
    q_ = given_ - 0.02;
  }
  void Report(OpenpiBytes& out, uint64_t sequence, uint64_t prediction) const {
    out.Map(3).Text("q").Numbers<double>("<f8", {2, 1}, {before_, q_});
    out.Text("sequence").Integer(sequence).Text("prediction_id").Integer(prediction);
  }
  uint64_t prediction() const { return prediction_; }
  double correction() const { return given_ - 0.3; }

 private:
  static ArmProfile Profile() {
    ArmProfile profile = JointProfile(1);
    profile.execute_steps = 1;
    return profile;
  }
  const ArmProfile profile_ = Profile();
  ProxiedArm proxy_{profile_, *MethodOf(profile_)};
  uint64_t prediction_ = 0;
  double q_ = 0.28, before_ = 0, given_ = 0;
};

TEST(ExecutedReport, OneThatIsInAlreadyTeachesNothing) {
  ReportingJoint joint;
  joint.Ask();
  joint.Play();
  joint.Ask([&](OpenpiBytes& out) { joint.Report(out, 1, joint.prediction()); });
  const double learned = joint.correction();
  ASSERT_GT(learned, 0);
  for (int i = 0; i < 5; ++i) {  // again and again, of whatever prediction it says
    const AnswerReport report =
        joint.Ask([&](OpenpiBytes& out) { joint.Report(out, 1, joint.prediction()); });
    EXPECT_EQ(report.doubt, std::nullopt) << report.words;
    EXPECT_EQ(report.residual.size(), 0);
  }
  EXPECT_LE(joint.correction(), 3 * learned) << "what it had learned, and no more";
}

TEST(ExecutedReport, OneOfAnEarlierPredictionIsDoubted) {
  ReportingJoint joint;
  joint.Ask();
  joint.Play();
  joint.Ask();
  const AnswerReport late =
      joint.Ask([&](OpenpiBytes& out) { joint.Report(out, 1, joint.prediction() - 1); });
  EXPECT_EQ(late.doubt, Doubt::kExecuted);
  EXPECT_THAT(late.words, HasSubstr("executed is of prediction 1, the chunk that was given last "
                                    "is 2"));
  EXPECT_EQ(joint.correction(), 0);
}

// Of a tool that is not shown nothing can be learned: it would read as one that stands still.
TEST(ExecutedReport, OneWithoutThePoseOfTheToolIsDoubted) {
  const ArmProfile profile = LiberoProfile();
  const std::vector<double> still(8, 0), joints(6, 0), places(18, 0);
  for (const bool placed : {false, true}) {
    ProxiedArm proxy(profile, *MethodOf(profile));
    proxy.Observed(LiberoObservation(still), false, 0, ProxyMode::kOn);
    proxy.Answered(ActionAnswer({1, 0, 0, 0, 0, 0, -1}), false, 0, ProxyMode::kOn);
    OpenpiBytes message;
    message.Map(3).Text("observation/state").Numbers<double>("<f8", {8}, still);
    message.Text("prompt").Text("do something").Text("executed").Map(placed ? 2 : 1);
    message.Text("q").Numbers<double>("<f8", {6, 1}, joints);
    if (placed) message.Text("p_base_tool").Numbers<double>("<f8", {6, 3}, places);
    proxy.Observed(message.bytes(), false, 0, ProxyMode::kOn);
    EXPECT_FALSE(proxy.Answered(ActionAnswer({1, 0, 0, 0, 0, 0, -1}), false, 0, ProxyMode::kOn));
    EXPECT_EQ(proxy.report().doubt, Doubt::kExecuted);
    EXPECT_THAT(proxy.report().words, HasSubstr(placed ? "no q_base_tool" : "no p_base_tool"));
  }
}

}  // namespace
}  // namespace robostress
