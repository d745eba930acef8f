#include "sim_worker/libero/numpy_random.h"

#include <gtest/gtest.h>

namespace robostress::libero {
namespace {

// The reference values were printed by NumPy 1.24.2 with the command above each test: the
// shortest text that reads back as the same double.

// python3 -c "from numpy.random import *; seed(7); print(uniform(-.06, .02), randn(), randint(1),
//   randint(5), randint(1000), randn(), uniform(3, -2), randint(2**31 - 1))"
TEST(NumpyRandomTest, MixedDrawsEqualNumpys) {
  NumpyRandom random(7);
  EXPECT_EQ(random.Uniform(-0.06, 0.02), -0.05389533685008342);
  EXPECT_EQ(random.Randn(), -0.3206032549443759);
  EXPECT_EQ(random.Randint(1), 0);
  EXPECT_EQ(random.Randint(5), 4);
  EXPECT_EQ(random.Randint(1000), 185);
  EXPECT_EQ(random.Randn(), 1.4570832287334776) << "the value that the first call kept";
  EXPECT_EQ(random.Uniform(3, -2), 0.3075206479478316) << "bounds in the wrong order";
  EXPECT_EQ(random.Randint(2147483647), 4812360);
}

// python3 -c "import numpy as np; np.random.seed(4294967295); print(*np.random.randn(3))"
TEST(NumpyRandomTest, TheLargestSeedIsASeedLikeAnyOther) {
  NumpyRandom random(4294967295);
  EXPECT_EQ(random.Randn(), 0.6484086742306527);
  EXPECT_EQ(random.Randn(), 0.6693235306338161);
  EXPECT_EQ(random.Randn(), -1.0805437227474493);
}

TEST(NumpyRandomTest, AChoiceOfOneDrawsNothing) {
  NumpyRandom a(7), b(7);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(a.Randint(1), 0);
  EXPECT_EQ(a.Random(), b.Random());
}

}  // namespace
}  // namespace robostress::libero
