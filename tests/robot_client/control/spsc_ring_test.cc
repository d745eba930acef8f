#include "robot_client/control/spsc_ring.h"

#include <gtest/gtest.h>

#include <thread>

namespace robostress {
namespace {

TEST(SpscRingTest, RefusesWhenItIsFullAndKeepsTheOrder) {
  SpscRing<int> ring(3);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(ring.Push(i));
  EXPECT_FALSE(ring.Push(3));
  int value = -1;
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(ring.Pop(value));
    EXPECT_EQ(value, i);
    EXPECT_TRUE(ring.Push(10 + i));
  }
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(ring.Pop(value));
    EXPECT_EQ(value, 10 + i);
  }
  EXPECT_FALSE(ring.Pop(value));
}

TEST(SpscRingTest, PassesWholeValuesFromThreadToThread) {
  struct Value {
    uint64_t number = 0, copies[15] = {};
  };
  SpscRing<Value> ring(8);
  constexpr uint64_t kValues = 20000;
  std::thread sender([&ring] {
    for (uint64_t i = 1; i <= kValues;) {
      Value value;
      value.number = i;
      for (uint64_t& copy : value.copies) copy = i;
      if (ring.Push(value)) ++i;
    }
  });
  for (uint64_t expected = 1; expected <= kValues;) {
    Value value;
    if (!ring.Pop(value)) continue;
    EXPECT_EQ(value.number, expected);
    for (const uint64_t copy : value.copies) ASSERT_EQ(copy, expected);
    ++expected;
  }
  sender.join();
}

}  // namespace
}  // namespace robostress
