#include "tests/floors/include_floors.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(IncludeFloors, NothingInTheTreeClimbs) {
  const IncludeGraph graph = ReadTree(ROBOSTRESS_SOURCE_DIR);
  ASSERT_GT(graph.size(), 50u) << "no sources under " << ROBOSTRESS_SOURCE_DIR;
  for (const std::string& complaint : CheckFloors(graph)) ADD_FAILURE() << complaint;
}

TEST(CheckFloors, AcceptsWhatGoesDown) {
  EXPECT_THAT(CheckFloors({{"server/sessions/session.cc",
                            {"server/sessions/session.h", "<memory>", "torch/torch.h",
                             "adapter/lora.h", "common/rpc/policy_client.h"}},
                           {"sim_worker/panda_sim.cc",
                            {"mujoco/mujoco.h", "adapter/residual.h", "Eigen/Core"}},
                           {"adapter/residual.h", {"common/types.h"}},
                           {"tests/sim_worker/a_test.cc",
                            {"sim_worker/panda_sim.h", "server/sessions/session.h"}}}),
              IsEmpty());
}

TEST(CheckFloors, RefusesAnIncludeThatClimbsOrGoesSideways) {
  EXPECT_THAT(CheckFloors({{"common/types.h", {"adapter/residual.h"}}}),
              ElementsAre(HasSubstr("common/ may not include adapter/")));
  EXPECT_THAT(CheckFloors({{"server/sessions/session.cc", {"sim_worker/panda_sim.h"}}}),
              ElementsAre(HasSubstr("server/sessions/ may not include sim_worker/")));
  EXPECT_THAT(CheckFloors({{"sim_worker/panda_sim.cc", {"server/policies/policy.h"}}}),
              ElementsAre(HasSubstr("may not include server/")));
  EXPECT_THAT(CheckFloors({{"eval/report/report.cc", {"tests/eval/synthetic_run.h"}}}),
              ElementsAre(HasSubstr("may not include tests/")));
  EXPECT_THAT(CheckFloors({{"eval/store/outcomes.cc", {"eval/report/report.h"}}}),
              ElementsAre(HasSubstr("eval/store/ may not include eval/report/")));
  EXPECT_THAT(CheckFloors({{"calibration/fit.cc", {"common/rpc/policy_client.h"}}}),
              ElementsAre(HasSubstr("may not include common/rpc/")));
}

TEST(CheckFloors, RefusesRpcOutsideTheFoldersThatOpenStreams) {
  EXPECT_THAT(CheckFloors({{"common/types.cc", {"common/rpc/policy_client.h"}}}),
              ElementsAre(HasSubstr("common/ may not include common/rpc/")));
  EXPECT_THAT(CheckFloors({{"sim_worker/panda_sim.cc", {"common/rpc/policy_client.h"}}}),
              ElementsAre(HasSubstr("may not include common/rpc/")));
  EXPECT_THAT(CheckFloors({{"sim_worker/worker/unit_runner.cc", {"common/rpc/policy_client.h"}}}),
              IsEmpty());
}

TEST(CheckFloors, KeepsTheWebSocketWireFromProtobufAndTorch) {
  EXPECT_THAT(CheckFloors({{"common/wire/a.cc", {"common/types.h", "boost/asio.hpp"}},
                           {"server/wire/web/b.cc", {"common/wire/a.h"}}}),
              IsEmpty());
  EXPECT_THAT(CheckFloors({{"common/wire/a.cc", {"common/rpc/policy_client.h"}}}),
              ElementsAre(HasSubstr("common/wire/ may not include common/rpc/")));
  EXPECT_THAT(CheckFloors({{"common/rpc/a.cc", {"common/wire/a.h"}}}),
              ElementsAre(HasSubstr("common/rpc/ may not include common/wire/")));
  for (const char* room : {"common/wire/", "server/wire/openpi/", "server/pages/",
                           "server/operations/", "server/inference/"}) {
    EXPECT_THAT(CheckFloors({{std::string(room) + "a.cc", {"google/protobuf/message.h"}}}),
                ElementsAre(HasSubstr("must not know gRPC or protobuf")));
  }
  for (const char* room : {"common/wire/", "server/wire/openpi/", "server/pages/"}) {
    EXPECT_THAT(CheckFloors({{std::string(room) + "a.cc", {"torch/torch.h"}}}),
                ElementsAre(HasSubstr("must not know LibTorch")));
  }
}

TEST(CheckFloors, FollowsIncludesToALibraryThatMustNotBeKnown) {
  // The Torch half of adapter/ is open to server/ and closed to the simulator, however it is
  // reached.
  const IncludeGraph graph = {{"sim_worker/arm.cc", {"adapter/state.h"}},
                              {"adapter/state.h", {"adapter/lora.h"}},
                              {"adapter/lora.h", {"<torch/torch.h"}}};
  EXPECT_THAT(
      CheckFloors(graph),
      ElementsAre(HasSubstr("sim_worker/arm.cc must not know LibTorch, but sim_worker/arm.cc -> "
                            "adapter/state.h -> adapter/lora.h -> <torch/torch.h")));
  EXPECT_THAT(CheckFloors({{"robot_client/loop.cc", {"mujoco/mujoco.h"}}}),
              ElementsAre(HasSubstr("must not know MuJoCo")));
  EXPECT_THAT(CheckFloors({{"common/types.h", {"google/protobuf/message.h"}}}),
              ElementsAre(HasSubstr("must not know gRPC or protobuf")));
}

TEST(CheckFloors, RefusesRelativePaths) {
  EXPECT_THAT(CheckFloors({{"common/a.h", {"../adapter/lora.h"}}}),
              ElementsAre(HasSubstr("named from the repository root")));
  EXPECT_THAT(CheckFloors({{"common/a.h", {"b.h"}}, {"common/b.h", {}}}),
              ElementsAre(HasSubstr("\"common/b.h\"")));
}

TEST(IncludesOf, ReadsBothFormsAndNothingElse) {
  EXPECT_THAT(IncludesOf("#pragma once\n  #  include \"a/b.h\"\n#include <vector>\n// see #include "
                         "\"c.h\"\nint x;\n"),
              ElementsAre("a/b.h", "<vector"));
}

}  // namespace
}  // namespace robostress
