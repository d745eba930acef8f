#include "common/rpc/convert_specs.h"

#include <cmath>

#include "common/config.h"
#include "tests/common/rpc/fake_policy_server.h"
#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

TEST(ConvertTest, SessionSpecSurvivesTheWireExactly) {
  const RequestedSession sent = MakeSession();
  const absl::StatusOr<RequestedSession> got = FromProto(Transmit(ToProto(sent)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(ToProto(*got).SerializeAsString(), ToProto(sent).SerializeAsString());
  EXPECT_EQ(got->method_yaml, sent.method_yaml);
  EXPECT_EQ(got->mode, ExecutionMode::kAsync);
  EXPECT_EQ(got->goal_reference, GoalReference::kDesired);
  EXPECT_EQ(got->seed, -5);
}

TEST(ConvertTest, RefusesHostileSessionSpecs) {
  using M = v1::SessionSpec;
  ExpectRefused<M>(
      ToProto(MakeSession()),
      {{[](M& m) { m.clear_suite(); }, "spec.suite is empty"},
       {[](M& m) { m.set_scenario("../../etc x"); }, "spec.scenario contains byte 32"},
       {[](M& m) { m.set_policy(std::string(300, 'p')); },
        "spec.policy has 300 bytes, at most 256"},
       {[](M& m) { m.set_severity(6); }, "spec.severity is 6, must be 1 to 5"},
       {[](M& m) { m.clear_mode(); }, "spec.mode is 0, must be LOCKSTEP (1) or ASYNC (2)"},
       {[](M& m) { m.set_goal_reference(static_cast<v1::GoalReference>(9)); },
        "spec.goal_reference is 9"},
       {[](M& m) { m.set_method_yaml(std::string(1 << 17, ' ')); },
        "spec.method_yaml has 131072 bytes, at most 65536"},
       {[](M& m) { m.set_control_period_s(0); }, "spec.control_period_s is 0, must be 1e-6..100"},
       {[](M& m) { m.set_translation_scale(kNan); }, "spec.translation_scale is nan"}});
}

TEST(ConvertTest, PolicySpecSurvivesTheWire) {
  PolicySpec spec = FakeSpec();
  spec.cameras = {"agentview", "robot0_eye_in_hand"};
  spec.resizes_images = true;
  spec.max_view_side = 640;
  spec.inpaints = true;
  spec.action_low = {-1, -2, 0};
  spec.action_high = {1, 0.5f, 0};
  const absl::StatusOr<PolicySpec> got = FromProto(Transmit(ToProto(spec)));
  ASSERT_TRUE(got.ok()) << got.status();
  EXPECT_EQ(ToProto(*got).SerializeAsString(), ToProto(spec).SerializeAsString());
  EXPECT_EQ(got->action_low, spec.action_low);
  EXPECT_EQ(got->action_high, spec.action_high);
  EXPECT_TRUE(got->resizes_images);
  EXPECT_EQ(got->max_view_side, 640);
  EXPECT_TRUE(got->inpaints);
}

TEST(ConvertTest, RefusesHostilePolicySpecs) {
  PolicySpec spec = FakeSpec();
  spec.cameras = {"agentview"};
  using S = v1::PolicySpec;
  ExpectRefused<S>(
      ToProto(spec),
      {{[](S& m) { m.set_execute_steps(5); }, "policy.execute_steps is 5, must be 1 to 4"},
       {[](S& m) { m.set_horizon(0); }, "policy.horizon is 0"},
       {[](S& m) { m.set_image_width(100000); }, "policy.image_width is 100000"},
       {[](S& m) { m.add_action_low(-1); }, "policy.action_low has 1 and action_high 0 values"},
       {[](S& m) {
          for (int i = 0; i < 3; ++i) m.add_action_low(1), m.add_action_high(0);
        },
        "policy.action_low[0] is 1 and action_high[0] 0"},
       {[](S& m) {
          for (int i = 0; i < 3; ++i) m.add_action_low(0), m.add_action_high(std::nanf(""));
        },
        "they must be finite"}});
}

}  // namespace
}  // namespace robostress
