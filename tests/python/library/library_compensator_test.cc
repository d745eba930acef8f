// The compensators of the C interface beside CompensatedPolicy: the same bits.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/command_correction.h"
#include "adapter/compensated_policy.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/so3.h"
#include "robostress.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using Compensator = std::unique_ptr<robostress_compensator, decltype(&robostress_compensator_free)>;

constexpr int kRows = 5;

// A policy that says what it is told.
class ToldPolicy : public PolicyEndpoint {
 public:
  explicit ToldPolicy(int action_dim) {
    spec_.name = "told";
    spec_.action_dim = action_dim;
    spec_.action_low.assign(static_cast<size_t>(action_dim), -1);
    spec_.action_high.assign(static_cast<size_t>(action_dim), 1);
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }
  absl::StatusOr<PredictedChunk> Predict(const Observation&, int) override {
    PredictedChunk chunk;
    chunk.actions = chunk.policy_actions = told;
    return chunk;
  }
  absl::Status SendFeedback(ExecutedChunk) override { return absl::OkStatus(); }
  absl::StatusOr<SessionStats> Stats() override { return SessionStats(); }
  Eigen::MatrixXf told;

 private:
  PolicySpec spec_;
};

// What an arm did with a chunk, in both forms.
struct Motion {
  Motion(std::mt19937& random, int action_dim, uint64_t sequence) {
    std::normal_distribution<double> normal;
    const auto width = static_cast<size_t>(action_dim);
    executed.sequence = sequence;
    for (int i = 0; i <= kRows; ++i) {
      RobotState state;
      for (int axis = 0; axis < 3; ++axis) state.tool.p_base_tool[axis] = 0.02 * normal(random);
      state.tool.q_base_tool =
          ExpSo3(0.1 * Eigen::Vector3d(normal(random), normal(random), normal(random)));
      const Eigen::Quaterniond& o = state.tool.q_base_tool;
      for (const double v : state.tool.p_base_tool) position.push_back(v);
      for (const double v : {o.w(), o.x(), o.y(), o.z()}) orientation.push_back(v);
      state.q = Eigen::VectorXd::NullaryExpr(action_dim - 1, [&] { return 0.3 * normal(random); });
      q.insert(q.end(), state.q.begin(), state.q.end());
      if (i == kRows) {
        executed.final_state = state;
        break;
      }
      ExecutedStep step;
      step.before = state;
      for (auto* command : {&step.policy_command, &step.sent_command}) {
        *command = Eigen::VectorXf::NullaryExpr(
            action_dim, [&] { return static_cast<float>(0.5 * normal(random)); });
      }
      for (size_t j = 0; j < width; ++j) {
        policy_command.push_back(step.policy_command[static_cast<Eigen::Index>(j)]);
        sent_command.push_back(step.sent_command[static_cast<Eigen::Index>(j)]);
      }
      masked.push_back(random() % 5 == 0);
      executed.masked.push_back(masked.back() != 0);
      executed.steps.push_back(step);
    }
  }
  robostress_executed Given(size_t from = 0, size_t steps = kRows) const {
    const size_t width = policy_command.size() / kRows;
    return {sizeof(robostress_executed), steps,
            &position[3 * from],         &orientation[4 * from],
            &q[(width - 1) * from],      &policy_command[width * from],
            &sent_command[width * from], &masked[from]};
  }
  ExecutedChunk executed;
  std::vector<double> position, orientation, q;
  std::vector<float> policy_command, sent_command;
  std::vector<unsigned char> masked;
};

class LibraryCompensator : public ::testing::Test {
 protected:
  static robostress_control Control() {
    robostress_control control;
    control.size = sizeof(control);
    robostress_control_default(&control);
    return control;
  }
  robostress_code New(const char* method, const std::vector<const char*>& overrides,
                      const robostress_control* control, Compensator& handle) {
    robostress_compensator* made = nullptr;
    const auto code = robostress_compensator_new(method, overrides.data(), overrides.size(),
                                                 control, &made, error_, sizeof(error_));
    handle.reset(made);
    return code;
  }
  Compensator Make(const char* method, const std::vector<const char*>& overrides = {},
                   const robostress_control* control = nullptr) {
    Compensator handle(nullptr, robostress_compensator_free);
    EXPECT_EQ(New(method, overrides, control, handle), ROBOSTRESS_OK) << error_;
    return handle;
  }
  char error_[500] = "";
};

using Rows = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Rows DrawnActions(std::mt19937& random, int action_dim) {
  std::normal_distribution<float> normal(0, 0.6F);
  return Rows::NullaryExpr(kRows, action_dim, [&] { return normal(random); });
}

// Two episodes of twelve chunks.
void ExpectSamePolicy(robostress_compensator* compensator, ToldPolicy& told,
                      CompensatedPolicy& policy, const std::string& what) {
  std::mt19937 random(5);
  const int width = told.spec().action_dim;
  uint64_t sequence = 0;
  char error[300] = "";
  for (int episode = 0; episode < 2; ++episode) {
    robostress_compensator_start_episode(compensator);
    ASSERT_TRUE(policy.StartEpisode({0, episode}).ok());
    for (int chunk = 0; chunk < 12; ++chunk) {
      const Rows actions = DrawnActions(random, width);
      told.told = actions;
      const PredictedChunk expected = *policy.Predict({}, chunk);
      Rows corrected(kRows, width);
      ASSERT_EQ(robostress_compensator_correct(compensator, actions.data(), kRows, corrected.data(),
                                               error, sizeof(error)),
                ROBOSTRESS_OK)
          << what << ": " << error;
      ASSERT_EQ(Eigen::MatrixXf(corrected), expected.actions) << what << ", chunk " << chunk;
      Motion motion(random, width, ++sequence);
      motion.executed.episode = episode;
      if (chunk == 7) {  // as no arm moves
        motion.executed.steps[2].before.tool.p_base_tool[0] = motion.position[6] = 30;
        motion.executed.steps[2].before.q[0] = motion.q[2 * static_cast<size_t>(width - 1)] = 300;
      }
      for (size_t row = 0; row < kRows; ++row) {
        ExecutedChunk so_far = motion.executed;
        so_far.steps.resize(row);
        so_far.masked.resize(row);
        so_far.final_state = motion.executed.steps[row].before;
        const Eigen::VectorXf next = *policy.NextCommand(expected, so_far);
        const robostress_executed newest = motion.Given(row == 0 ? 0 : row - 1, 1);
        Eigen::VectorXf command(width);
        ASSERT_EQ(robostress_compensator_next(compensator, row == 0 ? nullptr : &newest,
                                              command.data(), error, sizeof(error)),
                  ROBOSTRESS_OK)
            << what << ": " << error;
        ASSERT_EQ(command, next) << what << ", chunk " << chunk << ", row " << row;
      }
      ASSERT_TRUE(policy.SendFeedback(motion.executed).ok());
      const robostress_executed given = motion.Given();
      ASSERT_EQ(robostress_compensator_executed(compensator, &given, error, sizeof(error)),
                ROBOSTRESS_OK)
          << what << ": " << error;
    }
  }
}

const char* const kWeightFree[] = {"base",
                                   "gain",
                                   "direct",
                                   "ours_integral",
                                   "ours_following",
                                   "ours_following_step",
                                   "ours_following_smooth"};

TEST_F(LibraryCompensator, GivesTheBitsOfACompensatedPolicy) {
  const std::vector<float> low(7, -1), high(7, 1);
  for (const char* method : kWeightFree) {
    for (const char* goal : {"achieved", "desired"}) {
      ToldPolicy told(7);
      SessionSetting setting;
      setting.control_space = ControlSpace::kEndEffector;
      setting.goal_reference =
          goal == std::string("desired") ? GoalReference::kDesired : GoalReference::kAchieved;
      setting.control_period_s = 0.04;
      setting.translation_scale = 0.03;
      setting.rotation_scale = 0.4;
      const auto policy = CompensatedPolicy::Create(&told, setting, *MakeMethod(method));
      ASSERT_TRUE(policy.ok());
      robostress_control control = Control();
      control.goal_reference = goal;
      control.control_period = 0.04;
      control.translation_scale = 0.03;
      control.rotation_scale = 0.4;
      control.action_low = low.data();
      control.action_high = high.data();
      ExpectSamePolicy(Make(method, {}, &control).get(), told, **policy,
                       absl::StrCat(method, ", ", goal));
    }
  }
}

TEST_F(LibraryCompensator, CorrectsJointTargetsToo) {
  ToldPolicy told(6);
  SessionSetting setting;
  setting.control_space = ControlSpace::kJoint;
  const auto policy = CompensatedPolicy::Create(&told, setting, *MakeMethod("direct"));
  ASSERT_TRUE(policy.ok());
  const std::vector<float> low(6, -1), high(6, 1);
  robostress_control control = Control();
  control.space = "joint";
  control.action_dim = 6;
  control.action_low = low.data();
  control.action_high = high.data();
  const Compensator direct = Make("direct", {}, &control);
  EXPECT_EQ(robostress_compensator_action_dim(direct.get()), 6);
  ExpectSamePolicy(direct.get(), told, **policy, "joint");
}

TEST_F(LibraryCompensator, ReadsOverridesAsTheProgramsDo) {
  ToldPolicy told(7);
  const auto policy = CompensatedPolicy::Create(
      &told, {}, *MakeMethod("ours_following", {"following_gain=0.5", "integral_rate=0.02"}));
  ASSERT_TRUE(policy.ok());
  const std::vector<float> low(7, -1), high(7, 1);
  robostress_control control = Control();
  control.action_low = low.data();
  control.action_high = high.data();
  ExpectSamePolicy(
      Make("ours_following", {"following_gain=0.5", "integral_rate=0.02"}, &control).get(), told,
      **policy, "overrides");
}

TEST_F(LibraryCompensator, GivesTheResidualOfAdapter) {
  std::mt19937 random(2);
  const Motion motion(random, 7, 1);
  const robostress_executed given = motion.Given();
  Eigen::Matrix<double, kRows, 7, Eigen::RowMajor> residual;
  const Compensator plain = Make("base"), tracking = Make("base", {"residual_scale=tracking"});
  const auto residual_of = [&](const Compensator& of) {
    EXPECT_EQ(
        robostress_compensator_residual(of.get(), &given, residual.data(), error_, sizeof(error_)),
        ROBOSTRESS_OK)
        << error_;
    return Eigen::MatrixXd(residual);
  };
  ResidualOptions options;
  EXPECT_EQ(residual_of(plain), ChunkResidual(motion.executed, options));
  options.scale = ResidualScale::kTracking;
  EXPECT_EQ(residual_of(tracking), ChunkResidual(motion.executed, options));
}

TEST_F(LibraryCompensator, ACopyGoesOnAsItsOriginal) {
  std::mt19937 random(9);
  const Compensator original = Make("ours_following");
  const Rows actions = DrawnActions(random, 7);
  const auto learn = [&](robostress_compensator* of, const Motion& motion) {
    const robostress_executed given = motion.Given();
    EXPECT_EQ(robostress_compensator_executed(of, &given, nullptr, 0), ROBOSTRESS_OK);
    Eigen::VectorXd correction(6);
    robostress_compensator_correction(of, correction.data());
    return correction;
  };
  const Motion first(random, 7, 1), second(random, 7, 2);
  const Eigen::VectorXd before = learn(original.get(), first);
  robostress_compensator* made = nullptr;
  ASSERT_EQ(robostress_compensator_copy(original.get(), &made, nullptr, 0), ROBOSTRESS_OK);
  const Compensator copy(made, robostress_compensator_free);
  const Eigen::VectorXd after = learn(original.get(), second);
  ASSERT_NE(before, after);
  ASSERT_EQ(robostress_compensator_restore(original.get(), copy.get(), nullptr, 0), ROBOSTRESS_OK);
  EXPECT_EQ(learn(original.get(), second), after);
  EXPECT_EQ(learn(copy.get(), second), after);
}

TEST_F(LibraryCompensator, SaysWhatIsWrong) {
  Compensator none(nullptr, robostress_compensator_free);
  const auto refuses = [&](robostress_code code, robostress_code expected, const char* words) {
    EXPECT_EQ(code, expected) << words;
    EXPECT_THAT(error_, HasSubstr(words));
  };
  const auto bad = ROBOSTRESS_INVALID_ARGUMENT;
  refuses(New("following", {}, nullptr, none), ROBOSTRESS_NOT_FOUND, "known: base, ours");
  refuses(New(nullptr, {}, nullptr, none), bad, "method is NULL");
  refuses(New("ours", {}, nullptr, none), bad, "trains an adapter in the policy's weights");
  refuses(New("dob", {}, nullptr, none), bad, "would change nothing here; take base, gain");
  refuses(New("blank_images", {}, nullptr, none), bad, "would change nothing here");
  refuses(New("gain", {"gain=1000"}, nullptr, none), bad, "gain is 1000, must be -100..100");
  refuses(New("gain", {"gian=2"}, nullptr, none), bad, "gian");
  robostress_control control = Control();
  control.space = "cartesian";
  refuses(New("gain", {}, &control, none), bad,
          "control.space is 'cartesian', must be one of end_");
  control = Control();
  control.action_dim = 8;
  refuses(New("gain", {}, &control, none), bad, "control.action_dim is 8, must be 7");
  control = Control();
  control.rotation_scale = -1;
  refuses(New("gain", {}, &control, none), bad, "control.rotation_scale is -1 rad");
  control = Control();
  control.space = "joint";
  refuses(New("ours_following", {}, &control, none), bad, "acts in joint space");
  const std::vector<float> low(7, 2), high(7, 1);
  control = Control();
  control.action_low = low.data();
  refuses(New("gain", {}, &control, none), bad, "control.action_high is NULL");
  control.action_high = high.data();
  refuses(New("gain", {}, &control, none), bad, "control.action_low[0] is 2, must be at most 1");
  EXPECT_EQ(none, nullptr);

  const Compensator following = Make("ours_following_step");
  std::mt19937 random(4);
  Rows actions = DrawnActions(random, 7);
  Eigen::VectorXf command(7);
  const auto correct = [&](size_t rows) {
    return robostress_compensator_correct(following.get(), actions.data(), rows, actions.data(),
                                          error_, sizeof(error_));
  };
  const auto next = [&](const robostress_executed* newest) {
    return robostress_compensator_next(following.get(), newest, command.data(), error_,
                                       sizeof(error_));
  };
  refuses(next(nullptr), ROBOSTRESS_WRONG_ORDER, "all 0 rows of the chunk are used up");
  refuses(correct(0), bad, "rows is 0, must be 1 to 1024");
  ASSERT_EQ(correct(kRows), ROBOSTRESS_OK);
  actions(1, 3) = std::nanf("");
  refuses(correct(kRows), bad, "actions[1][3] is nan, must be finite");
  Motion motion(random, 7, 1);
  robostress_executed given = motion.Given();
  const auto executed = [&] {
    return robostress_compensator_executed(following.get(), &given, error_, sizeof(error_));
  };
  given.steps = 0;
  refuses(executed(), bad, "executed.steps is 0, must be 1 to 1024");
  given = motion.Given();
  given.orientation = nullptr;
  refuses(executed(), bad, "executed.orientation is NULL");
  given = motion.Given();
  motion.orientation[0] = 7;
  refuses(executed(), bad, "tool.q_base_tool has length");
}

TEST_F(LibraryCompensator, ObjectsOfDifferentThreadsKnowNothingOfEachOther) {
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([this] {
      ToldPolicy told(7);
      const auto policy = CompensatedPolicy::Create(&told, {}, *MakeMethod("ours_following"));
      ASSERT_TRUE(policy.ok());
      const std::vector<float> low(7, -1), high(7, 1);
      robostress_control control = Control();
      control.action_low = low.data();
      control.action_high = high.data();
      robostress_compensator* made = nullptr;
      ASSERT_EQ(
          robostress_compensator_new("ours_following", nullptr, 0, &control, &made, nullptr, 0),
          ROBOSTRESS_OK);
      ExpectSamePolicy(made, told, **policy, "a thread");
      robostress_compensator_free(made);
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// Any numbers in any order: a code and a sentence, never a crash, and only finite commands.
TEST_F(LibraryCompensator, SurvivesCallsInAnyOrder) {
  std::mt19937 random(13);
  const auto draw = [&](size_t n) { return random() % n; };
  const double odd[] = {0, -1, 1e300, std::nan(""), std::numeric_limits<double>::infinity()};
  for (int round = 0; round < 200; ++round) {
    const Compensator handle = Make(kWeightFree[draw(6)]);
    for (int call = 0; call < 30; ++call) {
      Motion motion(random, 7, 1);
      if (draw(4) == 0) motion.position[draw(motion.position.size())] = odd[draw(5)];
      if (draw(4) == 0) motion.orientation[draw(motion.orientation.size())] = odd[draw(5)];
      if (draw(4) == 0) motion.sent_command[draw(7)] = static_cast<float>(odd[draw(2)]);
      Rows actions = DrawnActions(random, 7);
      if (draw(4) == 0) actions(0, static_cast<Eigen::Index>(draw(7))) = 3e38F;
      robostress_executed given = motion.Given(0, draw(kRows + 1));
      if (draw(6) == 0) given.masked = nullptr;
      robostress_code code = ROBOSTRESS_INTERNAL;
      switch (draw(4)) {
        case 0:
          robostress_compensator_start_episode(handle.get());
          break;
        case 1:
          code = robostress_compensator_correct(handle.get(), actions.data(), kRows, actions.data(),
                                                error_, sizeof(error_));
          break;
        case 2:
          code = robostress_compensator_next(handle.get(), &given, actions.data(), error_,
                                             sizeof(error_));
          break;
        default:
          robostress_compensator_executed(handle.get(), &given, error_, sizeof(error_));
      }
      EXPECT_TRUE(code != ROBOSTRESS_OK || actions.allFinite());
    }
  }
}

}  // namespace
}  // namespace robostress
