#include "common/csv_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

absl::StatusOr<CsvTable> Table(const std::string& text) {
  const std::string path = ::testing::TempDir() + "/table.csv";
  EXPECT_TRUE(WriteFileAtomically(path, text).ok());
  return CsvTable::Read(path);
}

TEST(CsvTableTest, ReadsColumnsByName) {
  const auto table = Table("t, q\r\n0,1e-3\r\n0.5, -2 \n");
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_EQ(table->rows(), 2u);
  EXPECT_THAT(*table->Numbers("q"), ElementsAre(1e-3, -2));
  EXPECT_TRUE(table->Has("t"));
  EXPECT_FALSE(table->Has("dq"));
  EXPECT_THAT(std::string(table->Numbers("dq").status().message()),
              HasSubstr("has no column 'dq'; its columns are t, q"));
}

TEST(CsvTableTest, PassesOverTheByteOrderMarkOfASpreadsheet) {
  const auto table = Table("\xEF\xBB\xBFt,q\r\n0,1\r\n");
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_THAT(table->names(), ElementsAre("t", "q"));
}

TEST(CsvTableTest, PassesOverALastLineThatADiskCutShortAndNoOther) {
  const auto table = Table("t,q\n0,1\n1,2\n2");
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_EQ(table->rows(), 2u);
  EXPECT_THAT(std::string(Table("t,q\n0\n1,2\n").status().message()),
              HasSubstr("table.csv:2: has 1 columns, not 2"));
  EXPECT_THAT(std::string(Table("t,q\n0,1,2\n").status().message()), HasSubstr("has 3 columns"));
}

TEST(CsvTableTest, RefusesAShortLastLineWhereEveryRowCounts) {
  const std::string path = ::testing::TempDir() + "/table.csv";
  ASSERT_TRUE(WriteFileAtomically(path, "t,q\n0,1\n2\n").ok());
  EXPECT_THAT(
      std::string(CsvTable::Read(path, 1000, CsvTable::ShortLastLine::kError).status().message()),
      HasSubstr("table.csv:3: has 1 columns, not 2"));
}

TEST(CsvTableTest, RefusesANameThatStandsTwice) {
  EXPECT_THAT(std::string(Table("t,q,t\n0,1,2\n").status().message()),
              HasSubstr("column 't' stands twice"));
}

TEST(CsvTableTest, CountsEmptyLinesAndOutlivesAMove) {
  auto table = Table("t,q\n\n0,1\n\n1,x\n");
  ASSERT_TRUE(table.ok()) << table.status();
  const CsvTable moved = *std::move(table);
  EXPECT_EQ(moved.rows(), 2u);
  EXPECT_EQ(moved.Text(1, 1), "x");
  EXPECT_THAT(moved.Place(0), HasSubstr("table.csv:3"));
  EXPECT_THAT(std::string(moved.Numbers("q").status().message()),
              HasSubstr("table.csv:5: q is 'x'"));
}

TEST(CsvTableTest, NamesLineColumnAndValueOfWhatIsNoNumber) {
  for (const char* value : {"x", "", "nan", "inf", "1e999", "1 2"}) {
    const auto table = Table(std::string("t,q\n0,1\n1,") + value + "\n2,3\n");
    ASSERT_TRUE(table.ok()) << table.status();
    EXPECT_THAT(std::string(table->Numbers("q").status().message()),
                HasSubstr(std::string("table.csv:3: q is '") + value + "'"));
  }
}

}  // namespace
}  // namespace robostress
