#include "common/suites.h"

#include <cmath>
#include <set>

#include "common/joint_errors/joint_chain.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sim_worker/suites/embedded_task.h"
#include "sim_worker/suites/goals.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

const char* const kSuites[] = {"tabletop_spatial", "tabletop_object", "tabletop_goal",
                               "tabletop_long"};

std::unique_ptr<EmbeddedTask> MakeTask(const std::string& suite, int task) {
  UnitConfig unit;
  unit.suite = suite;
  absl::StatusOr<std::unique_ptr<EmbeddedTask>> made = EmbeddedTask::Create(unit, task);
  EXPECT_TRUE(made.ok()) << made.status();
  return std::move(made).value();
}

int PropIndex(const EmbeddedTask& task, const std::string& name) {
  const auto& props = task.model().suite().scenes[task.model().task().scene].props;
  for (size_t i = 0; i < props.size(); ++i) {
    if (props[i].name == name) return static_cast<int>(i);
  }
  ADD_FAILURE() << "no prop " << name;
  return 0;
}

// The task's first state with one prop moved; settled.
void PlaceAt(EmbeddedTask& task, const std::string& prop, const Eigen::Vector3d& position) {
  InitialState state = SampleInitialState(task.model().suite(), task.model().task_index(), 0);
  state.positions[PropIndex(task, prop)] = position;
  ASSERT_TRUE(task.ResetTo(state).ok());
}

void SetJoint(EmbeddedTask& task, const std::string& joint, double position) {
  mjData& data = task.sim().mutable_data();
  const int id = mj_name2id(&task.sim().model(), mjOBJ_JOINT, joint.c_str());
  ASSERT_GE(id, 0);
  data.qpos[task.sim().model().jnt_qposadr[id]] = position;
}

TEST(Suites, HaveTenTasksWithInstructionsThatDiffer) {
  for (const char* name : kSuites) {
    const SuiteSpec* suite = FindSuiteSpec(name);
    ASSERT_NE(suite, nullptr);
    ASSERT_NE(FindSuite(name), nullptr);
    EXPECT_EQ(static_cast<int>(suite->tasks.size()), FindSuite(name)->num_tasks);
    std::set<std::string> instructions;
    for (const TaskSpec& task : suite->tasks) instructions.insert(task.instruction);
    EXPECT_EQ(instructions.size(), suite->tasks.size()) << name;
  }
}

TEST(Suites, EverySceneServesSeveralTasksSoThatTheInstructionDecides) {
  for (const char* name : kSuites) {
    const SuiteSpec& suite = *FindSuiteSpec(name);
    std::vector<int> uses(suite.scenes.size());
    for (const TaskSpec& task : suite.tasks) ++uses[task.scene];
    for (int n : uses) EXPECT_GE(n, 2) << name;
  }
}

TEST(Suites, NoTaskIsSolvedAtTheStart) {
  for (const char* name : kSuites) {
    for (int i = 0; i < 10; ++i) {
      const auto task = MakeTask(name, i);
      ASSERT_TRUE(task->Reset(0).ok());
      EXPECT_FALSE(task->Success()) << name << " " << i;
      EXPECT_EQ(task->horizon(), FindSuite(name)->horizon);
    }
  }
}

TEST(Suites, OnlyWhatTheTaskMovesHasJoints) {
  EXPECT_EQ(MakeTask("tabletop_object", 0)->sim().model().nv, 9 + 6);
  EXPECT_EQ(MakeTask("tabletop_spatial", 0)->sim().model().nv, 9 + 6 + 1);  // the cabinet's drawer
  EXPECT_EQ(MakeTask("tabletop_long", 0)->sim().model().nv, 9 + 12);
}

TEST(Suites, UnknownNamesAreRefusedWithTheKnownOnes) {
  UnitConfig unit;
  unit.suite = "tabletop_nothing";
  EXPECT_THAT(MakeSimTask(unit, 0).status().message(), HasSubstr("tabletop_spatial"));
  unit.suite = "tabletop_goal";
  EXPECT_THAT(MakeSimTask(unit, 10).status().message(), HasSubstr("task 10"));
  EXPECT_THAT(MakeSimTask(unit, -1).status().message(), HasSubstr("task -1"));
  unit.scenario = "rainy";
  EXPECT_FALSE(MakeSimTask(unit, 0).ok());
  EXPECT_THAT(MakeTask("tabletop_goal", 0)->Reset(50).message(), HasSubstr("initial state 50"));
  EXPECT_FALSE(MakeTask("tabletop_goal", 0)->Reset(-1).ok());
}

TEST(InitialStates, DependOnTheIndexOnly) {
  const SuiteSpec& suite = *FindSuiteSpec("tabletop_goal");
  const InitialState first = SampleInitialState(suite, 3, 7);
  SampleInitialState(suite, 3, 8);
  const InitialState again = SampleInitialState(suite, 3, 7);
  EXPECT_EQ(first.q, again.q);
  for (size_t i = 0; i < first.positions.size(); ++i)
    EXPECT_EQ(first.positions[i], again.positions[i]);
}

TEST(InitialStates, AllDiffer) {
  const SuiteSpec& suite = *FindSuiteSpec("tabletop_goal");
  std::set<double> seen;
  for (int task = 0; task < 10; ++task) {
    for (int i = 0; i < 50; ++i) seen.insert(SampleInitialState(suite, task, i).q[0]);
    for (int i = 0; i < 50; ++i)
      seen.insert(SampleInitialState(suite, task, kFirstTrainingDraw + i).q[0]);
  }
  EXPECT_EQ(seen.size(), 1000u);
}

TEST(InitialStates, KeepGraspableThingsApart) {
  for (const char* name : kSuites) {
    const SuiteSpec& suite = *FindSuiteSpec(name);
    for (int task = 0; task < 10; ++task) {
      const auto& props = suite.scenes[suite.tasks[task].scene].props;
      for (int index = 0; index < 50; ++index) {
        const InitialState state = SampleInitialState(suite, task, index);
        for (size_t a = 0; a < props.size(); ++a) {
          for (size_t b = 0; b < props.size(); ++b) {
            if (a == b || !ShapeOf(props[a].kind).graspable ||
                (props[a].on_anchor && props[a].anchor == props[b].name))
              continue;
            const double gap = (state.positions[a] - state.positions[b]).head<2>().norm() -
                               ShapeOf(props[a].kind).radius - ShapeOf(props[b].kind).radius;
            EXPECT_GT(gap, 0.01) << name << " task " << task << " state " << index << ": "
                                 << props[a].name << ", " << props[b].name;
          }
        }
      }
    }
  }
}

TEST(InitialStates, AreTheSameAfterAnotherEpisode) {
  const auto task = MakeTask("tabletop_goal", 1);
  ASSERT_TRUE(task->Reset(5).ok());
  const Eigen::VectorXf first = task->Proprioception();
  const Eigen::Vector3d pot = task->model().Position(task->sim().data(), "pot");
  for (int i = 0; i < 40; ++i) ASSERT_TRUE(task->Step(task->Decide().command).ok());
  ASSERT_TRUE(task->Reset(5).ok());
  EXPECT_EQ(task->Proprioception(), first);
  EXPECT_EQ(task->model().Position(task->sim().data(), "pot"), pot);
}

TEST(Goals, PlaceNeedsTheObjectOnTheRegion) {
  const auto task = MakeTask("tabletop_goal", 1);  // pot on plate
  const InitialState state = SampleInitialState(task->model().suite(), 1, 0);
  const Eigen::Vector3d plate = state.positions[PropIndex(*task, "plate")];
  PlaceAt(*task, "pot", plate + Eigen::Vector3d(0.02, -0.02, 0.012));
  EXPECT_TRUE(task->Success());
  PlaceAt(*task, "pot", plate + Eigen::Vector3d(0, 0.13, 0.001));
  EXPECT_FALSE(task->Success()) << "beside the plate";
}

TEST(Goals, PlaceNeedsTheSurfaceNotTheAirAboveIt) {
  const auto task = MakeTask("tabletop_goal", 1);
  InitialState state = SampleInitialState(task->model().suite(), 1, 0);
  state.positions[PropIndex(*task, "pot")] =
      state.positions[PropIndex(*task, "plate")] + Eigen::Vector3d(0, 0, 0.2);
  ASSERT_TRUE(task->sim().Reset(task->model().Qpos(state), EmbeddedHome()).ok());
  task->model().PlaceStaticProps(state, task->sim().mutable_data());
  mj_forward(&task->sim().model(), &task->sim().mutable_data());
  EXPECT_FALSE(task->Success());
}

TEST(Goals, PlaceNeedsAnObjectThatStandsWithinTheRegion) {
  const auto task = MakeTask("tabletop_goal", 1);
  const InitialState state = SampleInitialState(task->model().suite(), 1, 0);
  PlaceAt(*task, "pot", state.positions[PropIndex(*task, "plate")] + Eigen::Vector3d(0, 0, 0.012));
  ASSERT_TRUE(task->Success());
  mjData& data = task->sim().mutable_data();
  const mjModel& model = task->sim().model();
  const int joint = model.body_jntadr[task->model().BodyId("pot")];
  double* pose = data.qpos + model.jnt_qposadr[joint];
  const double x = pose[0], y = pose[1];
  const Goal& goal = task->model().task().goals[0];
  const Region& region = task->model().RegionOf(goal);
  const Eigen::Vector3d centre = task->model().RegionCenter(data, goal);
  for (const double share : {0.95, 1.05}) {
    pose[0] = centre.x() + share * region.half.x();
    pose[1] = centre.y();
    mj_forward(&model, &data);
    EXPECT_EQ(task->Success(), share < 1) << share;
  }
  pose[0] = x;
  pose[1] = y;
  pose[3] = pose[4] = std::sqrt(0.5);  // on its side, about where it stood
  mj_forward(&model, &data);
  EXPECT_FALSE(task->Success());
}

TEST(Goals, AnotherDestinationDoesNotCount) {
  const auto task = MakeTask("tabletop_goal", 7);  // pot on stove
  const InitialState state = SampleInitialState(task->model().suite(), 7, 0);
  PlaceAt(*task, "pot", state.positions[PropIndex(*task, "plate")] + Eigen::Vector3d(0, 0, 0.012));
  EXPECT_FALSE(task->Success());
  PlaceAt(*task, "pot", state.positions[PropIndex(*task, "stove")] + Eigen::Vector3d(0, 0, 0.021));
  EXPECT_TRUE(task->Success());
}

TEST(Goals, OpenAndTurnOnFollowTheJoint) {
  const auto drawer = MakeTask("tabletop_goal", 0);
  ASSERT_TRUE(drawer->Reset(0).ok());
  SetJoint(*drawer, "cabinet_slide", 0.05);
  EXPECT_FALSE(drawer->Success());
  SetJoint(*drawer, "cabinet_slide", 0.09);
  EXPECT_TRUE(drawer->Success());
  const auto knob = MakeTask("tabletop_goal", 4);
  ASSERT_TRUE(knob->Reset(0).ok());
  SetJoint(*knob, "stove_hinge", 0.5);
  EXPECT_FALSE(knob->Success());
  SetJoint(*knob, "stove_hinge", 1.2);
  EXPECT_TRUE(knob->Success());
}

TEST(Goals, PushFollowsThePlate) {
  const auto task = MakeTask("tabletop_goal", 5);
  const InitialState state = SampleInitialState(task->model().suite(), 5, 0);
  PlaceAt(*task, "plate",
          state.positions[PropIndex(*task, "mat")] + Eigen::Vector3d(0.01, 0.03, 0));
  EXPECT_TRUE(task->Success());
  PlaceAt(*task, "plate", state.positions[PropIndex(*task, "mat")] + Eigen::Vector3d(0.0, 0.07, 0));
  EXPECT_FALSE(task->Success());
}

TEST(Goals, LongTasksNeedBothGoals) {
  const auto task = MakeTask("tabletop_long", 5);  // drawer, cube in it
  ASSERT_TRUE(task->Reset(0).ok());
  SetJoint(*task, "cabinet_slide", 0.09);
  EXPECT_FALSE(task->Success());
  EXPECT_EQ(FirstOpenGoal(task->model(), task->sim()), 1);
}

TEST(Observation, HasTheViewsThatThePolicyWants) {
  const auto task = MakeTask("tabletop_spatial", 0);
  ASSERT_TRUE(task->Reset(0).ok());
  PolicySpec spec;
  absl::StatusOr<Observation> blind = task->Observe(spec);
  ASSERT_TRUE(blind.ok());
  EXPECT_TRUE(blind->views.empty());
  spec.cameras = {"agentview", "robot0_eye_in_hand"};
  spec.image_width = spec.image_height = 64;
  absl::StatusOr<Observation> seen = task->Observe(spec);
  if (absl::IsUnavailable(seen.status())) GTEST_SKIP() << seen.status().message();
  ASSERT_TRUE(seen.ok()) << seen.status();
  ASSERT_EQ(seen->views.size(), 2u);
  EXPECT_EQ(seen->views[1].camera, "robot0_eye_in_hand");
  EXPECT_EQ(seen->views[0].image.width, 64);
  EXPECT_EQ(seen->views[0].image.data.size(), 64u * 64 * 3);
  EXPECT_EQ(seen->instruction, task->instruction());
  absl::StatusOr<Observation> again = task->Observe(spec);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->views[0].image.data, seen->views[0].image.data);
  spec.cameras = {"ceiling"};
  EXPECT_THAT(task->Observe(spec).status().message(), HasSubstr("ceiling"));
}

TEST(Observation, ProprioceptionIsNearZeroRotationAtTheStart) {
  const auto task = MakeTask("tabletop_object", 2);
  ASSERT_TRUE(task->Reset(3).ok());
  const Eigen::VectorXf state = task->Proprioception();
  ASSERT_EQ(state.size(), 8);
  EXPECT_NEAR(state[0], 0.5, 0.06);
  EXPECT_NEAR(state[2], 0.24, 0.06);
  EXPECT_LT(state.segment<3>(3).norm(), 0.15);
  EXPECT_GT(state[6], 0.03);
  EXPECT_LT(state[7], -0.03);
}

TEST(Observation, TasksOfASceneLookAlike) {
  // The same initial state shown by two tasks of a scene gives the same picture, although other
  // props have joints.
  const auto a = MakeTask("tabletop_goal", 1), b = MakeTask("tabletop_goal", 3);
  const InitialState state = SampleInitialState(a->model().suite(), 1, 0);
  ASSERT_TRUE(a->ResetTo(state).ok());
  ASSERT_TRUE(b->ResetTo(state).ok());
  absl::StatusOr<Image> image_a = a->RenderView("agentview", 64, 64),
                        image_b = b->RenderView("agentview", 64, 64);
  if (absl::IsUnavailable(image_a.status())) GTEST_SKIP() << image_a.status().message();
  ASSERT_TRUE(image_a.ok() && image_b.ok());
  int different = 0;
  for (size_t i = 0; i < image_a->data.size(); ++i)
    different += std::abs(image_a->data[i] - image_b->data[i]) > 12;
  EXPECT_LT(different, 60) << "of " << image_a->data.size();
}

TEST(EmbeddedTask, ARampRunsOverTheSuitesHorizon) {
  // The k-th control step is at progress (k - 1) / horizon; friction ramps from 1.5 to 2.
  UnitConfig unit;
  unit.suite = "tabletop_goal";
  unit.scenario = "thermal_drift_stribeck";
  unit.severity = 5;
  auto made = EmbeddedTask::Create(unit, 0);
  ASSERT_TRUE(made.ok()) << made.status();
  EmbeddedTask& task = **made;
  ASSERT_TRUE(task.Reset(0).ok());
  constexpr int kSteps = 21;
  for (int i = 0; i < kSteps; ++i) ASSERT_TRUE(task.sim().Step(Eigen::VectorXf::Zero(7)).ok());
  const double progress = (kSteps - 1.0) / FindSuite(unit.suite)->horizon;
  for (const SeverityFactors& factors : task.sim().joint_chain().severity().factors())
    EXPECT_NEAR(factors.friction, 1.5 + 0.5 * progress, 1e-12);
}

TEST(EmbeddedTask, SettlesForTheUnitsSteps) {
  UnitConfig unit;
  unit.suite = "tabletop_goal";
  unit.sim.settle_steps = 7;
  auto made = EmbeddedTask::Create(unit, 0);
  ASSERT_TRUE(made.ok()) << made.status();
  ASSERT_TRUE((*made)->Reset(0).ok());
  EXPECT_NEAR((*made)->sim().data().time, 7 * 0.05, 0.003);
  EXPECT_EQ((*made)->sim().steps_taken(), 0);
}

TEST(EmbeddedTask, StatesBetweenTheReproducibleOnesAndTheDrawsDoNotExist) {
  const auto task = MakeTask("tabletop_goal", 0);
  const int states = FindSuite("tabletop_goal")->num_initial_states;
  EXPECT_TRUE(task->Reset(states - 1).ok());
  EXPECT_FALSE(task->Reset(states).ok());
  EXPECT_FALSE(task->Reset(kFirstTrainingDraw - 1).ok());
  EXPECT_TRUE(task->Reset(kFirstTrainingDraw).ok());
}

}  // namespace
}  // namespace robostress
