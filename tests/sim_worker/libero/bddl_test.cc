#include "common/libero/bddl.h"

#include <gmock/gmock.h>

#include <filesystem>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "sim_worker/libero/task_doubts.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kProblem[] = R"((define (problem LIBERO_Tabletop_Manipulation)
  (:domain robosuite) ; a comment ) with a parenthesis
  (:language Put the bowl on the plate)
  (:regions
    (plate_region (:target main_table) (:ranges ((0.04 -0.03 0.06 -0.01))) (:yaw_rotation ((0 pi/2))))
    (top_region (:target wooden_cabinet_1))
  )
  (:fixtures main_table - table wooden_cabinet_1 - wooden_cabinet)
  (:objects akita_black_bowl_1 akita_black_bowl_2 - akita_black_bowl plate_1 - plate)
  (:obj_of_interest akita_black_bowl_1 plate_1)
  (:init (On plate_1 main_table_plate_region))
  (:goal (And (On akita_black_bowl_1 plate_1) (Open wooden_cabinet_1_top_region)))
))";

std::string ErrorOf(const std::string& text) {
  const absl::StatusOr<BddlProblem> problem = ParseBddl("task.bddl", text);
  return problem.ok() ? "parsed" : std::string(problem.status().message());
}

std::string With(const std::string& from, const std::string& to) {
  const std::string text = absl::StrReplaceAll(kProblem, {{from, to}});
  EXPECT_NE(text, kProblem) << from;
  return text;
}

TEST(BddlTest, ReadsEverySectionInTheFilesOrderAndInLowerCase) {
  const absl::StatusOr<BddlProblem> problem = ParseBddl("task.bddl", kProblem);
  ASSERT_TRUE(problem.ok()) << problem.status();
  EXPECT_EQ(problem->name, "libero_tabletop_manipulation");
  EXPECT_EQ(problem->language, "put the bowl on the plate");
  ASSERT_EQ(problem->objects.size(), 2u);
  EXPECT_THAT(problem->objects[0].instances,
              ElementsAre("akita_black_bowl_1", "akita_black_bowl_2"));
  EXPECT_EQ(problem->fixtures[1].category, "wooden_cabinet");
  const BddlRegion* region = problem->FindRegion("main_table_plate_region");
  ASSERT_NE(region, nullptr);
  EXPECT_THAT(region->ranges[0], ElementsAre(0.04, -0.03, 0.06, -0.01));
  EXPECT_DOUBLE_EQ(region->yaw[1], std::numbers::pi / 2);
  ASSERT_EQ(problem->goal.size(), 2u);
  EXPECT_EQ(problem->goal[1].predicate, "open");
  EXPECT_EQ(problem->goal[1].line, 12);
  EXPECT_EQ(problem->FindRegion("plate_region"), nullptr);
}

TEST(BddlTest, ErrorsNameFileLineAndToken) {
  EXPECT_THAT(ErrorOf(With("-0.01))", "x))")), HasSubstr("task.bddl:5: 'x' is not a number"));
  EXPECT_THAT(ErrorOf(With("(0.04 -0.03 0.06 -0.01)", "(0.04 -0.03 0.06)")),
              HasSubstr("task.bddl:5: expected a list of 4"));
  EXPECT_THAT(ErrorOf(With("0.04 -0.03 0.06", "0.07 -0.03 0.06")), HasSubstr("x1 < x0"));
  EXPECT_THAT(ErrorOf(With("0.06 -0.01", "1e200 -0.01")), HasSubstr("more than 100 m away"));
  EXPECT_THAT(ErrorOf(With(":obj_of_interest", ":colour")),
              HasSubstr("task.bddl:10: unknown section ':colour'"));
  EXPECT_THAT(ErrorOf(With("plate_1 - plate)", "plate_1 -)")),
              HasSubstr("task.bddl:9: '-' without a category"));
  EXPECT_THAT(ErrorOf(With("plate_1 - plate)", "plate_1)")),
              HasSubstr("'plate_1' without '- category'"));
  EXPECT_THAT(ErrorOf(With("plate_1 - plate)", "akita_black_bowl_1 - plate)")),
              HasSubstr("'akita_black_bowl_1' is declared twice"));
  EXPECT_THAT(ErrorOf(With("(And", "(Or")), HasSubstr("task.bddl:12: goal connective 'or'"));
  EXPECT_THAT(ErrorOf(With("(And", "(And (Not (Open a))")),
              HasSubstr("task.bddl:12: goal connective 'not'; a goal is one 'and' of predicates"));
  EXPECT_THAT(ErrorOf(" ; a remark\n"), HasSubstr("task.bddl:2: nothing in it"));
  EXPECT_THAT(ErrorOf(With(":obj_of_interest", ":objects")),
              HasSubstr("task.bddl:10: a second (:objects ...); the first is in line 9"));
  EXPECT_THAT(ErrorOf(With(":obj_of_interest",
                           "\xD6"
                           "ffne")),
              HasSubstr("task.bddl:10: a word that is not UTF-8"));
  EXPECT_THAT(ErrorOf(With("robosuite", "igibson")), HasSubstr("domain 'igibson'"));
  EXPECT_THAT(ErrorOf(With("(top_region (:target wooden_cabinet_1))",
                           "(plate_region (:target main_table))")),
              HasSubstr("task.bddl:6: region 'main_table_plate_region' is defined in line 5"));
  EXPECT_THAT(ErrorOf(std::string(kProblem) + ")"), HasSubstr("after the closing parenthesis"));
  EXPECT_THAT(ErrorOf(std::string(kProblem).substr(0, 200)), HasSubstr("a ')' is missing"));
  EXPECT_THAT(ErrorOf(""), HasSubstr("task.bddl:1"));
  EXPECT_THAT(ErrorOf(std::string(1000, '(')), HasSubstr("task.bddl:1: lists nest deeper than 32"));
  EXPECT_THAT(ErrorOf(std::string(100000, '(')),
              HasSubstr("task.bddl: 100000 bytes, a BDDL file has at most 65536"));
}

TEST(BddlTest, WhatLiberoSkipsWithoutAWordIsDoubtful) {
  const auto doubts = [](const std::string& init) {
    const std::string all = "(On wooden_cabinet_1 main_table_top_region) " + init;
    return DoubtsOf(*ParseBddl("task.bddl", With("(On plate_1 main_table_plate_region)", all)));
  };
  const std::string named = "'main_table_top_region' is neither an object nor a region";
  EXPECT_THAT(doubts("(On plate_1 main_table_plate_region)"),
              ElementsAre(AllOf(HasSubstr("task.bddl:11: "), HasSubstr(named))));
  EXPECT_THAT(doubts("(Onto plate_1 main_table_plate_region)"),
              Contains(HasSubstr("'onto' is skipped, it is none of close, in, on, open")));
  EXPECT_THAT(
      DoubtsOf(*ParseBddl("task.bddl", With("(On plate_1 main_table_plate_region)",
                                            "(On wooden_cabinet_1 main_table_plate_region)"))),
      IsEmpty());
  EXPECT_THAT(DoubtsOf(*ParseBddl("turn_on_the_stove.bddl",
                                  With("  (:language Put the bowl on the plate)\n", ""))),
              ElementsAre(HasSubstr("the policy is told the file's name, 'turn on the stove'")));
}

TEST(BddlTest, AFixtureIsPlacedOnce) {
  const auto placed = [](const std::string& init) {
    const auto problem = ParseBddl("task.bddl", With("(On plate_1 main_table_plate_region)", init));
    return std::string(CheckFixturesPlaced(*problem, *FindProblemClass(problem->name)).message());
  };
  const std::string once = "(On wooden_cabinet_1 main_table_plate_region)";
  EXPECT_EQ(placed(once), "");
  EXPECT_THAT(placed("(On wooden_cabinet_1 main_table_plaet_region)"),
              AllOf(HasSubstr("task.bddl:8: fixture 'wooden_cabinet_1' is placed by no"),
                    HasSubstr("world's origin; add the line, or correct the region's name")));
  EXPECT_THAT(placed("(On wooden_cabinet_1 wooden_cabinet_1_top_region)"),
              HasSubstr("is placed by no"));
  EXPECT_THAT(
      placed(once + "\n" + once),
      HasSubstr("task.bddl:12: fixture 'wooden_cabinet_1' is placed a second time, line 11"));
}

TEST(BddlTest, AnEditorsMarkAtTheBeginningIsNoPartOfIt) {
  const std::string file = ::testing::TempDir() + "/marked.bddl";
  ASSERT_TRUE(WriteFileAtomically(file, absl::StrCat("\xEF\xBB\xBF", kProblem)).ok());
  const absl::StatusOr<BddlProblem> problem = ReadBddl(file);
  ASSERT_TRUE(problem.ok()) << problem.status();
  EXPECT_EQ(problem->objects.size(), 2u);
}

TEST(BddlTest, SurvivesDamagedFiles) {
  RandomStream random(StreamKey("bddl damage"));
  int parsed = 0;
  for (int i = 0; i < 3000; ++i) {
    std::string text = kProblem;
    for (int k = 0; k < 1 + i % 5; ++k) {
      const int at = random.UniformInt(static_cast<int>(text.size()));
      if (random.UniformInt(2) == 0) {
        text.erase(at, random.UniformInt(8));
      } else {
        text[at] = "()-:; \n\0x9"[random.UniformInt(10)];
      }
    }
    parsed += ParseBddl("task.bddl", text).ok();
  }
  EXPECT_GT(parsed, 0);  // damage in a name leaves a valid file
  EXPECT_LT(parsed, 3000);
}

TEST(BddlTest, ReadsEveryTaskOfTheFourSuites) {
  SKIP_WITHOUT_SHARED_DATA();
  int files = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(LiberoTree() + "/libero/libero/bddl_files")) {
    if (entry.path().extension() != ".bddl") continue;
    const absl::StatusOr<BddlProblem> problem = ReadBddl(entry.path());
    ASSERT_TRUE(problem.ok()) << problem.status();
    EXPECT_THAT(DoubtsOf(*problem), IsEmpty());
    ++files;
  }
  EXPECT_EQ(files, 40);
}

}  // namespace
}  // namespace robostress::libero
