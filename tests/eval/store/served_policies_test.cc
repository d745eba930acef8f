#include "eval/store/served_policies.h"

#include <vector>

#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/unit/unit_runner.h"
#include "eval/plan/plan.h"
#include "eval/store/unit_files.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

// A policy whose server does what `after` says during each episode.
class ServedPlayer : public UnitPlayer {
 public:
  ServedPlayer(PolicyServer server, std::vector<PolicyServer> after)
      : server_(std::move(server)), after_(std::move(after)) {}
  absl::StatusOr<std::string> Open() override { return "model"; }
  std::map<std::string, std::string> Provenance() const override {
    return {{"metadata", server_.metadata}};
  }
  std::optional<PolicyServer> Server() const override { return server_; }
  absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode&, UnitDirectory&) override {
    if (played_ == after_.size()) return absl::UnavailableError("the server is gone");
    server_ = after_[played_++];
    return PlayedEpisode();
  }

 private:
  PolicyServer server_;
  const std::vector<PolicyServer> after_;
  size_t played_ = 0;
};

UnitConfig RemoteUnit(int episodes) {
  UnitConfig unit;
  unit.suite = "tabletop_goal";
  unit.policy = "pi05";
  unit.tasks = {2};
  unit.episodes = episodes;
  unit.remote.dialect.name = "libero";
  return unit;
}

// What a run says of the unit in `folder`.
RunData RunOf(const std::string& folder) {
  RunData run;
  UnitTextReader texts;
  run.units.push_back(InspectUnit(folder, texts).unit);
  return run;
}

TEST(ServedPolicies, AUnitKeepsWhoAnsweredItAndWhatBroke) {
  const std::string folder = TestFolder() + "/" + UnitId(RemoteUnit(5));
  const UnitConfig unit = *ResolveUnit(RemoteUnit(5));
  UnitRunOptions options;
  options.out = folder;
  ServedPlayer first({"ws://a:1/", "{}", 0}, {{"ws://a:1/", "{}", 0}, {"ws://a:1/", "{}", 2}});
  EXPECT_FALSE(RunUnit(unit, options, first).ok());
  ServedPlayer second({"ws://b:2/", "{}", 0},
                      {{"ws://b:2/", "{}", 0}, {"ws://b:2/", "{}", 1}, {"ws://b:2/", "{}", 4}});
  ASSERT_TRUE(RunUnit(unit, options, second).ok());

  const RunData run = RunOf(folder);
  const std::vector<ServerRow>& rows = run.units[0].servers;
  ASSERT_THAT(rows, SizeIs(5));
  EXPECT_EQ(rows[0].url, "ws://a:1/");
  EXPECT_EQ(rows[0].episode, 0);
  EXPECT_EQ(rows[1].episode, 1) << "when the connection broke";
  EXPECT_EQ(rows[1].reconnections, 2);
  EXPECT_EQ(rows[2].url, "ws://b:2/") << "a run that goes on elsewhere says so";
  EXPECT_EQ(rows[2].episode, 2);
  EXPECT_EQ(rows[3].reconnections, 1);
  EXPECT_EQ(rows[4].reconnections, 3) << "of that episode alone";
  const std::vector<ServedPolicy> served = ServedPolicies(run);
  ASSERT_THAT(served, SizeIs(1));
  EXPECT_EQ(served[0].reconnections, 6);
  EXPECT_THAT(served[0].changed, IsEmpty());
  EXPECT_THAT(served[0].metadata_sha256, ElementsAre(Sha256Hex("{}")));
  EXPECT_FALSE(served[0].noise_paired);
  const std::string notes = absl::StrJoin(ServerNotes(run), "\n");
  EXPECT_THAT(notes, HasSubstr("ws://a:1/ (1), ws://b:2/ (1)"));
  EXPECT_THAT(notes, HasSubstr("6 reconnections."));
}

TEST(ServedPolicies, MetadataThatChangesInMidRunIsAWarningThatNamesTheUnit) {
  const std::string id = UnitId(RemoteUnit(2)), folder = TestFolder() + "/" + id;
  UnitRunOptions options;
  options.out = folder;
  ServedPlayer player({"ws://a:1/", "{}", 0},
                      {{"ws://a:1/", "{}", 0}, {"ws://a:1/", "{\"model\":2}", 1}});
  ASSERT_TRUE(RunUnit(*ResolveUnit(RemoteUnit(2)), options, player).ok());
  const RunData run = RunOf(folder);
  EXPECT_EQ(run.units[0].servers.back().metadata, "{\"model\":2}");
  EXPECT_THAT(ServedPolicies(run)[0].changed, ElementsAre(id));
  const std::vector<std::string> notes = ServerNotes(run);
  ASSERT_THAT(notes, SizeIs(2));
  EXPECT_THAT(notes[0], HasSubstr("pi05 changed its metadata while 1 unit ran, so that their rows "
                                  "may be of two models"));
  EXPECT_THAT(notes[0], HasSubstr(id));
}

TEST(ServedPolicies, OlderUnitsTellTheFirstAddress) {
  RunData run;
  run.units.push_back(SyntheticUnit("clean", "base", {1}));
  run.units[0].config.remote.dialect.name = "vllm_omni";
  run.units[0].config.remote.dialect.seed = "seed";
  run.units[0].provenance = {{"url", "ws://old:8000/?key=hunter2"}, {"metadata", "{}"}};
  const std::string note = absl::StrJoin(ServerNotes(run), "\n");
  EXPECT_THAT(note, HasSubstr("ws://old:8000/ (1)"));
  EXPECT_THAT(note, Not(HasSubstr("hunter2")));
  EXPECT_TRUE(ServedPolicies(run)[0].noise_paired);
  run.units[0].config.remote = {};
  EXPECT_THAT(ServerNotes(run), IsEmpty()) << "a policy of ours";
}

}  // namespace
}  // namespace robostress
