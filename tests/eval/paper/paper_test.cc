// The paper's tables: published numbers, plans, what is filled in, and the program with stand-ins.

#include <cmath>
#include <cstdlib>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "eval/paper/paper_programs.h"
#include "eval/paper/paper_results.h"
#include "eval/paper/paper_table.h"
#include "eval/paper/piper_tables.h"
#include "eval/report/paper_values.h"
#include "eval/store/run_directory.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/synthetic_run.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(PublishedTables, AveragesAreThoseOfTheirRows) {
  // The paper rounds its averages from unrounded rows: one decimal, or none on the arms.
  for (const PublishedTable& table : PublishedTables()) {
    const int average = table.RowOf("average");
    if (average <= 0) continue;
    const double tolerance = table.name == "real-arm" ? 0.6 : 0.11;
    for (const PublishedGroup& group : table.groups) {
      for (size_t c = 0; c < group.columns.size(); ++c) {
        double sum = 0;
        int n = 0;
        for (int r = 0; r < average; ++r) {
          if (table.rows[r] == "clean") continue;
          sum += group.values[r][c];
          ++n;
        }
        EXPECT_NEAR(sum / n, group.values[average][c], tolerance)
            << table.name << " " << group.title << " " << group.columns[c];
      }
    }
  }
}

TEST(PublishedTables, AgreeWhereTwoTablesSayTheSame) {
  const PublishedTable &main = *FindPublished("main"), &anchor = *FindPublished("anchor");
  for (size_t r = 0; r < anchor.rows.size(); ++r) {
    EXPECT_EQ(anchor.groups[0].values[r][1], main.groups[1].values[main.RowOf(anchor.rows[r])][3])
        << anchor.rows[r];
  }
  const PublishedTable& severity = *FindPublished("severity");
  for (size_t r = 0; r < severity.rows.size(); ++r) {
    EXPECT_EQ(severity.groups[0].values[r][1],
              main.groups[0].values[main.RowOf(severity.rows[r])][3])
        << severity.rows[r];
  }
  EXPECT_EQ(FindPublished("ablation")->groups[0].values[0][3], 44.2);
  EXPECT_EQ(PaperAverage().residual, 47.5);
  EXPECT_EQ(FindPaperRow("heavy_payload")->pi05_ours, 56.8);
}

TEST(PaperTables, HaveEveryPublishedTableAndOnlyThose) {
  ASSERT_EQ(PaperTables().size(), PublishedTables().size());
  for (const PaperTable& table : PaperTables()) {
    const PublishedTable* published = FindPublished(table.name);
    ASSERT_NE(published, nullptr) << table.name;
    for (const std::string& scenario : table.scenarios) {
      EXPECT_TRUE(table.only_average || published->RowOf(scenario) >= 0) << scenario;
    }
  }
  EXPECT_THAT(std::string(FindPaperTables({"mian", "noise", "anchr"}).status().message()),
              HasSubstr("unknown table 'mian', 'anchr'; known: main, noise"));
  EXPECT_EQ(FindPaperTables({"noise", "main", "noise"})->size(), 2u);
}

std::vector<PlannedUnit> QuickUnits(const PaperTable& table) {
  const auto grids = PaperGrids(table, QuickProtocol(), PolicyHome::kHere);
  EXPECT_TRUE(grids.ok()) << grids.status();
  const auto units = PaperUnits(*grids);
  EXPECT_TRUE(units.ok()) << units.status();
  return *units;
}

TEST(PaperPlan, FullIsThePapersProtocol) {
  const PaperTable main = *FindPaperTable("main");
  const auto grids = PaperGrids(main, FullProtocol(), PolicyHome::kHere);
  ASSERT_TRUE(grids.ok()) << grids.status();
  const auto units = PaperUnits(*grids);
  ASSERT_TRUE(units.ok());
  // Eight columns, eight scenarios, four suites, three seeds; 20 episodes on each of ten tasks.
  EXPECT_EQ(units->size(), 9u * 8 * 4 * 3);
  for (const PlannedUnit& unit : *units) EXPECT_EQ(unit.EpisodeCount(), 200);
}

TEST(PaperPlan, TablesShareTheirUnits) {
  const auto ids = [](const char* name) {
    std::set<std::string> ids;
    const std::vector<PlannedUnit> units = QuickUnits(*FindPaperTable(name));
    for (const PlannedUnit& unit : units) ids.insert(unit.id);
    return ids;
  };
  const std::set<std::string> main = ids("main"), severity = ids("severity");
  EXPECT_EQ(severity.size(), 2u * 7 * 5);
  int shared = 0;
  for (const std::string& id : severity) shared += main.count(id);
  EXPECT_EQ(shared, 2 * 7) << "level L5 is the main table's";
  for (const std::string& id : ids("residual")) EXPECT_TRUE(main.count(id)) << id;
}

TEST(PaperPlan, WeightsGoToLiberoAtThePapersRateAndMissingColumnsAreLeftOut) {
  PaperProtocol protocol = OnLibero(FullProtocol(), "pi0");
  protocol.grid.libero_root = protocol.grid.robosuite_root = "/libero";
  const auto grids = PaperGrids(*FindPaperTable("main"), protocol, PolicyHome::kElsewhere);
  ASSERT_TRUE(grids.ok()) << grids.status();
  const auto units = PaperUnits(*grids);
  ASSERT_TRUE(units.ok()) << units.status();
  EXPECT_EQ(units->size(), 6u * 8 * 4 * 3)
      << "base, ours, integral action, model following and the two controls of one policy";
  for (const PlannedUnit& unit : *units) {
    EXPECT_EQ(unit.config.suite.rfind("libero_", 0), 0u);
    const auto* lora = unit.config.method->Find<LoraOptions>();
    EXPECT_EQ(lora == nullptr ? 1e-6 : lora->learning_rate, 1e-6);
  }
  // A rate given by hand comes after it; a table of base alone has nothing that learns.
  protocol.grid.overrides = {"method.learning_rate=1e-5"};
  const auto by_hand = PaperGrids(*FindPaperTable("main"), protocol, PolicyHome::kElsewhere);
  ASSERT_TRUE(by_hand.ok()) << by_hand.status();
  const std::vector<PlannedUnit> units_by_hand = PaperUnits(*by_hand).value();
  bool adapts = false;
  for (const PlannedUnit& unit : units_by_hand) {
    const auto* lora = unit.config.method->Find<LoraOptions>();
    adapts |= lora != nullptr;
    EXPECT_EQ(lora == nullptr ? 1e-5 : lora->learning_rate, 1e-5);
  }
  EXPECT_TRUE(adapts);
  protocol.grid.overrides.clear();
  for (const char* table : {"residual", "severity", "noise"}) {
    EXPECT_TRUE(PaperGrids(*FindPaperTable(table), protocol, PolicyHome::kElsewhere).ok()) << table;
  }
}

TEST(PaperPlan, OurPolicyOfLiberosSuitesLearnsAtItsOwnRate) {
  PaperProtocol protocol = OnLibero(FullProtocol(), "nano-libero");
  protocol.grid.libero_root = protocol.grid.robosuite_root = "/libero";
  const auto grids = PaperGrids(*FindPaperTable("main"), protocol, PolicyHome::kElsewhere);
  ASSERT_TRUE(grids.ok()) << grids.status();
  const std::vector<PlannedUnit> units = PaperUnits(*grids).value();
  EXPECT_FALSE(units.empty());
  for (const PlannedUnit& unit : units) {
    if (const auto* lora = unit.config.method->Find<LoraOptions>()) {
      EXPECT_EQ(lora->learning_rate,
                MakeMethod(unit.config.method->method)->Find<LoraOptions>()->learning_rate);
    }
  }
}

// Units of a plan with outcomes that depend on the method alone.
RunData Played(const std::vector<PlannedUnit>& units) {
  RunData run;
  for (const PlannedUnit& planned : units) {
    const bool ours = planned.config.method->method == "ours";
    UnitResult unit =
        SyntheticUnit(planned.config.scenario, planned.config.method->method,
                      ours ? std::vector<int>{1, 1, 1, 0} : std::vector<int>{1, 0, 0, 0},
                      ours ? std::vector<int>{0, 1, 2, 3} : std::vector<int>{});
    unit.id = planned.id;
    const auto method = unit.config.method;
    unit.config = planned.config;
    unit.config.method = method;
    for (EpisodeRow& row : unit.episodes) row.residual = 0.5;
    run.units.push_back(unit);
  }
  return run;
}

FilledTable Filled(const std::string& name) {
  const PaperTable table = *FindPaperTable(name);
  const std::vector<PlannedUnit> units = QuickUnits(table);
  return FillPaperTable(table, QuickProtocol(), Played(units), units, 100);
}

TEST(PaperResults, MainTableHasOurNumbersBesideThePublishedOnes) {
  const FilledTable table = Filled("main");
  ASSERT_EQ(table.groups.size(), 4u);
  EXPECT_EQ(table.groups[0].columns, (std::vector<std::string>{"Base", "DR", "RobustVLA", "Ours"}));
  EXPECT_EQ(table.groups[3].title, "beside the paper");
  ASSERT_EQ(table.rows.size(), 9u);
  const FilledRow& payload = table.rows[1];
  EXPECT_EQ(payload.title, "Heavy Payload");
  EXPECT_EQ(*payload.cells[0].value, 25);
  EXPECT_EQ(*payload.cells[3].value, 75);
  EXPECT_EQ(payload.cells[3].n, 4);
  EXPECT_TRUE(payload.cells[3].best);
  EXPECT_EQ(payload.cells[3].note, "3 updates");
  EXPECT_EQ(*payload.cells[4].value, 44.1) << "the paper's pi0.5, base";
  EXPECT_EQ(*payload.cells[11].value, 42.8) << "the paper's pi0, ours";
  EXPECT_EQ(*table.rows[8].cells[3].value, 75) << "average";
  EXPECT_EQ(table.rows[8].cells[3].n, 28) << "without Clean";
  EXPECT_THAT(FilledText(table), HasSubstr("Ours - Gain control"));
  EXPECT_THAT(FilledText(table), HasSubstr("20 episodes per task, three seeds"));
}

TEST(PaperResults, EveryTableRendersInEveryForm) {
  for (const char* name : {"main", "noise", "ablation", "anchor", "severity", "residual"}) {
    const FilledTable table = Filled(name);
    size_t columns = 0;
    for (const FilledGroup& group : table.groups) columns += group.columns.size();
    for (const FilledRow& row : table.rows) EXPECT_EQ(row.cells.size(), columns) << name;
    const std::string page = FilledPage(table, "");
    EXPECT_THAT(page, Not(::testing::ContainsRegex("nan[^o]"))) << name;
    EXPECT_THAT(FilledCsv(table), HasSubstr(absl::StrCat("\n", name, ","))) << name;
    EXPECT_TRUE(nlohmann::json::parse(FilledJson(table), nullptr, false).is_object()) << name;
    EXPECT_THAT(FilledMarkdown(table), HasSubstr("|---|")) << name;
  }
  EXPECT_THAT(Filled("severity").figure, HasSubstr("Heavy Payload (n = 4)"));
  EXPECT_EQ(*Filled("residual").rows[1].cells[0].value, 50);
}

TEST(PaperResults, UnfinishedUnitsAreCountedAndOthersKeptOut) {
  const PaperTable table = *FindPaperTable("anchor");
  const std::vector<PlannedUnit> units = QuickUnits(table);
  RunData run = Played(units);
  run.units.erase(run.units.begin());
  run.units.push_back(SyntheticUnit("clean", "gain", {1}));
  const RunData chosen = UnitsOf(run, units);
  EXPECT_EQ(chosen.units.size(), units.size() - 1);
  const FilledTable filled = FillPaperTable(table, QuickProtocol(), chosen, units, 100);
  EXPECT_THAT(FilledText(filled),
              HasSubstr(absl::StrCat("1 of ", units.size(), " planned units are not finished")));
  const std::vector<FilledCell>& average = filled.rows.back().cells;
  EXPECT_NE(average[0].value.has_value(), average[1].value.has_value())
      << "the column whose scenario is missing has no average, the other has";
  EXPECT_EQ(filled.differences.back()[1], "-");
}

TEST(PiperResidual, IsReadFromWhatTheProgramPrints) {
  const std::string output =
      "| profile | payload [kg] | residual, mean of 3 episodes | range | rms [mrad] |\n"
      "|---|---|---|---|---|\n| new | 1 | 40.1 % | .. | 14.6 |\n| new | 0 | 31.6 % | 29 | 14.6 |\n";
  EXPECT_EQ(PiperResidualOf(output, "new"), 31.6);
  EXPECT_EQ(PiperResidualOf(output, "used_one_year"), std::nullopt);
}

// Five episodes of a unit of the study, the first `successes` of them won.
UnitResult StudyUnit(const std::string& suite, const std::string& arm, const std::string& policy,
                     const std::string& method, int successes) {
  std::vector<int> outcomes, updates;
  for (int e = 0; e < 5; ++e) {
    outcomes.push_back(e < successes);
    updates.push_back(method.find("ours") == std::string::npos ? 0 : e);
  }
  UnitResult unit = SyntheticUnit(arm, method, outcomes, updates, suite);
  unit.config.robot = "piper";
  unit.config.policy = policy;
  return unit;
}

TEST(PiperStudy, BecomesTheRealArmTables) {
  const PaperProtocol protocol = PiperProtocol("s");
  const std::string &base = protocol.base, &robust = protocol.robust;
  RunData run;
  run.units = {StudyUnit("piper_1_next_to_plate", "new", base, "base", 2),
               StudyUnit("piper_1_next_to_plate", "new", robust, "base", 3),
               StudyUnit("piper_1_next_to_plate", "new", base, "ours", 4),
               StudyUnit("piper_1_next_to_plate", "new", base, "dob_ours", 5),
               StudyUnit("piper_unseen", "new", base, "ours", 1)};
  const std::vector<PlannedUnit> planned(run.units.size());
  const FilledTable arms = FillPaperTable(*FindPaperTable("real-arm"), protocol, run, planned, 100);
  ASSERT_EQ(arms.rows.size(), 5u);
  EXPECT_EQ(arms.rows[0].title, "1 bowl next to the plate");
  EXPECT_EQ(*arms.rows[0].cells[0].value, 40);
  EXPECT_EQ(*arms.rows[0].cells[1].value, 60);
  EXPECT_EQ(*arms.rows[0].cells[2].value, 80);
  EXPECT_EQ(arms.rows[0].cells[2].note, "4 updates");
  EXPECT_FALSE(arms.rows[0].cells[3].value.has_value()) << "Robot B was not played";
  EXPECT_FALSE(arms.rows[1].cells[0].value.has_value());
  EXPECT_EQ(*arms.rows[0].cells[6].value, 48) << "the paper's Robot A, pi0.5, base";
  EXPECT_EQ(arms.groups[1].title, "emulated Robot B");
  EXPECT_THAT(arms.differences[0][2], HasSubstr("Robot A: Ours - Base"));
  EXPECT_THAT(arms.differences[1][2], HasSubstr("+40.0"));
  const FilledTable dob = FillPaperTable(*FindPaperTable("dob"), protocol, run, planned, 100);
  EXPECT_EQ(*dob.rows[0].cells[3].value, 100);
  EXPECT_FALSE(dob.rows[0].cells[1].value.has_value()) << "no DOB alone was run";
  EXPECT_EQ(*FillPaperTable(*FindPaperTable("unseen"), protocol, run, planned, 100)
                 .rows[0]
                 .cells[2]
                 .value,
            20);
  EXPECT_THAT(FilledText(arms), HasSubstr("No real arm was used"));
}

TEST(PiperStudy, ItsTablesArePlannedAsUnitsOfAGrid) {
  PaperProtocol protocol = PiperProtocol("s");
  std::set<std::string> ids;
  for (const char* name : {"real-arm", "dob", "unseen"}) {
    const auto grids = PaperGrids(*FindPaperTable(name), protocol, PolicyHome::kElsewhere);
    ASSERT_TRUE(grids.ok()) << grids.status();
    const auto units = PaperUnits(*grids);
    ASSERT_TRUE(units.ok()) << units.status();
    for (const PlannedUnit& unit : *units) {
      ids.insert(unit.id);
      EXPECT_EQ(unit.EpisodeCount(), 25) << unit.id;
    }
  }
  EXPECT_EQ(ids.size(), 2u * 4 * 3 + 2 + 3) << "base and ours of the observer's table are main's";
  for (const char* id : {"piper_1_next_to_plate-new-L5-piper-base-base-s0",
                         "piper_4_open_drawer-used_one_year-L5-piper-robust-base-s0",
                         "piper_1_next_to_plate-new-L5-piper-base-dob_ours-s0",
                         "piper_unseen-new-L5-piper-base-ours-s0"})
    EXPECT_EQ(ids.count(id), 1u) << id;
}

TEST(PayloadTable, ReadsContendersAndNamesWhatIsMissing) {
  const std::string file = TestFolder() + "/fidelity.json";
  ASSERT_TRUE(WriteFileAtomically(file, R"({"measured": {"rise": {"value_mm": 5.8},
      "dtw_between_replays_mm": 0.02, "loaded_replays": 3},
      "contenders": [{"name": "Heavy Payload, fitted",
      "dtw_per_step": {"value_mm": 1.25, "interval_mm": [1.0, 1.5]}, "rise": {"value_mm": 7.5},
      "replays": 10, "lost": 1}]})")
                  .ok());
  const auto table = PayloadTable(file);
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_THAT(FilledText(*table), HasSubstr("1.25 [1.00, 1.50]"));
  EXPECT_EQ(table->rows[1].cells[0].n, 9);
  EXPECT_EQ(*table->rows[0].cells[1].value, 5.8);
  EXPECT_EQ(table->rows[0].cells[0].n, 3);
  ASSERT_TRUE(WriteFileAtomically(file, R"({"contenders": [{"name": "x"}]})").ok());
  EXPECT_THAT(std::string(PayloadTable(file).status().message()), HasSubstr("dtw_per_step"));
  ASSERT_TRUE(WriteFileAtomically(file, R"({"contenders": [{"name": 3}]})").ok());
  EXPECT_THAT(std::string(PayloadTable(file).status().message()), HasSubstr("must be string"));
}

class PaperProgram : public ::testing::Test {
 protected:
  void SetUp() override { folder_ = TestFolder(); }
  std::pair<std::string, int> Paper(const std::string& arguments) {
    return RunProgram(
        absl::StrCat("ROBOSTRESS_BIN='", FAKE_PROGRAMS, "' '", BIN_DIR, "/robostress-paper'"),
        arguments + " --bootstrap 200");
  }
  std::string folder_;
};

TEST_F(PaperProgram, ListsTheTables) {
  const auto [output, code] = Paper("--list");
  EXPECT_EQ(code, 0);
  for (const PublishedTable& table : PublishedTables()) EXPECT_THAT(output, HasSubstr(table.label));
  EXPECT_THAT(output, HasSubstr("--full: 864 units, 172800 episodes"));
}

TEST_F(PaperProgram, RunsATableAndTheNextOneOnlyWhatIsMissing) {
  const std::string small =
      absl::StrCat("--tasks 1 --episodes 3 --videos 0 --out '", folder_, "' ");
  const auto [planned, plan_code] = Paper("anchor --dry-run " + small);
  EXPECT_EQ(plan_code, 0);
  EXPECT_THAT(planned, HasSubstr("anchor: 14 units, 42 episodes; 0 units done"));
  EXPECT_THAT(planned, HasSubstr("tabletop_object-heavy_payload-L5-nano-no_anchor-s0  3 episodes"));
  EXPECT_THAT(planned, HasSubstr("14 pieces of work, 42 episodes, about"));
  const auto [first, first_code] = Paper("anchor " + small);
  ASSERT_EQ(first_code, 0) << first;
  EXPECT_THAT(first, HasSubstr("w/ anchor - w/o anchor"));
  for (const char* form : {".html", ".md", ".csv", ".json"})
    EXPECT_TRUE(ReadFile(folder_ + "/tables/anchor" + form).ok()) << form;
  const auto [again, again_code] = Paper("ablation --dry-run " + small);
  EXPECT_EQ(again_code, 0);
  EXPECT_THAT(again, HasSubstr("ablation: 35 units, 105 episodes; 7 units done, 84 episodes"));
  const std::string table = *ReadFile(folder_ + "/tables/anchor.csv");
  ASSERT_EQ(Paper("ablation " + small).second, 0);
  ASSERT_EQ(Paper("anchor " + small).second, 0);
  EXPECT_EQ(*ReadFile(folder_ + "/tables/anchor.csv"), table) << "other units do not enter it";
  const auto [refused, refused_code] = Paper("anchor --dry-run --set method.rank=2 " + small);
  EXPECT_EQ(refused_code, 1) << "what a run would refuse";
  EXPECT_THAT(refused, HasSubstr("tabletop_object-heavy_payload-L5-nano-no_anchor-s0"));
  EXPECT_EQ(CountLines(folder_ + "/units/tabletop_object-heavy_payload-L5-nano-ours-s0/starts.txt"),
            1);
}

TEST_F(PaperProgram, WrongCommandsEndWithCodeTwo) {
  EXPECT_EQ(Paper("mian").second, 2);
  EXPECT_THAT(Paper("mian").first, HasSubstr("known: main"));
  EXPECT_EQ(Paper("").second, 2);
  EXPECT_EQ(Paper("main --quick --full").second, 2);
  const auto [output, code] = Paper("main --suites tabletop_gaol --dry-run");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(output, HasSubstr("tabletop_goal"));
}

TEST_F(PaperProgram, ProgramThatIsNotInTheBuildIsNamed) {
  const auto [output, code] = Paper(absl::StrCat("real-arm --out '", folder_, "'"));
  EXPECT_EQ(code, 1);
  EXPECT_THAT(output, HasSubstr("piper-study"));
}

}  // namespace
}  // namespace robostress
