#include "adapter/methods.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/command_correction.h"
#include "adapter/method_options.h"
#include "common/config.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string Message(const absl::Status& status) { return std::string(status.message()); }

// "`key: value`" of what differs from another's options, in the order of the options; the last is
// "..." where that one has an option that these lack.
std::vector<std::string> Over(const MethodOptions& options, const MethodOptions& other) {
  const YAML::Node given = YAML::Load(DumpConfig(options));
  const YAML::Node usual = YAML::Load(DumpConfig(other));
  std::vector<std::string> changes;
  for (const auto& entry : given) {
    const std::string key = entry.first.Scalar();
    const YAML::Node value = usual[key];  // not defined: written only where it is another
    if (key != "method" && (!value.IsDefined() || entry.second.Scalar() != value.Scalar()))
      changes.push_back(absl::StrCat("`", key, ": ", entry.second.Scalar(), "`"));
  }
  for (const auto& entry : usual)
    if (!given[entry.first.Scalar()].IsDefined()) return {"..."};
  return changes;
}

// The shortest way to say it: over the defaults, or over a preset that stands above.
std::string Over(const std::string& name) {
  const MethodOptions options = *MakeMethod(name);
  std::vector<std::string> least = Over(options, MethodOptions());
  for (const std::string& above : MethodNames()) {
    if (above == name) break;
    std::vector<std::string> changes = Over(options, *MakeMethod(above));
    if (changes == std::vector<std::string>{"..."} || changes.size() + 1 >= least.size()) continue;
    changes.insert(changes.begin(), absl::StrCat("`", above, "`"));
    least = changes;
  }
  return absl::StrJoin(least, ", ");
}

TEST(Methods, AreWhatTheAdaptersReadmeSays) {
  std::vector<std::string> rows;
  for (const std::string& name : MethodNames()) {
    const std::string over = Over(name);
    rows.push_back(absl::StrCat("| `", name, "` | ", over, over.empty() ? "|" : " |"));
  }
  std::ifstream file("adapter/README.md");
  ASSERT_TRUE(file) << "run from the source tree";
  std::vector<std::string> written;
  bool inside = false;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("## ")) inside = line == "## What a preset sets";
    if (inside && line.starts_with("| `")) written.push_back(line);
  }
  EXPECT_THAT(written, testing::ElementsAreArray(rows));
}

TEST(Methods, DefaultsAreThePapers) {
  const LoraOptions o;
  EXPECT_EQ(o.rank, 4);
  EXPECT_EQ(o.init_std, 0.01);
  EXPECT_EQ(o.beta1, 0.9);
  EXPECT_EQ(o.beta2, 0.999);
  EXPECT_EQ(o.adam_epsilon, 1e-8);
  EXPECT_EQ(o.clip_norm, 1);
  EXPECT_EQ(o.anchor_weight, 1e-4);
  EXPECT_EQ(o.buffer_chunks, 32);
  EXPECT_EQ(o.update_interval, 8);
  EXPECT_EQ(o.batch, 4);
  EXPECT_EQ(o.kind, LoraKind::kPerHead);
  EXPECT_TRUE(o.use_residual);
  const MethodOptions m;
  EXPECT_EQ(m.tracking_gain, 0.267);
  EXPECT_TRUE(m.clip_command && m.track_intent);
  EXPECT_FALSE(m.Compensates());
  EXPECT_EQ(m.gain, 1);
}

// The bytes that resolved configurations have had since there was the last of these keys.
TEST(Methods, AModelOfTheArmIsDoneBesideItAndAlone) {
  for (const std::string assignment : {"every_step=false", "following_gain=1", "direct=true"}) {
    const auto method = MakeMethod("known_errors", {assignment});
    ASSERT_TRUE(method.ok()) << method.status();
    EXPECT_THAT(Message(method->Check()), HasSubstr("arm_model=truth chooses every command"))
        << assignment;
  }
}

TEST(Methods, DynamicsNeedANominalArm) {
  for (const char* name : {"ours_integral", "ours_following", "ours_nominal", "ours_replanning"})
    EXPECT_TRUE(MakeMethod(name, {"panda_dynamics=true"})->Check().ok()) << name;
  for (const char* name : {"base", "ours", "direct", "smooth"})
    EXPECT_THAT(Message(MakeMethod(name, {"panda_dynamics=true"})->Check()),
                HasSubstr("panda_dynamics changes the nominal arm"))
        << name;
}

TEST(Methods, ADumpNamesEveryOptionInItsOldOrder) {
  std::vector<std::string> keys;
  for (const auto& entry : YAML::Load(DumpConfig(*MakeMethod("ours_following"))))
    keys.push_back(entry.first.Scalar());
  EXPECT_EQ(absl::StrJoin(keys, " "),
            "method adapt lora rank lora_init_std learning_rate beta1 beta2 adam_epsilon clip_norm "
            "anchor_weight buffer_chunks update_interval batch use_residual direct integral_rate "
            "integral_limit integral_threshold integral_axes integral_carry following_gain "
            "following_memory following_threshold following_limit following_axes gain target "
            "residual_scale tracking_gain clip_command noise_stream track_intent observation");
}

// ------------------------------------------------------------------------ every entry of the table

// "key=value" of an option that one way has.
constexpr const char* kOptionOfAWay[] = {
    "rank=3",         "integral_limit=0.3", "following_limit=0.3",
    "goal_limit=0.3", "calibrator_ridge=2", "envelope_way=0.3"};

class EveryMethod : public testing::TestWithParam<std::string> {
 protected:
  const MethodOptions method_ = *MakeMethod(GetParam());
};
INSTANTIATE_TEST_SUITE_P(Table, EveryMethod, testing::ValuesIn(MethodNames()),
                         [](const auto& info) { return info.param; });

TEST_P(EveryMethod, IsValidAndReadsBackToEveryBit) {
  EXPECT_TRUE(method_.Check().ok()) << method_.Check();
  EXPECT_EQ(method_.method, GetParam());
  EXPECT_EQ(DumpConfig(*ParseMethod("m", DumpConfig(method_))), DumpConfig(method_));
  // Over a preset, and as older servers stored it: the name, and nothing of the preset.
  MethodOptions changed = method_, bare;
  bare.method = GetParam();
  changed.tracking_gain = bare.tracking_gain = 0.1 + 0.2;
  for (const MethodOptions& options : {changed, bare}) {
    const auto again = ParseMethod("m", DumpConfig(options));
    ASSERT_TRUE(again.ok()) << again.status();
    EXPECT_EQ(DumpConfig(*again), DumpConfig(options));
  }
}

// A worker reads what a sweep wrote: what was turned off over a preset stays off.
TEST(Methods, WhatIsTurnedOffOverAPresetStaysOff) {
  for (const auto& [preset, off] : std::vector<std::pair<std::string, std::vector<std::string>>>{
           {"ours_replanning", {"execute_steps=0", "smoothing=0", "envelope_share=0"}},
           {"ours_following_step", {"every_step=false"}},
           {"known_errors", {"arm_model="}},
           {"dob_ours", {"observer=false"}}}) {
    const MethodOptions options = *MakeMethod(preset, off);
    EXPECT_NE(DumpConfig(options), DumpConfig(*MakeMethod(preset)));
    const auto again = ParseMethod("m", DumpConfig(options));
    ASSERT_TRUE(again.ok()) << again.status();
    EXPECT_EQ(DumpConfig(*again), DumpConfig(options)) << preset;
  }
}

TEST_P(EveryMethod, RefusesWhatItDoesNotKnowAndWhatWouldChangeNothing) {
  EXPECT_THAT(Message(MakeMethod(GetParam(), {"gian=2"}).status()),
              AllOf(HasSubstr("unknown key 'gian'"), HasSubstr("tracking_gain")));
  for (const std::string assignment : kOptionOfAWay) {
    const std::string key = assignment.substr(0, assignment.find('='));
    const absl::Status status = MakeMethod(GetParam(), {assignment}).status();
    const bool has = (key == "rank" && method_.Find<LoraOptions>() != nullptr) ||
                     (key == "integral_limit" && method_.Find<IntegralOptions>() != nullptr) ||
                     (key == "following_limit" && method_.Find<FollowingOptions>() != nullptr) ||
                     (key == "envelope_way" && method_.Find<EnvelopeOptions>() != nullptr);
    EXPECT_EQ(status.ok(), has) << status;
    if (has) continue;
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    const auto known = Message(status).substr(Message(status).find("what the method has: "));
    EXPECT_THAT(known, AllOf(HasSubstr("noise_stream"), Not(HasSubstr(key))));
    EXPECT_FALSE(
        ParseMethod("m", absl::StrCat("{method: \"", GetParam(), "\", ", key, ": 1}")).ok());
  }
}

TEST_P(EveryMethod, BoundsAnArmThatItCorrectsAndGoesOnFromItsState) {
  CommandCorrection correction(method_, ResidualOptionsOf(method_), {});
  CommandCorrection resumed = correction;
  DisturbedArm arm(0.8, (NominalArm::Vector6() << 0.1, 0, -0.2, 0, 0, 0).finished());
  const NominalArm::Vector6 command =
      (NominalArm::Vector6() << 0.2, -0.1, 0.05, 0, 0, 0).finished();
  bool changes = false;
  for (int chunk = 0; chunk < 30; ++chunk) {
    const Eigen::VectorXd value = correction.Value();
    NominalArm::Vector6 held = NominalArm::Vector6::Zero();
    if (value.size() > 0) held = value.head(6);
    changes = changes || held.norm() > 0;
    ASSERT_LT(held.cwiseAbs().maxCoeff(), 2) << "chunk " << chunk;
    correction.Observe(arm.Execute(command, -held));
    ASSERT_TRUE(resumed.set_state(correction.state()));
    EXPECT_EQ(resumed.Value(), correction.Value());
  }
  bool corrects = false;
  method_.ForEachWay([&]<class Way>(const Way&) {
    corrects = corrects || requires { typename Way::Corrector; };
  });
  EXPECT_EQ(changes, corrects);
  correction.StartEpisode();
  EXPECT_EQ(correction.Value().norm() > 0, corrects && method_.CarriesOver());
}

// ------------------------------------------------------------------------------------------
// reading

TEST(MakeMethod, UnknownMethodListsTheKnownOnes) {
  EXPECT_THAT(Message(MakeMethod("our").status()),
              AllOf(HasSubstr("'our'"), HasSubstr("ours_intent")));
}

TEST(MakeMethod, TakesOverridesTogetherWhateverTheirOrder) {
  const auto limit_first = MakeMethod("ours", {"integral_limit=0.3", "integral_rate=0.01"});
  ASSERT_TRUE(limit_first.ok()) << limit_first.status();
  EXPECT_EQ(limit_first->Find<IntegralOptions>()->limit, 0.3) << "two ways by free choice of keys";
  EXPECT_TRUE(limit_first->adapts());
  EXPECT_EQ(MakeMethod("ours", {"rank=2", "rank=3"})->Find<LoraOptions>()->rank, 3);
  const auto off = MakeMethod("ours_following", {"integral_rate=0", "integral_limit=0.3"});
  ASSERT_TRUE(off.ok()) << "it says itself that the way is off";
  EXPECT_EQ(off->Find<IntegralOptions>(), nullptr);
  EXPECT_THAT(Message(MakeMethod("ours", {"rank=many"}).status()),
              HasSubstr("override 'rank=many': rank is 'many', must be an integer"));
  EXPECT_THAT(Message(MakeMethod("ours", {"method=base"}).status()),
              HasSubstr("names another preset"));
}

TEST(MakeMethodOf, LeavesOutWhatIsMeantForOthers) {
  const std::vector<std::string> grid = {"base", "ours", "ours_following"};
  const std::vector<std::string> overrides = {"rank=2", "following_gain=0.6", "tracking_gain=0.3"};
  const auto of = [&](const char* name) { return *MakeMethodOf(grid, name, overrides); };
  EXPECT_EQ(DumpConfig(of("base")), DumpConfig(*MakeMethod("base", {"tracking_gain=0.3"})));
  EXPECT_EQ(of("ours").Find<LoraOptions>()->rank, 2);
  EXPECT_EQ(of("ours").Find<FollowingOptions>(), nullptr);
  EXPECT_EQ(of("ours_following").Find<FollowingOptions>()->gain, 0.6);
  EXPECT_FALSE(MakeMethodOf({"base", "gain"}, "base", {"rank=2"}).ok()) << "meant for none";
}

TEST(ParseMethod, TextNamesAPresetAndWhatStandsOverIt) {
  const auto ours = ParseMethod("m", "method: ours");
  ASSERT_TRUE(ours.ok()) << ours.status();
  EXPECT_EQ(DumpConfig(*ours), DumpConfig(*MakeMethod("ours")));
  EXPECT_TRUE(ours->adapts());
  const auto changed = ParseMethod("m", "{learning_rate: 0.5, method: no_anchor}");
  ASSERT_TRUE(changed.ok()) << changed.status();
  EXPECT_EQ(DumpConfig(*changed), DumpConfig(*MakeMethod("no_anchor", {"learning_rate=0.5"})));
}

// Recorded of a grid whose overrides all of its methods got: the values did nothing, and are gone.
TEST(ParseMethod, ARecordOfOptionsWithoutEffectIsRead) {
  const auto base = ParseMethod("m", "{method: base, adapt: false, learning_rate: 0.5}");
  ASSERT_TRUE(base.ok()) << base.status();
  EXPECT_EQ(DumpConfig(*base), DumpConfig(*MakeMethod("base")));
}

TEST(ParseMethod, TextWithoutAKnownMethodIsRefusedWithWhatIsKnown) {
  for (const char* yaml : {"", "{}", "learning_rate: 1", "method:", "method: [ours]", "method: ''",
                           "method: Ours", "method: magic", "adapt: true"}) {
    const absl::Status status = ParseMethod("where", yaml).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << yaml;
    EXPECT_THAT(Message(status), HasSubstr("where: ")) << yaml;
    EXPECT_THAT(Message(status), HasSubstr("base, ours, ours_intent")) << yaml;
  }
  EXPECT_THAT(Message(ParseMethod("where", "{method: ours, learning_rat: 1}").status()),
              HasSubstr("where: unknown key 'learning_rat'"));
  EXPECT_THAT(Message(ParseMethod("where", "{method: ours, method: base}").status()),
              HasSubstr("given twice"));
  EXPECT_FALSE(ParseMethod("where", "- ours").ok());
  EXPECT_FALSE(ParseMethod("where", "learning_rate: [1").ok());
}

// ------------------------------------------------------------------------------------------
// validity

TEST(MethodOptions, RefusesWhatMakesNoSense) {
  const auto refusal = [](const char* name, const std::string& assignment) {
    return Message(MakeMethod(name, {assignment})->Check());
  };
  EXPECT_EQ(refusal("ours", "batch=40"), "method ours: batch is 40, must be 1..32 (buffer_chunks)");
  EXPECT_EQ(refusal("ours", "beta1=1"), "method ours: beta1 is 1, must be in [0, 1)");
  EXPECT_THAT(refusal("ours", "rank=0"), HasSubstr("rank is 0, must be 1..256"));
  EXPECT_THAT(refusal("ours_integral", "integral_rate=-0.1"), HasSubstr("must be 0..1"));
  EXPECT_THAT(refusal("ours_integral", "integral_limit=11"), HasSubstr("must be 0..10"));
  EXPECT_THAT(refusal("ours_following", "following_memory=0.5"),
              HasSubstr("following_memory is 0.5, must be 1..1e6"));
  EXPECT_THAT(refusal("base", "gain=101"), HasSubstr("gain is 101, must be -100..100"));
  EXPECT_THAT(refusal("ours", "direct=true"), HasSubstr("direct and adapt exclude each other"));
  EXPECT_EQ(refusal("ours", "integral_rate=0.01"), "") << "these two do not";
  for (const char* method : {"base", "ours", "gain"})
    EXPECT_THAT(refusal(method, "every_step=true"), HasSubstr("every_step needs a method that"));
  EXPECT_EQ(refusal("direct", "every_step=true"), "");
  EXPECT_THAT(refusal("ours_following", "smoothing=0.5"), HasSubstr("set every_step=true"));
  EXPECT_THAT(refusal("smooth", "smoothing=1"), HasSubstr("smoothing is 1, must be"));
  EXPECT_THAT(refusal("smooth", "smoothing=0"), HasSubstr("every_step needs a method that"));
}

TEST(MethodOptions, SaysWhatNeedsAnEndEffectorController) {
  const auto refusal = [](const char* name) {
    return Message(MakeMethod(name)->CheckJointSpace("piper"));
  };
  EXPECT_EQ(refusal("ours"), "");
  EXPECT_EQ(refusal("direct"), "");
  EXPECT_THAT(refusal("ours_nominal"), HasSubstr("use target executed or intent"));
  EXPECT_THAT(refusal("gain"), HasSubstr("gain 1.15 would scale absolute joint targets"));
  EXPECT_THAT(refusal("ours_integral"),
              HasSubstr("integral action compares with a nominal end-effector controller; robot "
                        "piper acts in joint space"));
  EXPECT_THAT(refusal("ours_following"), HasSubstr("method ours_following: "));
  EXPECT_THAT(Message(MakeMethod("direct", {"every_step=true"})->CheckJointSpace("piper")),
              HasSubstr("every_step is done beside the arm"));
}

}  // namespace
}  // namespace robostress
