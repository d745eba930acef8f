// Results of a policy that somebody else serves, from the sweep to another laboratory's comparison,
// through the programs; worker and server are stand-ins.
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "eval/report/result_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/common/wire/policy_peer.h"
#include "tests/eval/grid_programs.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class SharedResults : public ::testing::Test {
 protected:
  void SetUp() override { folder_ = TestFolder(); }

  int Run(const std::string& program, const std::string& arguments) {
    const auto [code, output] = RunGrid(folder_, program, arguments);
    output_ = output;
    return code;
  }
  std::string At(const std::string& name) const {
    return absl::StrCat("'", folder_, "/", name, "' ");
  }
  // Sweeps two tasks, three states, Clean and Heavy Payload, base and model following, over two
  // servers that take no seed. They greet, which is all that a sweep itself asks of them.
  int Sweep(const std::string& out, const std::string& more) {
    const PolicyPeer server([](int, int) { return std::string(); }),
        other([](int, int) { return std::string(); });
    other_ = other.url() + "/team-7";
    return Run("sweep",
               absl::StrCat("--suites tabletop_goal --tasks 2 --episodes 3 --scenarios "
                            "clean,heavy_payload --policies pi05 --policy-url ",
                            server.url(), ",", other_, " --workers 2 ", more, " --out ", At(out)));
  }
  std::string Text(const std::string& name) const {
    return ReadFile(absl::StrCat(folder_, "/", name)).value_or("");
  }

  std::string folder_, output_, other_;
};

TEST_F(SharedResults, EveryTableSaysWhoServedThePolicyAndThatNoiseIsNotPaired) {
  ASSERT_EQ(Sweep("run", "--repeats 2 --split-episodes 2"), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("severity L5, suite Goal; sampling noise not paired"),
                             HasSubstr("Policy pi05, a label that the user gave, was served by"),
                             HasSubstr(other_ + " ("), HasSubstr(" reconnections.")));
  EXPECT_TRUE(std::filesystem::exists(
      folder_ + "/run/units/tabletop_goal-heavy_payload-L5-pi05-ours_following-s1/servers.jsonl"));
  EXPECT_THAT(Text("run/table.md"), HasSubstr("sampling noise not paired"));
  EXPECT_THAT(Text("run/report.html"),
              AllOf(HasSubstr("sampling noise not paired"), HasSubstr("Means over 2 repeats"),
                    HasSubstr("was served by")));
  const auto report = nlohmann::json::parse(Text("run/report.json"));
  EXPECT_EQ(report["tables"][0]["noise_paired"], false);
  EXPECT_EQ(report["servers"][0]["urls"].size(), 2u);
  EXPECT_GT(report["servers"][0]["reconnections"], 8) << "one for each part";
  EXPECT_THAT(Text("run/table.csv"), HasSubstr(",noise_paired,clustered_by\n"));
}

TEST_F(SharedResults, AnExportedRunIsComparedByAnotherLaboratory) {
  ASSERT_EQ(Sweep("theirs", "--repeats 2 --no-report"), 0) << output_;
  ASSERT_EQ(Sweep("ours", "--no-report"), 0) << output_;
  ASSERT_EQ(Run("report", absl::StrCat(At("theirs"), "--bootstrap 100 --export ", At("lab.json"),
                                       "--export-leaderboard ", At("board.json"),
                                       "--leaderboard model=black25pi05 --leaderboard "
                                       "weight_type=shared --leaderboard curated_by=@ann")),
            0)
      << output_;
  const auto file = ReadResultFile(folder_ + "/lab.json");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_THAT(Text("lab.json"),
              AllOf(Not(HasSubstr("team-7")), Not(HasSubstr("127.0.0.1")), Not(HasSubstr(folder_)),
                    HasSubstr("\"ws://HOST:"), HasSubstr("/...\"")));
  EXPECT_EQ(nlohmann::json::parse(Text("board.json"))["results"].size(), 2u);
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/theirs/report.html")) << "only what was named";

  ASSERT_EQ(Run("compare", absl::StrCat(At("ours"), At("lab.json"), "--out ", At("labs"))), 0)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("tabletop_goal, Heavy Payload L5"), HasSubstr("Newcombe"),
                             HasSubstr("lab: policy pi05"), HasSubstr("noise not paired")));
  for (const char* kind : {"md", "csv", "json", "html"})
    EXPECT_FALSE(Text(absl::StrCat("labs/compare.", kind)).empty()) << kind;
  // Two run directories pair.
  ASSERT_EQ(Run("compare", absl::StrCat(At("ours"), At("theirs"), "--out ", At("runs"))), 0)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("won/lost"), HasSubstr("Sampling noise not paired")));
  // Two files of one run twice over, a file that is none, one alone.
  EXPECT_EQ(Run("compare", absl::StrCat(At("lab.json"), At("board.json"))), 1);
  EXPECT_THAT(output_, HasSubstr("board.json:\n  field schema is missing"));
  EXPECT_EQ(Run("compare", At("lab.json")), 1);
  EXPECT_THAT(output_, HasSubstr("give a second file"));
  EXPECT_EQ(Run("compare", ""), 2);
}

TEST_F(SharedResults, RepeatsAreForServersThatTakeNoSeed) {
  EXPECT_EQ(Sweep("run", "--repeats 2 --dialect vllm_omni --dry-run"), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("dialect vllm_omni"), HasSubstr("give --seeds 0,1")));
  EXPECT_EQ(Sweep("run", "--repeats 2 --seeds 0,1 --dry-run"), 2);
  EXPECT_THAT(output_, HasSubstr("give one"));
  EXPECT_EQ(Run("sweep", SmallGrid() + "--repeats 2 --dry-run --out " + At("run")), 2);
  EXPECT_EQ(Sweep("run", "--repeats 0 --dry-run"), 2);
}

TEST_F(SharedResults, ExportsRunsTogetherThatDoNotOverlap) {
  ASSERT_EQ(Run("sweep", SmallGrid() + "--only method=base --no-report --out " + At("base")), 0);
  ASSERT_EQ(Run("sweep", SmallGrid() + "--only method=ours --no-report --out " + At("ours")), 0);
  ASSERT_EQ(Run("report", At("base") + At("ours") + "--bootstrap 50 --export " + At("all.json")), 0)
      << output_;
  const auto file = ReadResultFile(folder_ + "/all.json");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->results.size(), 4u);
  EXPECT_TRUE(file->results[1].versus_base.has_value()) << "the pairs are across the runs";
  EXPECT_EQ(Run("report", At("base") + At("base") + "--export " + At("twice.json")), 1);
  EXPECT_THAT(output_, HasSubstr("unit tabletop_goal-clean-L5-nano-base-s0 stands in"));
  EXPECT_EQ(Run("report", At("base") + At("ours")), 1);
  EXPECT_THAT(output_, HasSubstr("a report is of one RUN_DIR"));
  EXPECT_EQ(Run("report", At("base") + "--export-leaderboard " + At("board.json")), 1);
  EXPECT_THAT(output_, HasSubstr("needs --leaderboard model=VALUE"));
}

}  // namespace
}  // namespace robostress
