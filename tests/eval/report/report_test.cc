#include "eval/report/report.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/svg_plot.h"
#include "eval/report/report_page.h"
#include "eval/report/severity_section.h"
#include "eval/report/statistics_section.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

RunData SmallRun() {
  RunData run;
  run.dir = "runs/<small>";
  run.units = {SyntheticUnit("clean", "base", {1, 1, 1, 0}),
               SyntheticUnit("clean", "ours", {1, 1, 1, 0}),
               SyntheticUnit("heavy_payload", "base", {1, 0, 0, 0}),
               SyntheticUnit("heavy_payload", "ours", {1, 1, 0, 0}, {0, 1, 2, 3})};
  return run;
}

TEST(TerminalTable, SaysHowManyEpisodesWhereMethodsDiffer) {
  RunData run = SmallRun();
  run.units.push_back(SyntheticUnit("heavy_payload", "base", {1, 0, 0}));
  run.units.back().config.seed = 1;
  const Summary summary = Summarise(run, 100);
  EXPECT_THAT(TerminalTable(run, summary), HasSubstr("4 to 7"));
  EXPECT_THAT(ReportPage(run, summary, {}), HasSubstr("Heavy Payload (n = 4 to 7)"));
}

TEST(TerminalTable, ShowsRatesDifferencesUpdatesAndTheOneThatDidNotAdapt) {
  const RunData run = SmallRun();
  const std::string text = TerminalTable(run, Summarise(run, 100));
  EXPECT_THAT(text, HasSubstr("Heavy Payload"));
  EXPECT_THAT(text, HasSubstr("25.0 ["));
  EXPECT_THAT(text, HasSubstr("+25.0"));
  EXPECT_THAT(text, HasSubstr("+1/-0"));
  EXPECT_THAT(text, HasSubstr("not adapted"));
  EXPECT_THAT(text, HasSubstr("Average without Clean"));
}

TEST(Conclusion, SaysInOneSentenceWhatEachMethodIsWorth) {
  RunData run = SmallRun();
  run.units.push_back(SyntheticUnit("heavy_payload", "gain", {1, 1, 0, 0}));
  const Summary summary = Summarise(run, 100);
  const std::string text = Conclusion(summary.tables[0]);
  EXPECT_THAT(text, ::testing::StartsWith("Over 1 scenario with errors, 4 episodes a method, Base "
                                          "succeeds in 25.0 %, Ours 50.0 % (one cluster: no "
                                          "interval), Gain control "))
      << "the one task of a carried session";
  EXPECT_THAT(text, HasSubstr(" points ["));
  EXPECT_THAT(text, HasSubstr("which may be chance)."));
  EXPECT_THAT(TerminalTable(run, summary), ::testing::EndsWith(text + "\n"));
  EXPECT_EQ(Conclusion({}), "");
}

TEST(TableCsv, QuotesANameWithAComma) {
  RunData run = SmallRun();
  for (UnitResult& unit : run.units) unit.config.policy = "mine, \"the second\"";
  EXPECT_THAT(TableCsv(Summarise(run, 50)),
              HasSubstr("\n\"mine, \"\"the second\"\"\",5,all,clean,base,4,3,"));
}

TEST(Averages, OfOtherScenariosDoNotStandBesideEachOther) {
  RunData run = SmallRun();
  run.units.push_back(SyntheticUnit("aged_joint_elbow", "base", {1, 1, 1, 1}));
  run.units.push_back(SyntheticUnit("aged_joint_elbow", "gain", {1, 1, 1, 1}));
  run.units.push_back(SyntheticUnit("heavy_payload", "gain", {1, 1, 1, 1}));
  run.units.push_back(SyntheticUnit("heavy_payload", "null", {1, 1, 0, 0}));
  const Summary summary = Summarise(run, 100);
  const SuccessTable& table = summary.tables[0];
  EXPECT_NEAR(table.averages.at("base").success.estimate, 0.625, 1e-12);
  EXPECT_TRUE(std::isnan(table.averages.at("ours").success.estimate));
  EXPECT_EQ(table.averages.at("ours").n, 0);
  EXPECT_FALSE(table.averages.at("ours").contrasts.versus_base.has_value());
  EXPECT_FALSE(table.averages.at("gain").contrasts.versus_control.count("null"));
  const std::string note = MissingNote(table);
  EXPECT_EQ(note, "An average is over every scenario of the table: " + MethodTitle("ours") +
                      " lacks Aged Joint-Elbow; " + MethodTitle("null") +
                      " lacks Aged Joint-Elbow.");
  const std::string text = TerminalTable(run, summary), page = ReportPage(run, summary, {});
  EXPECT_THAT(text, HasSubstr(note));
  EXPECT_THAT(page, HasSubstr(note));
  EXPECT_THAT(page, Not(::testing::ContainsRegex("nan[^o]")));
  EXPECT_THAT(Conclusion(table),
              AllOf(::testing::StartsWith("Over 2 scenarios with errors, 8 episodes a method, Base "
                                          "succeeds in 62.5 %, Gain control 100.0 %"),
                    Not(HasSubstr("Ours"))));
  run.units.pop_back();
  for (UnitResult& unit : run.units)
    if (unit.config.method->method == "gain") unit.episodes.pop_back();
  EXPECT_THAT(Conclusion(Summarise(run, 100).tables[0]), HasSubstr("6 to 8 episodes a method"));
}

TEST(Report, ThePapersColumnIsOfTheSameTasksOnLibero) {
  RunData run = SmallRun();
  const auto said = [&run] {
    const Summary summary = Summarise(run, 100);
    return TerminalTable(run, summary) + ReportPage(run, summary, {});
  };
  EXPECT_THAT(said(), AllOf(HasSubstr("column: another policy and other tasks."),
                            HasSubstr("only: another policy, other tasks, 20 episodes")));
  for (UnitResult& unit : run.units) unit.config.suite = "libero_goal";
  EXPECT_THAT(said(), AllOf(HasSubstr("column: another policy.\n"),
                            HasSubstr("only: another policy, 20 episodes")));
  run.units.back().config.suite = "tabletop_goal";
  EXPECT_THAT(said(), HasSubstr("another policy and other tasks"));
}

TEST(ReportPage, RefersToNothingOutsideItself) {
  const RunData run = SmallRun();
  const std::string page = ReportPage(run, Summarise(run, 100), {});
  // The only address is the SVG namespace, which nothing loads.
  std::string rest = page;
  for (size_t at; (at = rest.find("http://www.w3.org/2000/svg")) != std::string::npos;)
    rest.erase(at, 26);
  EXPECT_THAT(rest, Not(HasSubstr("http")));
  EXPECT_THAT(rest, Not(HasSubstr("<script")));
  EXPECT_THAT(rest, Not(HasSubstr("<link")));
  EXPECT_THAT(rest, Not(::testing::ContainsRegex("nan[^o]")));
  EXPECT_THAT(rest, HasSubstr("runs/&lt;small&gt;"));
}

TEST(ClippedCommandsNote, NamesAPolicyWhoseActionsHaveAnotherUnit) {
  RunData run;
  run.units = {SyntheticUnit("heavy_payload", "base", {1, 0}),
               SyntheticUnit("heavy_payload", "gain", {1, 0})};
  for (EpisodeRow& row : run.units[0].episodes) row.clipped_share = 0.002;
  for (EpisodeRow& row : run.units[1].episodes) row.clipped_share = 0.9;  // a method pushes
  EXPECT_EQ(ClippedCommandsNote(run), "");
  for (EpisodeRow& row : run.units[0].episodes) row.clipped_share = 0.94;
  EXPECT_THAT(ClippedCommandsNote(run),
              ::testing::HasSubstr("94 % of nano's numbers lay outside -1 to 1"));
  EXPECT_EQ(ClippedCommandsNote(RunData()), "");
}

TEST(ReportPage, WarnsWhenThePolicyIsTooWeakForAClaim) {
  RunData run = SmallRun();
  EXPECT_THAT(ReportPage(run, Summarise(run, 100), {}),
              Not(HasSubstr("no claim about adaptation")));
  for (EpisodeRow& row : run.units[0].episodes) row.success = false;
  EXPECT_THAT(ReportPage(run, Summarise(run, 100), {}), HasSubstr("no claim about adaptation"));
}

TEST(ReportPage, SaysWhatTheDifferencesAreWorth) {
  const RunData run = SmallRun();
  const std::string page = ReportPage(run, Summarise(run, 100), {});
  EXPECT_THAT(page, HasSubstr("id=statistics"));
  EXPECT_THAT(page, HasSubstr("Episodes needed"));
  EXPECT_THAT(page, Not(HasSubstr("id=severity"))) << "one level";
}

TEST(EpisodesNeeded, CountsTheDesignEffectAndRefusesWhatCannotBe) {
  Comparison comparison;
  comparison.pairs = 100, comparison.plus = 15, comparison.minus = 15;
  EXPECT_EQ(EpisodesNeededText(comparison, 5), "940");
  comparison.design_effect = 2;
  EXPECT_EQ(EpisodesNeededText(comparison, 5), "1880");
  EXPECT_EQ(EpisodesNeededText(comparison, 40), "") << "30 % of the outcomes differ";
}

TEST(SeverityFigure, HasAPanelForEveryScenarioAndSuiteWithItsCount) {
  RunData run;
  for (const std::string suite : {"tabletop_goal", "tabletop_long"}) {
    for (const std::string scenario : {"heavy_payload", "aged_joint_elbow"}) {
      for (const int severity : {1, 3, 5}) {
        run.units.push_back(SyntheticUnit(scenario, "base", {1, 0, 1}, {}, suite));
        run.units.back().config.severity = severity;
      }
    }
  }
  const Summary summary = Summarise(run, 10);
  const std::string figure = SeverityFigure(summary, "nano");
  for (const char* title : {"Heavy Payload (n = 3)", "Goal, severity level",
                            "Aged Joint-Elbow (n = 3)", "Long, severity level"})
    EXPECT_THAT(figure, HasSubstr(title));
  EXPECT_THAT(ReportPage(run, summary, {}), HasSubstr("id=severity"));
  EXPECT_EQ(SeverityFigure(summary, "other"), "");
}

TEST(ReportPage, EveryFigureSaysHowManyEpisodesItIsOf) {
  const RunData run = SmallRun();
  const std::string page = ReportPage(run, Summarise(run, 100), {});
  EXPECT_THAT(page, HasSubstr("Heavy Payload (n = 4)"));
  EXPECT_THAT(page, HasSubstr("n = 1</small>")) << "units at each point of a curve";
}

TEST(ReportPage, HoldsWithBaseAlone) {
  RunData run;
  run.units = {SyntheticUnit("clean", "base", {1, 0})};
  EXPECT_THAT(ReportPage(run, Summarise(run, 100), {}), HasSubstr("nothing to compare yet"));
}

TEST(ReportPage, ShowsThePairWhoseOutcomesDifferFirst) {
  RunData run = SmallRun();
  run.dir = TestFolder();
  // Heavy Payload: base and ours agree on episode 0 and differ on episode 1.
  for (size_t unit : {2, 3}) {
    for (int episode : {0, 1}) {
      std::filesystem::create_directories(run.dir + "/" + std::to_string(unit));
      const std::string film = run.dir + "/" + std::to_string(unit) + "/task0_episode" +
                               std::to_string(episode) + ".webp";
      ASSERT_TRUE(WriteFileAtomically(film, "film").ok());
      run.units[unit].videos.push_back(film);
    }
  }
  ReportOptions options;
  options.max_videos = 2;
  const std::string page = ReportPage(run, Summarise(run, 100), options);
  EXPECT_THAT(page, HasSubstr("task 0, episode 1"));
  EXPECT_THAT(page, Not(HasSubstr("task 0, episode 0")));
  EXPECT_THAT(page, HasSubstr("data:image/webp;base64,ZmlsbQ=="));
  EXPECT_THAT(page, HasSubstr("2 more films"));
}

TEST(WriteReport, PublishesPageDataAndFigures) {
  RunData run = SmallRun();
  run.dir = TestFolder();
  ReportOptions options;
  options.print = false;
  ASSERT_TRUE(WriteReport(run, options).ok());
  const absl::StatusOr<std::string> text = ReadFile(run.dir + "/report.json");
  ASSERT_TRUE(text.ok()) << text.status();
  const nlohmann::json report = nlohmann::json::parse(*text);
  EXPECT_EQ(report["tables"][0]["scenarios"][1]["cells"]["ours"]["versus_base"]["plus"], 1);
  for (const char* file : {"/report.html", "/table.csv", "/figures/success-nano-L5.svg"})
    EXPECT_TRUE(ReadFile(run.dir + file).ok()) << file;
}

TEST(TableCsv, HasOneWidth) {
  const RunData run = SmallRun();
  const std::string csv = TableCsv(Summarise(run, 100));
  size_t columns = 0;
  for (size_t start = 0; start < csv.size();) {
    const size_t end = csv.find('\n', start);
    const size_t commas = std::count(csv.begin() + start, csv.begin() + end, ',');
    if (start == 0) columns = commas;
    EXPECT_EQ(commas, columns) << csv.substr(start, end - start);
    start = end + 1;
  }
}

TEST(TableCsv, EachPValueStandsInItsColumn) {
  Summary summary = Summarise(SmallRun(), 100);
  int written = 0;
  for (ScenarioRow& row : summary.tables[0].rows) {
    auto& base = row.cells.at("ours").contrasts.versus_base;
    if (!base) continue;
    base->p_value = 0.01, base->p_holm = 0.07, base->mcnemar_p = 0.02;
    ++written;
  }
  ASSERT_GT(written, 0);
  const std::vector<std::string> lines = absl::StrSplit(TableCsv(summary), '\n');
  const std::vector<std::string> names = absl::StrSplit(lines[0], ',');
  const auto cell = [&](const std::vector<std::string>& cells, const char* name) {
    return cells[static_cast<size_t>(std::find(names.begin(), names.end(), name) - names.begin())];
  };
  for (const std::string& line : lines) {
    const std::vector<std::string> cells = absl::StrSplit(line, ',');
    if (cells.size() < names.size() || cell(cells, "method") != "ours" ||
        cell(cells, "scenario") == "average_without_clean")
      continue;
    EXPECT_EQ(cell(cells, "p_value"), "0.01");
    EXPECT_EQ(cell(cells, "p_holm"), "0.07");
    EXPECT_EQ(cell(cells, "mcnemar_p"), "0.02");
    --written;
  }
  EXPECT_EQ(written, 0);
}

TEST(NiceTicks, StayInsideAndAreRound) {
  EXPECT_THAT(NiceTicks(0, 100, 5), ::testing::ElementsAre(0, 20, 40, 60, 80, 100));
  for (const double tick : NiceTicks(0.013, 0.087, 4)) {
    EXPECT_GE(tick, 0.013);
    EXPECT_LE(tick, 0.087 + 1e-9);
  }
}

TEST(LinePlot, LeavesAGapWhereNothingWasMeasured) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::string svg = LinePlot({{"a", "#000", {1, 2, 3, 4}, {1, nan, 2, 3}}}, {});
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  const size_t path = svg.find("<path d=\"");
  const std::string d = svg.substr(path, svg.find('"', path + 9) - path);
  EXPECT_EQ(std::count(d.begin(), d.end(), 'M'), 2);
}

}  // namespace
}  // namespace robostress
