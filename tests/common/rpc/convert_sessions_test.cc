#include "common/rpc/convert_sessions.h"

#include "common/rollout/refusal.h"
#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

TEST(ConvertTest, StatsSurviveTheWire) {
  const SessionStats stats{12, 3, 0.5, 0.25};
  const absl::StatusOr<SessionStats> got_stats = FromProto(ToProto(stats));
  ASSERT_TRUE(got_stats.ok());
  EXPECT_EQ(got_stats->feedback_chunks, 12u);
  EXPECT_EQ(got_stats->adapter_distance, 0.5);
}

TEST(ConvertTest, PrioritiesAndRefusalsSurviveTheWire) {
  for (const Priority priority : {Priority::kUnspecified, Priority::kSimulation, Priority::kRobot})
    EXPECT_EQ(*FromProto(ToProto(priority)), priority);
  EXPECT_FALSE(FromProto(static_cast<v1::Priority>(7)).ok());
  v1::Refusal refusal;
  refusal.set_code(8);
  refusal.set_message("the queue is full");
  refusal.set_retry_after_ms(40);
  const absl::Status status = ToStatus(refusal);
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(IsRefusal(status));
  EXPECT_EQ(RetryAfter(status), absl::Milliseconds(40));
  refusal.set_code(0);
  EXPECT_EQ(ToStatus(refusal).code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace robostress
