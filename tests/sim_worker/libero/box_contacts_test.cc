#include "sim_worker/libero/box_contacts.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/panda_sim.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

// A board 2 m wide with its top at z = 0, and a book of 0.2 m that stands on it, 0.1 mm deep.
constexpr char kBoxes[] =
    "<mujoco><worldbody><geom type='box' size='1 1 0.1' pos='0 0 -0.1'/>"
    "<body pos='0.3 0 0.0999'><freejoint/><geom type='box' size='0.02 0.1 0.1'/></body>"
    "</worldbody></mujoco>";

mjContact ContactOf(double dist, double x, double y, double z) {
  mjContact contact = {};
  contact.dist = dist;
  contact.frame[0] = x;
  contact.frame[1] = y;
  contact.frame[2] = z;
  return contact;
}

TEST(BoxContacts, WhatIsDeeperThanTheShadowsOverlapIsLeftOut) {
  const auto model = CompileModel("boxes", kBoxes);
  ASSERT_TRUE(model.ok()) << model.status();
  mjData* data = mj_makeData(model->get());
  mj_kinematics(model->get(), data);
  std::vector<mjContact> contacts = {
      ContactOf(-1e-4, 0, 0, 1),    // the real one
      ContactOf(-2.0001, 0, 0, 1),  // as deep as the board is wide
      ContactOf(-0.5, 1, 0, 0),     // along x they overlap by 0.04 + 0.7 m
      ContactOf(-0.9, 1, 0, 0),     // and not by more
      ContactOf(std::nan(""), 0, 0, 1), ContactOf(-INFINITY, 0, 0, 1),
      ContactOf(0.001, 0, 0, -1),      // apart, within a margin
      ContactOf(-1.005e-4, 0, 0, 1)};  // rounding is not held against it
  const int kept =
      KeepPossible(**model, *data, 0, 1, contacts.data(), static_cast<int>(contacts.size()));
  mj_deleteData(data);
  ASSERT_EQ(kept, 4);
  EXPECT_EQ(contacts[0].dist, -1e-4);
  EXPECT_EQ(contacts[1].dist, -0.5);
  EXPECT_EQ(contacts[2].dist, 0.001);
  EXPECT_EQ(contacts[3].dist, -1.005e-4);
}

// MuJoCo 2.2.2 threw this book 20 cm into the air at the arm's first motion, and lost state 3 to
// numbers that are none.
TEST(BoxContacts, TheBookOfTheStudyStaysWhereItStands) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit;
  unit.suite = "libero_10";
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  const auto task = LiberoSimTask::Create(unit, 5);
  ASSERT_TRUE(task.ok()) << task.status();
  const int book = (*task)->scene().objects.at("black_book_1").body;
  const auto expert = MakeExpertPolicy(**task);
  ASSERT_TRUE(expert.ok()) << expert.status();
  for (const int state : {3, 40}) {
    ASSERT_TRUE((*task)->Reset(state).ok());
    const mjData& data = std::as_const((*task)->sim()).data();
    const double x = data.xpos[3 * book], z = data.xpos[3 * book + 2];
    for (int step = 0; step < 10; ++step) {
      const auto chunk = (*expert)->Predict({}, step);
      const absl::Status stepped = (*task)->Step(chunk->actions.row(0).transpose());
      ASSERT_TRUE(stepped.ok()) << "state " << state << ": " << stepped;
    }
    EXPECT_NEAR(data.xpos[3 * book], x, 1e-3) << "state " << state;
    EXPECT_NEAR(data.xpos[3 * book + 2], z, 1e-3) << "state " << state;
  }
}

}  // namespace
}  // namespace robostress::libero
