#include "common/plain_line.h"

#include <gtest/gtest.h>

namespace robostress {
namespace {

TEST(PlainLine, HasNothingThatBreaksALineOrSteersATerminal) {
  for (const char* unplain : {"\n", "\t", "\x1b", "\x7f", "\u0080", "\u009f", "\u2028", "\u2029",
                              "\u202a", "\u202e", "\u2066", "\u2069"}) {
    const std::string text = std::string("a") + unplain + "b";
    EXPECT_FALSE(IsPlainLine(text)) << text;
    EXPECT_EQ(PlainLine(text), "a b");
  }
  EXPECT_FALSE(IsPlainLine(std::string(1, '\0')));
}

TEST(PlainLine, KeepsEveryOtherCharacterAndTornOnes) {
  for (const char* plain : {"", " ~", "Größe", "\u00a0", "\u2027", "\u202f", "\u2065", "\u206a",
                            "日本", "\xc2", "\xe2\x80", "\xe2\x81"}) {
    EXPECT_TRUE(IsPlainLine(plain)) << plain;
    EXPECT_EQ(PlainLine(plain), plain);
  }
}

}  // namespace
}  // namespace robostress
