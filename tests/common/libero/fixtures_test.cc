#include "common/libero/fixtures.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using Source = LiberoFixtures::Source;

TEST(LiberoFixturesTest, KnownNames) {
  EXPECT_EQ(ParseLiberoFixtures("centred")->source, Source::kCentred);
  EXPECT_EQ(ParseLiberoFixtures("sampled")->source, Source::kSampled);
  EXPECT_EQ(ParseLiberoFixtures("numpy")->source, Source::kNumpy);
  EXPECT_EQ(ParseLiberoFixtures("numpy")->seed, 7u) << "openpi's evaluation";
  EXPECT_EQ(ParseLiberoFixtures("numpy:4294967295")->seed, 4294967295u);
  EXPECT_FALSE(ParseLiberoFixtures("numpy:3")->each_seeded);
  EXPECT_TRUE(ParseLiberoFixtures("numpy-each:1000")->each_seeded);
  EXPECT_EQ(ParseLiberoFixtures("numpy-each:1000")->seed, 1000u) << "LeRobot's evaluation";
}

TEST(LiberoFixturesTest, AnythingElseIsAReadableFile) {
  const std::string file = ::testing::TempDir() + "/fixtures.json";
  ASSERT_TRUE(WriteFileAtomically(file, "{}").ok());
  const absl::StatusOr<LiberoFixtures> fixtures = ParseLiberoFixtures(file);
  ASSERT_TRUE(fixtures.ok()) << fixtures.status();
  EXPECT_EQ(fixtures->source, Source::kTable);
  EXPECT_EQ(fixtures->table, file);
}

TEST(LiberoFixturesTest, ATableIsAJsonObject) {
  const std::string file = ::testing::TempDir() + "/no_fixtures.json";
  for (const char* text : {"", "[]", "{\"a\": ", "3"}) {
    ASSERT_TRUE(WriteFileAtomically(file, text).ok());
    EXPECT_THAT(std::string(ParseLiberoFixtures(file).status().message()),
                HasSubstr(file + ": no JSON object; a table is {"))
        << text;
  }
  EXPECT_THAT(std::string(ParseLiberoFixtures(::testing::TempDir()).status().message()),
              HasSubstr("nor a readable file"));
}

TEST(LiberoFixturesTest, ATableIsWhatIsNoneOfTheWordsHoweverItIsCalled) {
  for (const char* word : {"centred", "sampled", "numpy", "numpy:3", "numpy-each:1000", ""})
    EXPECT_FALSE(NamesFixtureTable(word)) << word;
  for (const char* file : {"table", "poses.json", "./numpy", "numpy:x", "sha256 5a5a"})
    EXPECT_TRUE(NamesFixtureTable(file)) << file;
}

TEST(LiberoFixturesTest, AnErrorNamesWhatWasGivenAndWhatIsKnown) {
  for (const char* text : {"centered", "", "numpy:", "numpy:-1", "numpy:4294967296", "numpy-each",
                           "numpy-each:", "/no/file"}) {
    const absl::Status status = ParseLiberoFixtures(text).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << text;
    EXPECT_THAT(std::string(status.message()),
                AllOf(HasSubstr(std::string("'") + text + "'"), HasSubstr("numpy:SEED"),
                      HasSubstr("centred, sampled")));
  }
}

}  // namespace
}  // namespace robostress
