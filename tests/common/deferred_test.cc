#include "common/deferred.h"

#include <gtest/gtest.h>

#include <vector>

namespace robostress {
namespace {

struct Later;
// Made, copied and dropped where the type is not complete.
struct Carrier {
  Deferred<Later> held;
};
std::vector<Carrier> TwoNew() { return std::vector<Carrier>(2); }

struct Later {
  int value = 7;
};

TEST(Deferred, ANewOneIsADefaultAndCopiesAreIndependent) {
  std::vector<Carrier> carriers = TwoNew();
  EXPECT_EQ(carriers[0].held->value, 7);
  carriers[0].held = Later{3};
  carriers[1] = carriers[0];
  carriers[1].held.Edit().value = 5;
  EXPECT_EQ(carriers[0].held->value, 3);
  EXPECT_EQ((*carriers[1].held).value, 5);
  EXPECT_EQ(TwoNew()[0].held->value, 7);
}

}  // namespace
}  // namespace robostress
