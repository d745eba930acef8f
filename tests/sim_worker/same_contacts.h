#pragma once

#include <gtest/gtest.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cstring>

namespace robostress {

// mj_collision of the poses in `data`, in another mjData of the same model.
inline void CollideAlike(const mjModel& model, const mjData& data, mjData& other) {
  std::copy_n(data.xpos, 3 * model.nbody, other.xpos);
  std::copy_n(data.xmat, 9 * model.nbody, other.xmat);
  std::copy_n(data.geom_xpos, 3 * model.ngeom, other.geom_xpos);
  std::copy_n(data.geom_xmat, 9 * model.ngeom, other.geom_xmat);
  mj_collision(&model, &other);
}

// What a collision decides, bit for bit: everything but what constraints are made of later.
inline void ExpectSameContacts(const mjData& a, const mjData& b) {
  ASSERT_EQ(a.ncon, b.ncon);
  for (int i = 0; i < a.ncon; ++i) {
    const mjContact &x = a.contact[i], &y = b.contact[i];
    ASSERT_EQ(x.geom1, y.geom1) << i;
    ASSERT_EQ(x.geom2, y.geom2) << i;
    ASSERT_EQ(x.dim, y.dim) << i;
    ASSERT_EQ(x.exclude, y.exclude) << i;
    const auto same = [](const auto& left, const auto& right) {
      return std::memcmp(&left, &right, sizeof(left)) == 0;
    };
    ASSERT_TRUE(same(x.dist, y.dist) && same(x.pos, y.pos) && same(x.frame, y.frame)) << i;
    ASSERT_TRUE(same(x.includemargin, y.includemargin) && same(x.friction, y.friction) &&
                same(x.solref, y.solref) && same(x.solimp, y.solimp))
        << i;
  }
}

}  // namespace robostress
