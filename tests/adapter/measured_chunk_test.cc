#include "adapter/measured_chunk.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class MeasuredChunkTest : public ::testing::Test {
 protected:
  MeasuredChunkTest() {
    policy_.name = "fake";
    policy_.horizon = 10;
    chunk_.sequence = 3;
  }
  std::string Refusal() {
    return std::string(MeasuredChunk::Create(chunk_, policy_, {}).status().message());
  }

  PolicySpec policy_;
  ExecutedChunk chunk_ =
      ToyArm(0.5).Execute(ConstantPrediction(Eigen::VectorXf::Unit(7, 0), 10), 5);
};

TEST_F(MeasuredChunkTest, MeasuresAgainstThePolicysCommandAndCopiesNothing) {
  const auto measured = MeasuredChunk::Create(chunk_, policy_, {});
  ASSERT_TRUE(measured.ok()) << measured.status();
  EXPECT_EQ(&measured->reported(), &chunk_);
  EXPECT_EQ(&measured->usable(), &chunk_);
  EXPECT_EQ(measured->residual(), ChunkResidual(chunk_, {}));
  EXPECT_NEAR(measured->residual()(4, 0), -0.5, 1e-6);
}

TEST_F(MeasuredChunkTest, MasksWhatNoRobotCanHaveMeasuredAndKeepsWhatWasSent) {
  chunk_.masked = {true, false, false, false, false};
  chunk_.steps[1].before.tool.p_base_tool.x() += 50;  // steps 0 and 1 touch it
  const auto measured = MeasuredChunk::Create(chunk_, policy_, {});
  ASSERT_TRUE(measured.ok()) << measured.status();
  EXPECT_EQ(measured->steps_masked(), 1u);
  EXPECT_EQ(measured->steps_impossible(), 1u) << "the client masked step 0 itself";
  EXPECT_TRUE(measured->usable().IsMasked(1));
  EXPECT_FALSE(measured->reported().IsMasked(1));
  EXPECT_TRUE(measured->residual().topRows(2).isZero());
  EXPECT_FALSE(measured->residual().row(2).isZero());
}

TEST_F(MeasuredChunkTest, RefusesWhatIsNoChunkOfThePolicy) {
  EXPECT_EQ(Refusal(), "");
  chunk_.first_step = 5;
  EXPECT_EQ(Refusal(), "");
  for (const int first : {6, std::numeric_limits<int>::max()}) {
    chunk_.first_step = first;
    EXPECT_THAT(Refusal(), HasSubstr("policy 'fake' predicts 10"));
  }
  chunk_.first_step = 0;
  chunk_.masked = {true};
  EXPECT_THAT(Refusal(), HasSubstr("has 1 mask values for 5 steps"));
  chunk_.masked.clear();
  chunk_.steps[2].base_command.resize(0);  // the others have one
  EXPECT_THAT(Refusal(), HasSubstr("step 2: base_command has 0 entries"));
  chunk_.steps[2].base_command = chunk_.steps[1].base_command;
  chunk_.steps[0].before.q[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(Refusal(), HasSubstr("step 0: before.q[0] is nan"));
}

}  // namespace
}  // namespace robostress
