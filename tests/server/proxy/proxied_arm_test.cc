#include "server/proxy/proxied_arm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <utility>

#include "server/proxy/action_block.h"
#include "tests/server/proxy/proxy_messages.h"
#include "tests/server/proxy/rubbing_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

MethodOptions Method(const ArmProfile& profile) {
  const auto method = MethodOf(profile);
  EXPECT_TRUE(method.ok()) << method.status();
  return *method;
}

// A policy that leads the arm to a point, behind a proxy, in lockstep.
struct Loop {
  ArmProfile profile = LiberoProfile();
  ProxiedArm proxy{profile, Method(profile)};
  RubbingArm arm;
  Eigen::Vector3d target{3, -2, 0};  // [command units]
  ProxyMode mode = ProxyMode::kOn;
  int corrected = 0;
  double now_s = 0;

  Loop(double friction, const ArmProfile& with) : profile(with), arm(friction) {}
  explicit Loop(double friction) : Loop(friction, LiberoProfile()) {}

  std::vector<double> Wish() const {
    const Eigen::Vector3d a = (0.5 * (target - arm.x())).cwiseMax(-1).cwiseMin(1);
    return {a[0], a[1], a[2], 0, 0, 0, -1};
  }
  // What the client executes.
  std::string Chunk() {
    proxy.Observed(LiberoObservation(arm.state()), false, now_s, mode);
    const std::string answer = ActionAnswer(Wish());
    const auto instead = proxy.Answered(answer, false, now_s, mode);
    corrected += instead.has_value();
    return instead.value_or(answer);
  }
  void Run(int chunks) {
    for (int i = 0; i < chunks; ++i) {
      const std::string chunk = Chunk();
      const Eigen::MatrixXd actions = ReadActions(chunk, *FindActions(chunk));
      for (int k = 0; k < profile.execute_steps; ++k)
        arm.Step(actions.row(k).head<3>().transpose());
    }
  }
  double error() const { return (target - arm.x()).norm(); }
};

TEST(ProxiedArm, WinsBackWhatFrictionTakes) {
  Loop direct(60), corrected(60);
  direct.mode = ProxyMode::kOff;
  direct.Run(60);
  corrected.Run(60);
  EXPECT_GT(direct.error(), 0.5) << "the friction hurts";
  EXPECT_LT(corrected.error(), 0.4 * direct.error());
  EXPECT_GT(corrected.corrected, 20);
  EXPECT_EQ(direct.corrected, 0);
}

TEST(ProxiedArm, LeavesAnArmAloneThatDoesAsItIsTold) {
  Loop healthy(0);
  healthy.Run(60);
  EXPECT_EQ(healthy.corrected, 0) << "every answer was the server's own bytes";
  EXPECT_LT(healthy.error(), 0.05);
}

TEST(ProxiedArm, ShadowSaysWhatItWouldDoAndChangesNothing) {
  Loop shadow(60);
  shadow.mode = ProxyMode::kShadow;
  shadow.Run(8);
  EXPECT_EQ(shadow.corrected, 0);
  EXPECT_EQ(shadow.proxy.report().outcome, AnswerOutcome::kShadow);
  EXPECT_GT(shadow.proxy.report().correction.norm(), 0.1);
  EXPECT_GT(shadow.proxy.report().residual.norm(), 0);
  Loop off(60);
  off.mode = ProxyMode::kOff;
  off.Run(8);
  EXPECT_EQ(off.arm.x(), shadow.arm.x()) << "bit for bit";
}

TEST(ProxiedArm, BeginsAnewWhenItIsSwitchedOnAgain) {
  Loop loop(60);
  loop.Run(30);
  ASSERT_GT(loop.proxy.report().correction.norm(), 0.1);
  loop.mode = ProxyMode::kOff;
  loop.Run(3);
  EXPECT_EQ(loop.proxy.report().outcome, AnswerOutcome::kOff);
  loop.mode = ProxyMode::kOn;
  loop.Run(1);
  EXPECT_EQ(loop.proxy.report().outcome, AnswerOutcome::kZero) << "it knows nothing yet";
}

TEST(ProxiedArm, ChangesNothingButTheArmsColumnsWithinTheLimits) {
  ArmProfile profile = LiberoProfile();
  profile.limits.correction = {0.3, 0.2, 0.1, 0, 0, 0};
  profile.limits.rate = {1};
  profile.action.low.assign(7, -1);
  profile.action.high.assign(7, 1);
  Loop loop(60, profile);
  Eigen::VectorXd last = Eigen::VectorXd::Zero(7);
  for (int i = 0; i < 40; ++i) {
    const std::string own = ActionAnswer(loop.Wish()), sent = loop.Chunk();
    ASSERT_EQ(own.size(), sent.size());
    const ActionBlock block = *FindActions(own);
    const Eigen::MatrixXd change = ReadActions(sent, block) - ReadActions(own, block);
    EXPECT_TRUE(change.rightCols(4).isZero(0)) << "rotation's limit is 0, the gripper is not ours";
    EXPECT_LE(change.col(0).cwiseAbs().maxCoeff(), 0.3 + 1e-6);
    EXPECT_LE(change.col(1).cwiseAbs().maxCoeff(), 0.2 + 1e-6);
    EXPECT_LE(change.col(2).cwiseAbs().maxCoeff(), 0.1 + 1e-6);
    EXPECT_LE(ReadActions(sent, block).cwiseAbs().maxCoeff(), 1) << "the action's own bounds";
    for (int k = 0; k < 10; ++k) {
      // The bounds may cut a row short; nothing grows faster than the rate.
      const Eigen::VectorXd now = change.row(k).transpose();
      for (int j = 0; j < 3; ++j)
        EXPECT_LE(std::abs(now[j]) - std::abs(last[j]), 1. / 20 + 1e-6) << i << " " << k;
      if (k < 5) last = now;
      if (k == 4) break;
    }
    const Eigen::MatrixXd actions = ReadActions(sent, block);
    for (int k = 0; k < 5; ++k) loop.arm.Step(actions.row(k).head<3>().transpose());
    const std::string rest(sent.substr(block.offset + 70 * block.item));
    EXPECT_EQ(rest, own.substr(block.offset + 70 * block.item));
    EXPECT_EQ(sent.substr(0, block.offset), own.substr(0, block.offset));
  }
  EXPECT_GT(loop.proxy.report().correction.norm(), 0.1);
}

// A correction is under way; then something is in doubt, and the answer passes.
class ProxyDoubt : public ::testing::Test {
 protected:
  void SetUp() override {
    loop_.Run(30);
    ASSERT_GT(loop_.proxy.report().correction.norm(), 0.1);
  }
  // What became of a message and of an answer.
  AnswerReport After(const std::string& message, const std::string& answer, bool text = false) {
    loop_.proxy.Observed(message, text, loop_.now_s, ProxyMode::kOn);
    EXPECT_FALSE(loop_.proxy.Answered(answer, false, loop_.now_s, ProxyMode::kOn).has_value());
    return loop_.proxy.report();
  }
  std::string Seen() const { return LiberoObservation(loop_.arm.state()); }
  std::string Answer() const { return ActionAnswer(loop_.Wish()); }

  Loop loop_{60};
};

TEST_F(ProxyDoubt, PassesWhatItCannotRead) {
  EXPECT_EQ(After("garbage", Answer()).doubt, Doubt::kUnreadable);
  EXPECT_EQ(After(Seen(), Answer(), true).doubt, Doubt::kUnreadable);
  EXPECT_EQ(After(LiberoObservation({1, 2}), Answer()).doubt, Doubt::kState);
  const AnswerReport missing = After(JointObservation({1, 2, 3}), Answer());
  EXPECT_EQ(missing.doubt, Doubt::kState);
  EXPECT_THAT(missing.words, HasSubstr("'observation/state'"));
  std::vector<double> state = loop_.arm.state();
  state[1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(After(LiberoObservation(state), Answer()).doubt, Doubt::kState);
}

TEST_F(ProxyDoubt, PassesActionsOfAnotherRobot) {
  EXPECT_EQ(After(Seen(), ActionAnswer({1, 2, 3})).doubt, Doubt::kActions);
}
TEST_F(ProxyDoubt, PassesAChunkThatIsTooShort) {
  EXPECT_EQ(After(Seen(), ActionAnswer(loop_.Wish(), 4)).doubt, Doubt::kActions);
}
TEST_F(ProxyDoubt, PassesActionsThatAreNotFinite) {
  std::vector<double> wish = loop_.Wish();
  wish[6] = std::numeric_limits<double>::infinity();
  EXPECT_EQ(After(Seen(), ActionAnswer(wish)).doubt, Doubt::kActions);
}
TEST_F(ProxyDoubt, PassesTheServersErrors) {
  loop_.proxy.Observed(Seen(), false, 0, ProxyMode::kOn);
  EXPECT_FALSE(loop_.proxy.Answered("Traceback", /*text=*/true, 0, ProxyMode::kOn).has_value());
  EXPECT_EQ(loop_.proxy.report().doubt, Doubt::kServer);
}

TEST_F(ProxyDoubt, PassesWhenTheArmIsWhereItCannotBe) {
  loop_.arm.Place(loop_.arm.x() + Eigen::Vector3d(2, 0, 0));  // 10 cm
  EXPECT_EQ(After(Seen(), Answer()).doubt, Doubt::kJump);
  // What was learned of the motion is forgotten, and learning goes on.
  loop_.Run(1);
  EXPECT_NE(loop_.proxy.report().outcome, AnswerOutcome::kDoubt);
}

TEST_F(ProxyDoubt, PassesWhenMessagesDoNotTakeTurns) {
  loop_.proxy.Observed(Seen(), false, 0, ProxyMode::kOn);
  loop_.proxy.Observed(Seen(), false, 0, ProxyMode::kOn);
  EXPECT_FALSE(loop_.proxy.Answered(Answer(), false, 0, ProxyMode::kOn).has_value());
  EXPECT_EQ(loop_.proxy.report().doubt, Doubt::kOverlap);
  EXPECT_FALSE(loop_.proxy.Answered(Answer(), false, 0, ProxyMode::kOn).has_value());
  // One that nobody asked for.
  EXPECT_FALSE(loop_.proxy.Answered(Answer(), false, 0, ProxyMode::kOn).has_value());
  EXPECT_EQ(loop_.proxy.report().outcome, AnswerOutcome::kOther);
}

TEST(ProxiedArm, KeepsTheClockOfARealArm) {
  ArmProfile profile = LiberoProfile(/*real_time=*/true);
  const auto doubt_after = [&](double pause_s) {
    Loop loop(60, profile);
    loop.Chunk();
    loop.now_s += pause_s;
    loop.Chunk();
    return loop.proxy.report().doubt;
  };
  // Five steps at 20 Hz take 0.25 s, of which the last may still be under way.
  EXPECT_EQ(doubt_after(0.05), Doubt::kEarly);
  EXPECT_EQ(doubt_after(0.20), std::nullopt);
  EXPECT_EQ(doubt_after(0.40), std::nullopt);
  EXPECT_EQ(doubt_after(2.0), std::nullopt);
  EXPECT_EQ(doubt_after(2.5), Doubt::kPause);
}

// A client that plays on while it waits, `late` steps of 50 ms, asks at every fifth step, and
// enters an answer at the row that is due.
struct AsynchronousLoop {
  static constexpr int kAsksEvery = 5;
  const int late;
  ArmProfile profile;
  ProxiedArm proxy;
  RubbingArm arm;
  Eigen::Vector3d target{3, -2, 0};  // [command units]
  ProxyMode mode = ProxyMode::kOn;
  int corrected = 0, doubts = 0;
  double largest_change = 0;  // of the correction, from one step to the next

  static ArmProfile Profile() {
    ArmProfile profile = LiberoProfile(/*real_time=*/true);
    profile.asynchronous = true;
    return profile;
  }
  AsynchronousLoop(double friction, int late, const ArmProfile& with = Profile())
      : late(late), profile(with), proxy(profile, Method(profile)), arm(friction) {}

  // 16 steps towards the target, as far as a healthy arm comes.
  Eigen::MatrixXd Plan() const {
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(16, 7);
    Eigen::Vector3d x = arm.x();
    for (int i = 0; i < rows.rows(); ++i) {
      const Eigen::Vector3d a = (0.3 * (target - x)).cwiseMax(-1).cwiseMin(1);
      rows.row(i).head<3>() = a.transpose();
      x += 0.5 * a;
    }
    return rows;
  }
  void Run(int steps) {
    Eigen::MatrixXd plays = Eigen::MatrixXd::Zero(64, 7), own = plays, coming;
    int asked = 0, row = 0;
    Eigen::Vector3d last = Eigen::Vector3d::Zero();
    for (int tick = 0; tick < steps; ++tick) {
      const double now = 0.05 * tick;
      if (tick % kAsksEvery == 0) {
        proxy.Observed(LiberoObservation(arm.state()), false, now, mode);
        coming = Plan();
        asked = tick;
      }
      if (tick - asked == late) {  // it came within the last step
        const std::string answer = ActionRows(coming);
        const auto instead = proxy.Answered(answer, false, now - 0.01, mode);
        corrected += instead.has_value();
        doubts += proxy.report().outcome == AnswerOutcome::kDoubt;
        own = ReadActions(answer, *FindActions(answer));
        plays = instead ? ReadActions(*instead, *FindActions(*instead)) : own;
        row = late;
      }
      const Eigen::Vector3d correction = (plays - own).row(row).head<3>();
      largest_change = std::max(largest_change, (correction - last).cwiseAbs().maxCoeff());
      last = correction;
      arm.Step(plays.row(row++).head<3>());
    }
  }
  double error() const { return (target - arm.x()).norm(); }
};

TEST(ProxiedArm, CorrectsAClientThatMovesWhileItWaits) {
  for (const int late : {1, 3, 4}) {
    AsynchronousLoop direct(60, late), through(60, late), healthy(0, late);
    direct.mode = ProxyMode::kOff;
    direct.Run(300);
    through.Run(300);
    healthy.Run(300);
    EXPECT_GT(direct.error(), 0.5) << late;
    EXPECT_LT(through.error(), 0.6 * direct.error()) << late;
    EXPECT_EQ(through.doubts, 0) << late;
    EXPECT_EQ(healthy.corrected, 0) << "late by " << late << ", it did what it was told";
    EXPECT_EQ(healthy.doubts, 0);
    EXPECT_LT(healthy.error(), 0.05);
  }
}

TEST(ProxiedArm, KeepsTheRateFromTheRowThatIsReallyPlayed) {
  ArmProfile profile = AsynchronousLoop::Profile();
  profile.limits.correction = {0.5};
  profile.limits.rate = {1};  // 0.05 a step
  AsynchronousLoop loop(60, 3, profile);
  loop.Run(300);
  EXPECT_GT(loop.corrected, 20);
  EXPECT_NEAR(loop.largest_change, 0.05, 1e-6);
}

TEST(ProxiedArm, PassesAnswersOfWhichEveryRowIsPast) {
  ProxiedArm proxy(AsynchronousLoop::Profile(), Method(AsynchronousLoop::Profile()));
  proxy.Observed(LiberoObservation(RubbingArm(0).state()), false, 0, ProxyMode::kOn);
  EXPECT_FALSE(proxy.Answered(ActionAnswer({1, 0, 0, 0, 0, 0, 0}, 4), false, 0.21, ProxyMode::kOn));
  EXPECT_EQ(proxy.report().doubt, Doubt::kActions);
  EXPECT_THAT(proxy.report().words, HasSubstr("had passed when it came"));
}

TEST(ProxiedArm, ANewPromptIsANewEpisode) {
  Loop loop(60);
  loop.Run(30);
  const int episode = loop.proxy.report().episode;
  loop.arm.Place({0, 0, 0});  // as if somebody had reset the scene
  loop.proxy.Observed(LiberoObservation(loop.arm.state(), "do something else"), false, 0,
                      ProxyMode::kOn);
  loop.proxy.Answered(ActionAnswer(loop.Wish()), false, 0, ProxyMode::kOn);
  EXPECT_EQ(loop.proxy.report().doubt, std::nullopt) << "no jump: the motion was not judged";
  EXPECT_EQ(loop.proxy.report().episode, episode + 1);
}

TEST(ProxiedArm, AMessageThatOnlyBeginsAnEpisodeIsNoDoubt) {
  ArmProfile profile = LiberoProfile();
  profile.keys.reset = "endpoint";
  profile.keys.reset_text = "reset";
  Loop loop(60, profile);
  loop.Run(10);
  const int episode = loop.proxy.report().episode;
  OpenpiBytes reset, done;
  reset.Map(1).Text("endpoint").Text("reset");
  done.Map(1).Text("status").Text("reset successful");
  loop.proxy.Observed(reset.bytes(), false, 0, ProxyMode::kOn);
  EXPECT_FALSE(loop.proxy.Answered(done.bytes(), false, 0, ProxyMode::kOn).has_value());
  EXPECT_EQ(loop.proxy.report().doubt, std::nullopt);
  EXPECT_EQ(loop.proxy.report().outcome, AnswerOutcome::kOther);
  EXPECT_EQ(loop.proxy.report().episode, episode + 1);
  loop.arm.Place({0, 0, 0});
  loop.Run(1);
  EXPECT_EQ(loop.proxy.report().doubt, std::nullopt);
}

TEST(ProxiedArm, TakesOffAJointsSag) {
  for (const int joints : {1, 6, 12}) {  // more than one observer holds
    const ArmProfile profile = JointProfile(joints);
    ProxiedArm proxy(profile, Method(profile));
    const Eigen::VectorXd sag = Eigen::VectorXd::LinSpaced(joints, 0.01, 0.03);
    Eigen::VectorXd q = Eigen::VectorXd::Zero(joints);
    double error = 0;
    for (int i = 0; i < 40; ++i) {
      std::vector<double> state(q.begin(), q.end()), wish(static_cast<size_t>(joints) + 1, 0);
      state.push_back(0.04);
      for (int j = 0; j < joints; ++j) wish[static_cast<size_t>(j)] = 0.3 * std::sin(0.05 * i);
      proxy.Observed(JointObservation(state), false, 0, ProxyMode::kOn);
      const std::string own = ActionAnswer(wish);
      const std::string sent = proxy.Answered(own, false, 0, ProxyMode::kOn).value_or(own);
      q = ReadActions(sent, *FindActions(sent)).row(4).head(joints).transpose();
      q -= sag;
      error = (q - Eigen::VectorXd::Constant(joints, wish[0])).cwiseAbs().maxCoeff();
    }
    EXPECT_LT(error, 0.2 * sag.maxCoeff()) << joints;
    EXPECT_EQ(proxy.report().outcome, AnswerOutcome::kCorrected);
  }
}

TEST(ProxiedArm, LearnsFromWhatAClientSaysWasExecuted) {
  ArmProfile profile = JointProfile(2);
  ProxiedArm proxy(profile, Method(profile));
  Eigen::Vector2d q(0, 0);
  size_t rows = 0;
  for (int i = 0; i < 20; ++i) {
    OpenpiBytes message;
    message.Map(i == 0 ? 2 : 3).Text("state").Numbers<double>("<f8", {2}, {q[0], q[1]});
    message.Text("prompt").Text("do something");
    if (i > 0) {  // three steps of the last chunk, the first at its second row
      std::vector<double> all;
      for (int k = 0; k < 4; ++k) all.insert(all.end(), {q[0], q[1]});
      message.Text("executed").Map(2).Text("q").Numbers<double>("<f8", {4, 2}, all);
      message.Text("first_step").Integer(1);
    }
    proxy.Observed(message.bytes(), false, 0, ProxyMode::kOn);
    const auto taken = proxy.TakeRows();
    rows += taken.size();
    if (i > 0) {
      ASSERT_EQ(taken.size(), 3u) << proxy.report().words;
      EXPECT_EQ(taken[0].stretch, taken[2].stretch);
    }
    const std::string own = ActionAnswer({0.2, -0.1, 0});
    const std::string sent = proxy.Answered(own, false, 0, ProxyMode::kOn).value_or(own);
    q = ReadActions(sent, *FindActions(sent)).row(3).head<2>().transpose();
    q += Eigen::Vector2d(-0.02, 0.01);
  }
  EXPECT_NEAR(q[0], 0.2, 0.004);
  EXPECT_NEAR(q[1], -0.1, 0.002);
  EXPECT_EQ(rows, 57u);
}

// The same arm, whose client says where the tool was at every step.
TEST(ProxiedArm, LearnsFromEveryPoseThatAClientReports) {
  Loop direct(60), reporting(60);
  direct.mode = ProxyMode::kOff;
  direct.Run(60);
  std::vector<double> poses, turns;
  for (int i = 0; i < 60; ++i) {
    OpenpiBytes message;
    message.Map(i == 0 ? 2 : 3).Text("observation/state");
    message.Numbers<double>("<f8", {8}, reporting.arm.state()).Text("prompt").Text("go");
    if (i > 0) {
      message.Text("executed")
          .Map(4)
          .Text("q")
          .Numbers<double>("<f8", {6, 1}, std::vector<double>(6));
      message.Text("p_base_tool").Numbers<double>("<f8", {6, 3}, poses);
      message.Text("q_base_tool").Numbers<double>("<f8", {6, 4}, turns);
      message.Text("last_of_episode").Byte(0xc2);  // false
    }
    reporting.proxy.Observed(message.bytes(), false, 0, ProxyMode::kOn);
    const std::string own = ActionAnswer(reporting.Wish());
    const std::string sent = reporting.proxy.Answered(own, false, 0, ProxyMode::kOn).value_or(own);
    ASSERT_EQ(reporting.proxy.report().doubt, std::nullopt) << reporting.proxy.report().words;
    const Eigen::MatrixXd actions = ReadActions(sent, *FindActions(sent));
    poses.clear();
    turns.clear();
    for (int k = 0; k <= 5; ++k) {
      const std::vector<double> state = reporting.arm.state();
      poses.insert(poses.end(), state.begin(), state.begin() + 3);
      turns.insert(turns.end(), {1, 0, 0, 0});
      if (k < 5) reporting.arm.Step(actions.row(k).head<3>().transpose());
    }
  }
  EXPECT_LT(reporting.error(), 0.4 * direct.error());
}

TEST(ProxiedArm, ScalesByAGainWithinTheLimit) {
  ArmProfile profile = LiberoProfile();
  profile.method = "gain";  // 1.15
  profile.limits.correction = {0.1};
  profile.limits.rate = {20};
  ProxiedArm proxy(profile, Method(profile));
  proxy.Observed(LiberoObservation(std::vector<double>(8)), false, 0, ProxyMode::kOn);
  const auto sent =
      proxy.Answered(ActionAnswer({0.4, -0.8, 0, 0, 0, 0, -1}), false, 0, ProxyMode::kOn);
  ASSERT_TRUE(sent.has_value());
  const Eigen::MatrixXd actions = ReadActions(*sent, *FindActions(*sent));
  EXPECT_NEAR(actions(3, 0), 0.46, 1e-6);
  EXPECT_NEAR(actions(3, 1), -0.9, 1e-6) << "0.12 more would be too much";
  EXPECT_EQ(actions(3, 6), -1);
}

TEST(ProxiedArm, PassesAReportThatCannotBe) {
  ArmProfile profile = JointProfile(2);
  ProxiedArm proxy(profile, Method(profile));
  proxy.Observed(JointObservation({0, 0, 0}), false, 0, ProxyMode::kOn);
  proxy.Answered(ActionAnswer({0.2, -0.1, 0}), false, 0, ProxyMode::kOn);
  OpenpiBytes message;
  message.Map(3).Text("state").Numbers<double>("<f8", {2}, {0, 0});
  message.Text("prompt").Text("do something").Text("executed").Map(1).Text("q");
  message.Numbers<double>("<f8", {20, 2}, std::vector<double>(40));
  proxy.Observed(message.bytes(), false, 0, ProxyMode::kOn);
  EXPECT_FALSE(proxy.Answered(ActionAnswer({0.2, -0.1, 0}), false, 0, ProxyMode::kOn).has_value());
  EXPECT_EQ(proxy.report().doubt, Doubt::kExecuted);
}

// An hour of a robot's chunks, among whatever else may come. Whatever comes, an answer is the
// server's own bytes, or differs from them in the arm's columns, within limits and rate, and holds
// no number that is not finite.
TEST(ProxiedArm, SurvivesAnHourOfAnAdversary) {
  ArmProfile profile = LiberoProfile(/*real_time=*/true);
  profile.limits.correction = {0.3};
  profile.limits.rate = {2};
  Loop loop(60, profile);
  std::mt19937 random(7);
  const auto one_in = [&random](int n) { return random() % static_cast<unsigned>(n) == 0; };
  const auto noise = [&random](size_t size) {
    std::string bytes(size, '\0');
    for (char& c : bytes) c = static_cast<char>(random());
    return bytes;
  };
  constexpr double kStrange[] = {1e300, -1e300, 1e-300, std::numeric_limits<double>::quiet_NaN(),
                                 std::numeric_limits<double>::infinity()};
  int corrected = 0, in_doubt = 0, episode = 0;
  Eigen::VectorXd last = Eigen::VectorXd::Zero(6);
  for (int i = 0; i < 14400; ++i) {  // an hour of chunks of 0.25 s
    std::vector<double> state = loop.arm.state(), wish = loop.Wish();
    if (one_in(40)) state[random() % 8] = kStrange[random() % 5];
    if (one_in(40)) wish[random() % 7] = kStrange[random() % 5];
    if (one_in(60)) state.resize(random() % 9);
    if (one_in(60)) wish.resize(random() % 8);
    if (one_in(60)) loop.arm.Place(Eigen::Vector3d::Random() * 5);  // another robot, or a reset
    if (one_in(30)) loop.target = Eigen::Vector3d::Random() * 4;
    std::string message = LiberoObservation(state, one_in(300) ? "another" : "do something");
    std::string answer = ActionAnswer(wish, one_in(60) ? static_cast<int>(random() % 12) : 10);
    if (one_in(50)) message = noise(random() % 300);
    if (one_in(50)) answer = noise(random() % 300);
    if (one_in(50)) message[random() % message.size()] ^= static_cast<char>(1 << random() % 8);
    if (one_in(50)) answer[random() % answer.size()] ^= static_cast<char>(1 << random() % 8);
    if (one_in(50)) message.resize(random() % message.size());
    if (one_in(50)) answer.resize(random() % answer.size());
    loop.now_s += one_in(50) ? 100 * static_cast<double>(random() % 100) / 100 : 0.26;
    const int times = one_in(50) ? 2 : 1;
    for (int k = 0; k < times; ++k)
      loop.proxy.Observed(message, one_in(100), loop.now_s, ProxyMode::kOn);
    std::string executed = answer;
    // Every message is answered, now and then once too often.
    for (int k = one_in(50) ? -1 : 0; k < times; ++k) {
      const auto instead = loop.proxy.Answered(answer, one_in(100), loop.now_s, ProxyMode::kOn);
      in_doubt += loop.proxy.report().doubt.has_value();
      const AnswerReport& report = loop.proxy.report();
      const bool asked = report.outcome != AnswerOutcome::kOther;
      // With an episode a correction ends at once, and begins at 0.
      if (asked && std::exchange(episode, report.episode) != report.episode) last.setZero();
      if (!instead) {
        if (asked) last.setZero();
        continue;
      }
      ++corrected;
      executed = *instead;
      ASSERT_EQ(instead->size(), answer.size());
      const auto block = FindActions(answer);
      ASSERT_TRUE(block.ok());
      const Eigen::MatrixXd own = ReadActions(answer, *block), sent = ReadActions(*instead, *block);
      ASSERT_TRUE(sent.allFinite());
      ASSERT_EQ(block->cols, 7);
      EXPECT_TRUE((sent.col(6) - own.col(6)).isZero(0));
      const Eigen::MatrixXd change = (sent - own).leftCols(6);
      // float32 of a large command cannot tell a small correction.
      const double rounding = 1e-6 * std::max(1.0, own.cwiseAbs().maxCoeff());
      ASSERT_LE(change.cwiseAbs().maxCoeff(), 0.3 + rounding);
      for (int row = 0; row < 5; ++row) {
        const Eigen::VectorXd now = change.row(row).transpose();
        ASSERT_LE((now - last).cwiseAbs().maxCoeff(), 2. / 20 + 2 * rounding) << i << " " << row;
        last = now;
      }
      std::string undone = *instead;
      for (int row = 0; row < block->rows; ++row)
        for (int col = 0; col < 6; ++col) WriteAction(undone, *block, row, col, own(row, col));
      ASSERT_EQ(undone, answer) << "no other byte";
    }
    if (const auto block = FindActions(executed); block.ok() && block->cols == 7) {
      const Eigen::MatrixXd actions = ReadActions(executed, *block);
      for (int k = 0; k < std::min(5, block->rows); ++k) {
        const Eigen::Vector3d command = actions.row(k).head<3>().transpose();
        if (command.allFinite()) loop.arm.Step(command);
      }
    }
  }
  EXPECT_GT(corrected, 1000) << "it did something between the attacks";
  EXPECT_GT(in_doubt, 1000);
}

}  // namespace
}  // namespace robostress
