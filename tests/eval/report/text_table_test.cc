#include "eval/report/text_table.h"

#include <gtest/gtest.h>

namespace robostress {
namespace {

// A name of somebody else's in a cell.
const TextRows kRows = {{"Scenario", "n"}, {"a|b\n| c\\|", "2"}};

TEST(TextTable, ARowStaysOneLine) {
  EXPECT_EQ(AlignedTable(kRows),
            "  Scenario    n\n"
            "  a|b | c\\|   2\n");
}

TEST(TextTable, AMarkdownCellStaysOneCell) {
  EXPECT_EQ(MarkdownTable(kRows),
            "| Scenario | n |\n"
            "|---|---:|\n"
            "| a\\|b \\| c\\\\\\| | 2 |\n");
}

}  // namespace
}  // namespace robostress
