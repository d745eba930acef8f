#include "eval/report/result_file.h"

#include <filesystem>
#include <functional>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "eval/report/leaderboard.h"
#include "eval/report/result_export.h"
#include "eval/statistics/summary.h"
#include "eval/store/played_alike.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/shared_run.h"

namespace robostress {
namespace {

using nlohmann::json;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

std::string Text() { return WriteResultFile(Exported(RemoteRun())); }

// What a reader says of the file after `change`.
std::string Refusal(const std::function<void(json&)>& change) {
  json file = json::parse(Text());
  change(file);
  return std::string(ParseResultFile("theirs.json", file.dump()).status().message());
}

TEST(ResultFile, ComesBackAsItWas) {
  const std::string text = Text();
  const auto read = ParseResultFile("ours.json", text);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(WriteResultFile(*read), text);
  ASSERT_EQ(read->policies.size(), 1u);
  EXPECT_EQ(read->policies[0].label, "pi05");
  EXPECT_FALSE(read->policies[0].noise_paired);
  EXPECT_EQ(read->policies[0].server->reconnections, 3);
  EXPECT_THAT(read->robostress, ElementsAre("0.9"));
}

TEST(ResultFile, HoldsEveryCellWithWhatItIsWorth) {
  const ResultFile file = Exported(RemoteRun());
  ASSERT_EQ(file.results.size(), 4u);
  const ResultCell& cell = file.results.back();
  EXPECT_EQ(cell.suite, "tabletop_goal");
  EXPECT_EQ(cell.scenario, "heavy_payload");
  EXPECT_EQ(cell.severity, 5);
  EXPECT_EQ(cell.method, "ours_following");
  EXPECT_EQ(cell.counts.n, 8) << "two repeats of four states";
  EXPECT_EQ(cell.counts.clusters, 4);
  EXPECT_EQ(cell.counts.successes, 6);
  EXPECT_GT(cell.counts.design_effect, 1);
  EXPECT_THAT(cell.seeds, ElementsAre(0, 1));
  ASSERT_TRUE(cell.versus_base.has_value());
  EXPECT_EQ(cell.versus_base->pairs, 8);
  EXPECT_EQ(cell.versus_base->plus - cell.versus_base->minus, 4);
  EXPECT_EQ(file.results.front().severity, 0) << "Clean is equal at every level";
  ASSERT_EQ(file.means.size(), 2u);
  EXPECT_THAT(file.means[0].scenarios, ElementsAre("heavy_payload"));
  EXPECT_EQ(file.methods[0].role, "base");
  ASSERT_EQ(file.scenarios.size(), 2u);
  EXPECT_EQ(file.scenarios[1].sha256.size(), 64u);
  EXPECT_NE(file.scenarios[0].sha256, file.scenarios[1].sha256);
  EXPECT_EQ(file.protocols[0].options.at("sim.stepping"), "fast");
  EXPECT_EQ(file.protocols[0].options.count("scenario"), 0u);
  EXPECT_THAT(absl::StrCat(file.notes[0]), HasSubstr("Sampling noise not paired"));
}

TEST(ResultFile, SaysNothingOfTheMachineThatMadeIt) {
  RunData run = RemoteRun();
  for (UnitResult& unit : run.units) {
    unit.config.libero_root = "/home/ann/LIBERO";
    unit.config.robosuite_root = "/home/ann/robosuite";
    unit.config.libero_fixtures = "/home/ann/fixtures.json";
    unit.config.policy = "/home/ann/pi05.safetensors";
    unit.provenance["metadata"] = "{\"path\": \"/home/ann/weights\"}";
  }
  const std::string text = WriteResultFile(Exported(run));
  for (const char* secret : {"ann", "gpu.lab.example", "hunter2", "team-7", "/home", "10.1.2.3"})
    EXPECT_THAT(text, Not(HasSubstr(secret)));
  EXPECT_THAT(text, HasSubstr("ws://HOST:8000/..."));
}

TEST(SharedUrl, KeepsSchemePortAndTheUsualPath) {
  EXPECT_EQ(SharedUrl("ws://gpu:8000/", ""), "ws://HOST:8000/");
  EXPECT_EQ(SharedUrl("ws://gpu:8000", ""), "ws://HOST:8000/");
  EXPECT_EQ(SharedUrl("wss://[fd00::1]:443/openpi/policy?key=1", "/openpi/policy"),
            "wss://HOST:443/openpi/policy");
  EXPECT_EQ(SharedUrl("wss://[fd00::1]/team-7", "/openpi/policy"), "wss://HOST/...");
  EXPECT_EQ(SharedUrl("ws://gpu:80?key=1", ""), "ws://HOST:80/");
}

TEST(ResultFile, UnitsThatWereNotPlayedAlikeAreNoTable) {
  RunData run = RemoteRun();
  run.units[1].config.sim.settle_steps = 20;
  const auto refused = ExportResults(run, Summarise(run, 20));
  EXPECT_THAT(std::string(refused.status().message()),
              HasSubstr("suite tabletop_goal: sim.settle_steps is 10 in " + run.units[0].id +
                        ", and 20 in " + run.units[1].id));
  run = RemoteRun();
  run.units[1].config.first_initial_state = 1;
  EXPECT_TRUE(UnlikeUnits(run).empty()) << "episodes pair where they are the same";
  EXPECT_THAT(std::string(ExportResults(run, Summarise(run, 20)).status().message()),
              HasSubstr("suite tabletop_goal: first_initial_state is 0 in "));
}

TEST(ResultFile, EveryFieldMustBeThere) {
  // Removes every field of the file, one at a time.
  const json whole = json::parse(Text());
  int removed = 0;
  std::function<void(const json&, const json::json_pointer&)> walk =
      [&](const json& node, const json::json_pointer& at) {
        const std::string where = at.to_string();
        const bool free =
            absl::StrContains(where, "/options") || absl::EndsWith(where, "/versus_controls");
        if (node.is_object()) {
          for (const auto& [key, value] : node.items()) {
            if (!free) {
              json changed = whole;
              changed[at].erase(key);
              const auto read = ParseResultFile("theirs.json", changed.dump());
              EXPECT_THAT(std::string(read.status().message()),
                          HasSubstr(absl::StrCat(key, " is missing")))
                  << where;
              ++removed;
            }
            walk(value, at / key);
          }
        }
        if (!node.is_array() || node.empty()) return;
        walk(node.front(), at / 0);
        walk(node.back(), at / (node.size() - 1));
      };
  walk(whole, json::json_pointer());
  EXPECT_GT(removed, 60);
}

TEST(ResultFile, NoFieldTakesAValueOfAnotherKind) {
  // Every leaf, with values that are wrong for it; none may crash, pass as read and change meaning.
  const json whole = json::parse(Text());
  std::vector<json::json_pointer> leaves;
  std::function<void(const json&, const json::json_pointer&)> walk =
      [&](const json& node, const json::json_pointer& at) {
        if (node.is_object()) {
          for (const auto& [key, value] : node.items()) walk(value, at / key);
        } else if (node.is_array()) {
          for (size_t i = 0; i < node.size() && i < 2; ++i) walk(node[i], at / i);
          leaves.push_back(at);
        } else {
          leaves.push_back(at);
        }
      };
  walk(whole, json::json_pointer());
  ASSERT_GT(leaves.size(), 80u);
  const std::vector<json> wrong = {nullptr,
                                   true,
                                   -1,
                                   1e300,
                                   0.5,
                                   2000000000,
                                   18446744073709551615u,
                                   "",
                                   "x",
                                   json::array(),
                                   json::object(),
                                   std::string("a\nb"),
                                   std::string(5000, 'a')};
  int refused = 0, passed = 0;
  for (const json::json_pointer& leaf : leaves) {
    for (const json& value : wrong) {
      json changed = whole;
      if (changed[leaf] == value) continue;
      changed[leaf] = value;
      const auto read = ParseResultFile("theirs.json", changed.dump());
      if (!read.ok()) {
        ++refused;
        EXPECT_THAT(std::string(read.status().message()), HasSubstr("theirs.json"));
        continue;
      }
      ++passed;  // a free text, an absent interval: what was read is what the file says
      EXPECT_EQ(json::parse(WriteResultFile(*read)), changed) << leaf.to_string() << value.dump();
    }
  }
  EXPECT_GT(refused, 5 * passed) << refused << " " << passed;
}

TEST(ResultFile, ComplaintsNameFieldValueAndLimit) {
  EXPECT_THAT(Refusal([](json& f) { f["results"][0]["successes"] = 9; }),
              HasSubstr("field results[0].successes is 9, must be a whole number, 0 to 8"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][0]["n"] = -8; }),
              HasSubstr("results[0].n is -8, must be a whole number, 1 to"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][0]["successes"] = 1; }),
              HasSubstr("results[0]: rate is"));
  EXPECT_THAT(Refusal([](json& f) {
                f["results"][3]["interval"] = {0.1, 0.9};
              }),
              HasSubstr("interval is not that of n, successes and design_effect"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][3]["versus_base"]["plus"] = 7; }),
              HasSubstr("results[3].versus_base: difference is 0.5, plus, minus and pairs say"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][3]["versus_base"]["p"] = 1.5; }),
              HasSubstr("results[3].versus_base.p is 1.5, must be a number, 0 to 1"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][3]["policy"] = "pi0"; }),
              HasSubstr("results[3] names policy pi0, which the file does not declare"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][1] = f["results"][0]; }),
              HasSubstr("results[1] stands twice"));
  EXPECT_THAT(Refusal([](json& f) {
                f["means"][0]["interval"] = {0.9, 0.1};
              }),
              HasSubstr("null or two numbers in order, 0 to 1"));
  EXPECT_THAT(Refusal([](json& f) {
                f["means"][0]["interval"] = {0.9, 0.95};
              }),
              HasSubstr("means[0]: rate is 0.25, outside its interval [0.9, 0.95]"));
  EXPECT_THAT(Refusal([](json& f) {
                f["means"][0]["rate"] = 0.123;
                f["means"][0]["interval"] = nullptr;
              }),
              HasSubstr("means[0]: rate is 0.123 and n 8, its scenarios' results say 0.25 and 8"));
  EXPECT_THAT(Refusal([](json& f) { f["means"][0]["n"] = 16; }),
              HasSubstr("rate is 0.25 and n 16"));
  EXPECT_THAT(Refusal([](json& f) { f["means"][0]["scenarios"].push_back("rain"); }),
              HasSubstr("means[0] names scenario rain at severity 5, which the file does not"));
  EXPECT_THAT(Refusal([](json& f) { f["means"][0]["scenarios"].push_back("heavy_payload"); }),
              HasSubstr("means[0] names scenario heavy_payload twice"));
  EXPECT_THAT(Refusal([](json& f) {
                json& cell = f["results"][3];
                cell["versus_controls"]["rain"] = cell["versus_base"];
              }),
              HasSubstr("results[3] names method rain, which the file does not declare"));
  EXPECT_THAT(Refusal([](json& f) { f["results"][0]["host"] = "x"; }),
              HasSubstr("results[0].host is unknown in version 1"));
  EXPECT_THAT(Refusal([](json& f) { f["schema_version"] = 2; }),
              HasSubstr("robostress-result version 2, this program reads robostress-result version "
                        "1; use a newer RoboStress"));
  EXPECT_THAT(Refusal([](json& f) { f["schema"] = "other"; }), HasSubstr("schema is other"));
  EXPECT_THAT(Refusal([](json& f) { f["results"] = json::array(); }),
              HasSubstr("results is empty"));
}

TEST(ResultFile, NothingReachesATerminalThatSteersIt) {
  // DEL, C1 controls, a line separator, marks that turn the direction of writing.
  for (const char* mark : {"\x7f", "\u0080", "\u009b31m", "\u2028", "\u202e", "\u2066", "\u2069"}) {
    const std::string text = absl::StrCat("a", mark, "b");
    for (const std::string& refusal :
         {Refusal([&](json& f) { f["notes"][0] = text; }),
          Refusal([&](json& f) { f["policies"][0]["label"] = text; }),
          Refusal([&](json& f) { f[text] = 1; }), Refusal([&](json& f) {
            json& cell = f["results"][3];
            cell["versus_controls"][text] = cell["versus_base"];
          })}) {
      EXPECT_THAT(refusal, HasSubstr("theirs.json")) << text;
      EXPECT_THAT(refusal, Not(HasSubstr(mark)));
    }
  }
  EXPECT_EQ(Refusal([](json& f) { f["notes"][0] = "Größe \u00a0 \u2027 \u202f \u2065 π"; }), "");
}

TEST(ResultFile, TextThatIsNoFileOfOursIsRefusedWithWhatToGive) {
  for (const std::string& text :
       {std::string(), std::string("{"), std::string("[]"), std::string("NaN"),
        std::string(100, '['),
        absl::StrReplaceAll(Text(), {{"\"rate\": 0.", "\"rate\": NaN, \"x\": 0."}}),
        absl::StrReplaceAll(Text(), {{"\"p\": ", "\"p\": 1e999, \"q\": "}})}) {
    const auto read = ParseResultFile("theirs.json", text);
    EXPECT_THAT(std::string(read.status().message()),
                HasSubstr("robostress report RUN --export FILE"));
  }
  EXPECT_THAT(
      std::string(
          ParseResultFile("t", "{\"schema\": \"a\", \"schema\": \"b\"}").status().message()),
      HasSubstr("occurs twice"));
}

TEST(ResultFile, AFileOfAGigabyteIsRefusedUnread) {
  const std::string path = TestFolder() + "/huge.json";
  ASSERT_TRUE(WriteFileAtomically(path, "{").ok());
  std::filesystem::resize_file(path, uint64_t{1} << 30);  // sparse
  const auto read = ReadResultFile(path);
  EXPECT_FALSE(read.ok());
  EXPECT_THAT(std::string(read.status().message()), HasSubstr("67108864"));
  EXPECT_FALSE(ReadResultFile(path + ".none").ok());
}

TEST(Leaderboard, HasTheFieldsOfVlaEvalsSchemaAndClaimsNoRank) {
  const auto entry = ParseLeaderboardEntry(
      {"model=black25pi05", "weight_type=finetuned", "curated_by=@ann", "params=3B"});
  ASSERT_TRUE(entry.ok()) << entry.status();
  const auto text = LeaderboardJson(Exported(RemoteRun()), *entry, "2026-11-25");
  ASSERT_TRUE(text.ok()) << text.status();
  const json board = json::parse(*text);
  EXPECT_EQ(board["last_updated"], "2026-11-25");
  ASSERT_EQ(board["results"].size(), 2u);
  const json& base = board["results"][0];
  EXPECT_EQ(base["model"], "black25pi05");
  EXPECT_EQ(base["benchmark"], "robostress");
  EXPECT_TRUE(base["overall_score"].is_null()) << "one suite is not the whole protocol";
  EXPECT_EQ(base["suite_scores"]["heavy_payload"], 25.0);
  EXPECT_EQ(base["task_scores"]["reported_avg"], 25.0);
  const json& method = board["results"][1];
  EXPECT_EQ(method["model"], "black25pi05-ours_following");
  EXPECT_THAT(method["notes"].get<std::string>(), HasSubstr("against base"));
  EXPECT_THAT(method["notes"].get<std::string>(), HasSubstr("sampling noise not paired"));
  EXPECT_THAT(method["notes"].get<std::string>(), HasSubstr("heavy_payload ["));
}

TEST(Leaderboard, AWholeProtocolIsRanked) {
  RunData run;
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    for (const char* scenario :
         {"heavy_payload", "thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
          "aged_joint_uniform", "aged_joint_shoulder", "aged_joint_elbow"}) {
      UnitResult unit = SyntheticUnit(scenario, "base", std::vector<int>(20, 1), {}, suite);
      unit.config.tasks = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9};
      run.units.push_back(unit);
    }
  }
  const LeaderboardEntry entry{"m", "shared", "@ann", "", {}, {}, {}};
  const auto score = [&] {
    const auto text = LeaderboardJson(Exported(run), entry, "2026-11-25");
    EXPECT_TRUE(text.ok()) << text.status();
    return text.ok() ? json::parse(*text)["results"][0]["overall_score"] : json();
  };
  EXPECT_EQ(score(), 100.0);
  for (UnitResult& unit : run.units) unit.config.tasks.pop_back();
  EXPECT_TRUE(score().is_null());
  for (UnitResult& unit : run.units) unit.config.tasks.push_back(9);
  run.units.pop_back();
  EXPECT_TRUE(score().is_null()) << "one scenario of one suite is missing";
}

TEST(Leaderboard, RefusesWhatARunDoesNotKnowAndWhatTheSchemaDoesNotTake) {
  const auto refusal = [](const std::vector<std::string>& assignments) {
    return std::string(ParseLeaderboardEntry(assignments).status().message());
  };
  EXPECT_THAT(refusal({}), HasSubstr("needs --leaderboard model=VALUE"));
  EXPECT_THAT(refusal({"model=a", "weight_type=own", "curated_by=@a"}),
              HasSubstr("weight_type=own: must be shared"));
  EXPECT_THAT(refusal({"model=a", "weight_type=shared", "curated_by=ann"}), HasSubstr("@HANDLE"));
  EXPECT_THAT(refusal({"colour=red"}), HasSubstr("known keys: model, weight_type"));
  EXPECT_THAT(refusal({"model=a", "model=b"}), HasSubstr("twice"));
  EXPECT_THAT(refusal({"model=a", "weight_type=shared", "curated_by=@a", "model_paper=paper"}),
              HasSubstr("https://"));
  ResultFile two = Exported(RemoteRun());
  two.policies.push_back(two.policies[0]);
  EXPECT_THAT(std::string(LeaderboardJson(two, {}, "").status().message()),
              HasSubstr("of one policy, the runs have 2"));
}

}  // namespace
}  // namespace robostress
