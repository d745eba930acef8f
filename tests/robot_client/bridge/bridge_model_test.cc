// What a model of its mechanics keeps an arm behind the bridge from, in simulated time.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <memory>

#include "robot_client/bridge/chain_model.h"
#include "tests/robot_client/bridge/scripted_driver.h"

namespace robostress::bridge {
namespace {

using ::testing::HasSubstr;

BridgeRobot Modelled(double table_z) {
  BridgeRobot robot = *LoadBridgeRobot("tests/robot_client/bridge/seven_modelled.yaml");
  robot.workspace.table_z = table_z;
  EXPECT_TRUE(ChooseWatched(robot.workspace, robot.home, robot).ok());
  return robot;
}

// An arm whose file names a model.
struct ModelledWorld : BridgeWorld {
  explicit ModelledWorld(double table_z = 0.05)
      : BridgeWorld(Modelled(table_z)), workspace(robot.workspace) {
    model = std::make_unique<ChainModel>(*robot.chain, workspace);
    driver->welcome["measures_effort"] = true;
    driver->model = model.get();
    driver->position = driver->target = {0, 0.2, 0, -2.3, 0, 2.5, 0.8, 0.02};
  }
  void OpenModelled() {
    ControlOptions options;
    options.workspace = workspace;
    options.press.excess.clear();
    for (const AxisOptions& joint : robot.joints) options.press.excess.push_back(joint.press);
    Open(options, model.get());
  }
  WorkspaceOptions workspace;
  std::unique_ptr<ChainModel> model;
};

// A policy drives on until it is held; no command crosses `bound`.
void DrivesUntilHeld(ModelledWorld& world, ArmModel::Bound bound) {
  world.OpenModelled();
  world.Tick(kRequestEnable);
  world.Tick(kRequestStart);
  double least = 1;
  for (int i = 0; i < 200 && world.loop->state() == ClientState::kRun; ++i) {
    world.Tick();
    least = std::min(least, world.model->ClearanceAt(world.driver->target)[bound]);
  }
  EXPECT_EQ(world.loop->state(), ClientState::kHold);
  EXPECT_EQ(world.loop->cause(), StateCause::kWorkspace);
  EXPECT_EQ(world.loop->crossed(), bound);
  EXPECT_GE(least, -1e-9) << "no command into it";
  EXPECT_LT(least, 0.03) << "it was wanted there";
  std::printf("HOLD (workspace) %.1f mm before %s\n", 1e3 * least, BoundName(bound));
}

TEST(BridgeModel, APolicyThatLeadsIntoTheTableIsHeldAboveIt) {
  ModelledWorld world;
  world.moved = 1;  // the shoulder bends forwards: the tool goes down
  world.speed = 0.6;
  DrivesUntilHeld(world, ArmModel::kTable);
  EXPECT_GE(world.model->ToolAt(world.driver->target).z(), 0.05 - 1e-9);
  EXPECT_LT(world.model->ToolAt(world.driver->target).z(), 0.08);
}

TEST(BridgeModel, APolicyThatFoldsTheHandIntoTheUpperArmIsHeldBefore) {
  ModelledWorld world(-0.5);
  world.moved = 3;
  world.speed = -0.6;
  world.driver->position[5] = world.driver->target[5] = 0.6;  // the hand is turned inwards
  DrivesUntilHeld(world, ArmModel::kItself);
}

TEST(BridgeModel, TorqueBeyondTheModelIsPressing) {
  ModelledWorld world(-0.5);
  world.moved = 6;
  world.OpenModelled();
  world.Run();
  EXPECT_LT(std::abs(world.loop->last_record().excess[1]), 0.5) << "gravity is explained";
  EXPECT_GT(std::abs(world.loop->last_record().effort[1]), 5) << "and there is some";
  world.driver->push[3] = 7;  // 5 Nm are allowed
  const double seconds = world.SecondsUntilLeft(ClientState::kRun);
  EXPECT_EQ(world.loop->state(), ClientState::kHold);
  EXPECT_EQ(world.loop->cause(), StateCause::kPressing);
  EXPECT_LE(seconds, 0.17);
  std::printf("pressing with 7 Nm on J4: HOLD (pressing) after %.3f s\n", seconds);
}

TEST(BridgeModel, WhatIsNotWatchedIsSaid) {
  ModelledWorld high(0.32);
  ASSERT_TRUE(high.Connected().ok());
  EXPECT_THAT(high.arm->Warnings(),
              ::testing::Contains("not watched against the table, below it in nearly all poses: "
                                  "all of J2"));
  BridgeRobot robot = Modelled(0);
  robot.chain->held = {"wrist_joint"};
  BridgeWorld held(robot);
  held.driver->welcome["measures_effort"] = true;
  ASSERT_TRUE(held.Connected().ok());
  EXPECT_THAT(held.arm->Warnings(),
              ::testing::Contains(HasSubstr("not driven, and at 0 in the model, on the way to the "
                                            "tool: wrist_joint")));
}

TEST(BridgeModel, TorquesAreNotJudgedWhereTheFileDoesNotSayWhatPresses) {
  BridgeRobot robot = *LoadBridgeRobot("tests/robot_client/bridge/seven_modelled.yaml");
  robot.driver.measures_effort = false;
  BridgeWorld world(robot);
  world.driver->welcome["measures_effort"] = true;
  ASSERT_TRUE(world.Connected().ok());
  EXPECT_FALSE(world.arm->Latest().has_effort);
  EXPECT_THAT(world.arm->Warnings(), ::testing::Contains(HasSubstr("torques are not watched")));
  ModelledWorld modelled;
  ASSERT_TRUE(modelled.Connected().ok());
  EXPECT_TRUE(modelled.arm->Latest().has_effort);
  EXPECT_THAT(modelled.arm->Warnings(), ::testing::Contains(::testing::AllOf(
                                            HasSubstr("seven_joints.urdf: table, box, the arm"),
                                            HasSubstr("against itself, torques"))));
}

}  // namespace
}  // namespace robostress::bridge
