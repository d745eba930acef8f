#include "sim_worker/libero/libero_task.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/so3.h"
#include "common/suites.h"
#include "sim_worker/libero/demonstration_replay.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/libero/numpy_placement.h"
#include "tests/common/libero/shared_data.h"
#include "tests/sim_worker/same_contacts.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr int kBowlOnPlate = 8;  // of libero_goal

UnitConfig GoalUnit() {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  return unit;
}

std::string ErrorOf(const UnitConfig& unit, int task) {
  const absl::StatusOr<std::unique_ptr<SimTask>> result = MakeLiberoTask(unit, task);
  return result.ok() ? "made" : std::string(result.status().message());
}

// A copy of a tree in which single files can be damaged.
class DamagedTree {
 public:
  explicit DamagedTree(const std::string& source)
      : path_(fs::temp_directory_path() / absl::StrCat("robostress_libero_", getpid())) {
    fs::remove_all(path_);
    fs::copy(source, path_, fs::copy_options::recursive);
    for (const auto& entry : fs::recursive_directory_iterator(path_)) {
      fs::permissions(entry, fs::perms::owner_all, fs::perm_options::add);
    }
    fs::permissions(path_, fs::perms::owner_all, fs::perm_options::add);
  }
  ~DamagedTree() { fs::remove_all(path_); }
  std::string path() const { return path_.string(); }
  void Remove(const std::string& file) { ASSERT_TRUE(fs::remove(path_ / file)) << file; }
  void Write(const std::string& file, const std::string& text) {
    std::ofstream(path_ / file) << text;
  }

 private:
  fs::path path_;
};

// A folder of two of libero_goal's tasks, one with another instruction, one without states.
TEST(LiberoTaskFolder, PlaysTasksWithTheInstructionsOfTheirFiles) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path folder = fs::path(::testing::TempDir()) / "libero_goal_lan";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const std::string root = LiberoTree() + "/libero/libero/", name = "put_the_bowl_on_the_plate";
  const std::string text = *ReadFile(root + "bddl_files/libero_goal/" + name + ".bddl");
  const size_t at = text.find("(:language ") + 11;
  const std::string changed =
      text.substr(0, at) + "set the bowl down" + text.substr(text.find(')', at));
  ASSERT_TRUE(WriteFileAtomically((folder / "b_task.bddl").string(), changed).ok());
  fs::copy_file(root + "init_files/libero_goal/" + name + ".pruned_init",
                folder / "b_task.pruned_init");
  ASSERT_TRUE(WriteFileAtomically((folder / "a_task.bddl").string(), text).ok());

  UnitConfig unit = GoalUnit();
  unit.libero_tasks = folder.string();
  unit.suite = *AddTaskFolder(unit.libero_tasks);
  const auto task = MakeLiberoTask(unit, 1);
  ASSERT_TRUE(task.ok()) << task.status();
  EXPECT_EQ((*task)->name(), "b_task");
  EXPECT_EQ((*task)->instruction(), "set the bowl down");
  EXPECT_EQ((*task)->horizon(), 300);
  EXPECT_TRUE((*task)->Reset(49).ok());
  EXPECT_THAT(std::string((*task)->Reset(50).message()), HasSubstr("has rows 0 to 49"));
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("a_task.bddl: no initial states"));
  EXPECT_THAT(ErrorOf(unit, 2), HasSubstr("task 2 of suite 'libero_goal_lan' does not exist"));
  const auto lines = LiberoTaskLines(unit);
  ASSERT_TRUE(lines.ok()) << lines.status();
  EXPECT_EQ(lines->at(0).instruction, "put the bowl on the plate");
  EXPECT_EQ(CountInitialStates(unit, 1).value_or(-1), 50);
}

TEST(LiberoTaskFolder, WhatIsWrongWithALaterTaskIsSaidBeforeTheFirstIsPlayed) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path folder = fs::path(::testing::TempDir()) / "libero_goal_faults";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const std::string root = LiberoTree() + "/libero/libero/", name = "put_the_bowl_on_the_plate";
  const std::string text = *ReadFile(root + "bddl_files/libero_goal/" + name + ".bddl");
  const std::string states = root + "init_files/libero_goal/" + name + ".pruned_init";
  for (const char* task : {"a", "b"}) {
    ASSERT_TRUE(WriteFileAtomically((folder / task).string() + ".bddl", text).ok());
    fs::copy_file(states, (folder / task).string() + ".pruned_init");
  }
  UnitConfig unit = GoalUnit();
  unit.libero_tasks = folder.string();
  unit.suite = *AddTaskFolder(unit.libero_tasks);
  unit.tasks = {0, 1};
  unit.first_initial_state = 40;
  unit.episodes = 10;
  EXPECT_EQ(CheckLiberoTasks(unit).message(), "");
  unit.episodes = 11;
  EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()),
              HasSubstr("episodes start from states 40 to 50, and "));
  unit.episodes = 1;
  ASSERT_TRUE(WriteFileAtomically(
                  (folder / "b.bddl").string(),
                  absl::StrReplaceAll(text, {{"main_table_stove_region)\n", "main_table_stov)\n"}}))
                  .ok());
  EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()),
              HasSubstr("fixture 'flat_stove_1' is placed by no"));
  EXPECT_THAT(ErrorOf(unit, 1), HasSubstr("fixture 'flat_stove_1' is placed by no"));
  EXPECT_TRUE(LiberoTaskLines(unit)->at(1).read.ok())
      << "a misplaced fixture has words all the same";
  for (const auto& [from, to, error] :
       {std::tuple(" - plate\n", " - no_such_dish\n", "category 'no_such_dish'"),
        std::tuple("(And (On", "(And (Under", "'under' is unknown"),
        std::tuple("(:language", "((:language", "')' is missing")}) {
    const std::string other = absl::StrReplaceAll(text, {{from, to}});
    ASSERT_NE(other, text);
    ASSERT_TRUE(WriteFileAtomically((folder / "b.bddl").string(), other).ok());
    EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()), HasSubstr(error));
  }
  // Whoever plays the other task does not care.
  EXPECT_THAT(std::string(LiberoTaskLines(unit)->at(1).read.message()), HasSubstr("is missing"));
  EXPECT_EQ(LiberoTaskLines(unit)->at(0).instruction, "put the bowl on the plate");
  unit.tasks = {0};
  EXPECT_EQ(CheckLiberoTasks(unit).message(), "");
  EXPECT_EQ(ErrorOf(unit, 0), "made");
  unit.tasks = {0, 1};
  ASSERT_TRUE(WriteFileAtomically((folder / "b.bddl").string(), text).ok());
  fs::copy_file(
      root + "init_files/libero_10/" + (*LiberoTaskNames("libero_10"))[0] + ".pruned_init",
      folder / "b.pruned_init", fs::copy_options::overwrite_existing);
  EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()), HasSubstr("do not belong together"));
  fs::remove(folder / "b.pruned_init");
  fs::create_symlink("b.pruned_init", folder / "b.pruned_init");
  EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()), HasSubstr("b.pruned_init'"));
  fs::remove(folder / "b.pruned_init");
  EXPECT_THAT(std::string(CheckLiberoTasks(unit).message()),
              HasSubstr("b.bddl: no initial states"));
  unit.tasks = {0};
  EXPECT_EQ(CheckLiberoTasks(unit).message(), "");
  const size_t range = text.find('(', text.find("(:ranges (") + 10);
  const std::string flat = text.substr(0, range) + "(0 0 0 1" + text.substr(text.find(')', range));
  ASSERT_TRUE(WriteFileAtomically((folder / "a.bddl").string(), flat).ok());
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("has a range without area"));
}

TEST(LiberoTaskTest, ResetIsReproducibleAndStartsFromTheStoredRow) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit();
  unit.sim.settle_steps = 0;
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(unit, kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  ASSERT_TRUE((*task)->Reset(3).ok());
  const int nq = (*task)->scene().model->nq;
  const double* row = (*task)->init_states().row(3);
  for (int i = 0; i < nq; ++i) EXPECT_EQ((*task)->sim().data().qpos[i], row[1 + i]) << i;

  const Eigen::VectorXf command = Eigen::VectorXf::Constant(7, 0.3f);
  std::vector<double> first;
  for (int run = 0; run < 2; ++run) {
    ASSERT_TRUE((*task)->Reset(3).ok());
    for (int i = 0; i < 5; ++i) ASSERT_TRUE((*task)->Step(command).ok());
    const double* qpos = (*task)->sim().data().qpos;
    if (run == 0) first.assign(qpos, qpos + nq);
    for (int i = 0; i < nq; ++i) EXPECT_EQ(qpos[i], first[i]) << i;
  }
  EXPECT_THAT((*task)->Reset(50).message(), HasSubstr("initial state 50 does not exist"));
  EXPECT_THAT((*task)->Reset(-1).message(), HasSubstr("initial state -1 does not exist"));
}

// What NumpyPlacement draws is compared with the originals' resets in numpy_placement_test.
TEST(LiberoTaskTest, TrainingDrawsAreResetsOfTheirOwnAndLeaveNoTrace) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit();
  unit.sim.settle_steps = 0;
  const auto task = LiberoSimTask::Create(unit, kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  LiberoSimTask& libero = **task;
  const mjModel& model = libero.sim().model();
  const auto state = [&] {
    std::vector<double> values(libero.sim().data().qpos, libero.sim().data().qpos + model.nq);
    values.insert(values.end(), model.body_pos, model.body_pos + 3 * model.nbody);  // fixtures'
    return values;
  };
  ASSERT_TRUE(libero.Reset(3).ok());
  const std::vector<double> stored = state();
  ASSERT_TRUE(libero.Reset(1000).ok());
  const std::vector<double> drawn = state();
  ResetDraw reset = NumpyPlacement::Create(libero.scene(), 1000)->Reset().value();
  EXPECT_TRUE(std::equal(reset.qpos.begin(), reset.qpos.end(), drawn.begin()));
  ASSERT_TRUE(libero.Reset(1001).ok());
  EXPECT_NE(state(), drawn);
  EXPECT_FALSE(std::equal(state().begin() + model.nq, state().end(), stored.begin() + model.nq))
      << "fixtures are drawn too";
  ASSERT_TRUE(libero.Reset(1000).ok());
  EXPECT_EQ(state(), drawn);
  ASSERT_TRUE(libero.Reset(3).ok());
  EXPECT_EQ(state(), stored) << "fixtures stand centred again";
}

TEST(LiberoTaskTest, ObservesInTheOriginalsConventions) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  ASSERT_TRUE((*task)->Reset(0).ok());
  PolicySpec spec;
  const absl::StatusOr<Observation> observation = (*task)->Observe(spec);
  ASSERT_TRUE(observation.ok()) << observation.status();
  EXPECT_EQ(observation->instruction, "put the bowl on the plate");
  EXPECT_TRUE(observation->views.empty()) << "renders only what the spec asks for";
  const Eigen::VectorXf& state = observation->proprioception;
  ASSERT_EQ(state.size(), 8);
  const RobotState measured = *(*task)->Measure();
  const Eigen::Vector3d base(-0.66, 0, 0.912);  // world frame, where RobotState has the base's
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(state[i], measured.tool.p_base_tool[i] + base[i], 1e-6);
  const Eigen::Vector3d rotation = state.segment<3>(3).cast<double>();
  EXPECT_LT(RotationBetween(ExpSo3(rotation), measured.tool.q_base_tool).norm(), 1e-6);
  EXPECT_NEAR(state[6] - state[7], measured.gripper, 1e-7);
}

// The originals' 90 control steps, from their reset. Commands pass through float here, and
// PandaSim's fast stepping solves contacts from another warm start: 1e-6 rad is what that leaves
// where no contact bifurcates.
TEST(LiberoTaskTest, FollowsTheOriginalsTrajectory) {
  SKIP_WITHOUT_SHARED_DATA();
  const std::string stem = SharedFolder() + "/oracles/libero/libero_goal_00";
  if (!fs::exists(stem + ".safetensors")) GTEST_SKIP() << stem << " is absent";
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task = LiberoSimTask::Create(GoalUnit(), 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const nlohmann::json facts = nlohmann::json::parse(*ReadFile(stem + ".json"));
  std::vector<FixturePose> poses;
  for (const auto& [fixture, pose] : facts["fixture_pose"].items()) {
    poses.push_back(
        {fixture, pose[0].get<std::array<double, 3>>(), pose[1].get<std::array<double, 4>>()});
  }
  ASSERT_TRUE((*task)->MoveFixtures(poses).ok());
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(stem + ".safetensors");
  ASSERT_TRUE(oracle.ok()) << oracle.status();
  const std::vector<double> start = *oracle->ReadDoubles("init_state"),
                            actions = *oracle->ReadDoubles("actions");
  const std::vector<double> qpos = *oracle->ReadDoubles("qpos"),
                            home = *oracle->ReadDoubles("initial_joint");
  const int nq = (*task)->scene().model->nq;
  const Eigen::Matrix<double, 7, 1> posture =
      Eigen::Map<const Eigen::Matrix<double, 7, 1>>(home.data());
  ASSERT_TRUE((*task)->sim().Reset(absl::MakeConstSpan(start.data() + 1, nq), posture).ok());
  double arm = 0, rest = 0;
  for (size_t step = 0; step < actions.size() / 7; ++step) {
    const Eigen::VectorXf command =
        Eigen::Map<const Eigen::VectorXd>(actions.data() + 7 * step, 7).cast<float>();
    ASSERT_TRUE((*task)->Step(command).ok());
    EXPECT_FALSE((*task)->Success()) << step;
    for (int i = 0; i < nq; ++i) {
      const double error = std::abs((*task)->sim().data().qpos[i] - qpos[(step + 1) * nq + i]);
      (i < 7 ? arm : rest) = std::max(i < 7 ? arm : rest, error);
    }
  }
  std::printf("after %zu control steps: arm %.2g rad, everything else %.2g\n", actions.size() / 7,
              arm, rest);
  EXPECT_LT(arm, 1e-6);
  EXPECT_LT(rest, 1e-6);
}

// robosuite's quat2axisangle of x y z w: the long way round where w < 0.
std::array<double, 3> Turn(const double* xyzw) {
  const double half = std::acos(xyzw[3]), sine = std::sqrt(1 - xyzw[3] * xyzw[3]);
  if (sine == 0) return {0, 0, 0};
  return {2 * half * xyzw[0] / sine, 2 * half * xyzw[1] / sine, 2 * half * xyzw[2] / sine};
}

// Largest difference from the state that the originals' observations give a policy, over the steps
// after settling.
double ProprioceptionError(const std::string& suite, const SimOptions& sim) {
  const absl::StatusOr<SafetensorsFile> oracle = SafetensorsFile::Open(
      absl::StrCat(SharedFolder(), "/oracles/libero/", suite, "_00.safetensors"));
  EXPECT_TRUE(oracle.ok()) << oracle.status();
  UnitConfig unit = GoalUnit();
  unit.suite = suite;
  unit.libero_fixtures = "numpy:7";
  unit.sim = sim;
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task = LiberoSimTask::Create(unit, 0);
  EXPECT_TRUE(task.ok()) << task.status();
  const std::vector<double> actions = *oracle->ReadDoubles("actions"),
                            position = *oracle->ReadDoubles("eef_pos"),
                            quat = *oracle->ReadDoubles("eef_quat"),
                            fingers = *oracle->ReadDoubles("gripper_qpos");
  double error = 0;
  EXPECT_TRUE((*task)->Reset(0).ok());
  for (size_t step = unit.sim.settle_steps; step < 40; ++step) {
    const Eigen::VectorXf state = (*task)->Observe(PolicySpec())->proprioception;
    const std::array<double, 3> turn = Turn(quat.data() + 4 * step);
    for (int i = 0; i < 3; ++i) {
      error = std::max(error, std::abs(state[i] - position[3 * step + i]));
      error = std::max(error, std::abs(state[3 + i] - turn[i]));
    }
    for (int i = 0; i < 2; ++i)
      error = std::max(error, std::abs(state[6 + i] - fingers[2 * step + i]));
    const Eigen::Matrix<double, 7, 1> command =
        Eigen::Map<const Eigen::Matrix<double, 7, 1>>(actions.data() + 7 * step);
    EXPECT_TRUE((*task)->StepExact(command, /*settling=*/false).ok());
  }
  return error;
}

// 1e-6 [m, rad]: a state is single precision, whose last digit is 2.4e-7 at pi.
TEST(LiberoTaskTest, ProprioceptionIsTheOriginals) {
  SKIP_WITHOUT_SHARED_DATA();
  if (!fs::exists(SharedFolder() + "/oracles/libero")) GTEST_SKIP() << "no oracles/libero";
  SimOptions parity, protocol;
  parity.stepping = Stepping::kParity;
  protocol.robosuite.late_observation = Switch::kOn;  // what --protocol sets
  for (const char* suite : {"libero_spatial", "libero_object", "libero_goal", "libero_10"}) {
    EXPECT_LT(ProprioceptionError(suite, parity), 1e-6) << suite;
    EXPECT_LT(ProprioceptionError(suite, protocol), 1e-6) << suite;
  }
  EXPECT_GT(ProprioceptionError("libero_object", SimOptions()), 1e-5) << "four milliseconds later";
}

// A plate that flies over the zone in front of the stove at `speed` [m/s] along x.
class FlyingPlate {
 public:
  explicit FlyingPlate(Stepping stepping) {
    constexpr int kPlateInFrontOfStove = 5;
    UnitConfig unit = GoalUnit();
    unit.sim.stepping = stepping;
    unit.sim.settle_steps = 0;
    task_ = LiberoSimTask::Create(unit, kPlateInFrontOfStove).value();
    const LiberoObject& plate = task_->scene().objects.at("plate_1");
    const mjModel& m = task_->sim().model();
    qpos_ = m.jnt_qposadr[plate.joints.back()];
    qvel_ = m.jnt_dofadr[plate.joints.back()];
    const int site = task_->scene().sites.at("main_table_stove_front_region").site;
    half_ = m.site_size[3 * site];
    EXPECT_TRUE(task_->Reset(0).ok());
    const double* p = task_->sim().data().site_xpos + 3 * site;
    centre_ = {p[0], p[1], p[2]};
  }

  double half() const { return half_; }  // [m] of the zone along x
  LiberoSimTask& task() { return *task_; }

  // One control step from `x` [m] beside the zone's centre; returns x at the end of each sub-step.
  std::vector<double> Step(double x, double speed) {
    const mjModel& m = task_->sim().model();
    const double* row = task_->init_states().row(0);
    std::vector<double> qpos(row + 1, row + 1 + m.nq), qvel(m.nv, 0.0);
    qpos[qpos_] = centre_.x() + x;
    qpos[qpos_ + 1] = centre_.y();
    qpos[qpos_ + 2] = centre_.z() + 0.08;
    qvel[qvel_] = speed;
    EXPECT_TRUE(task_->ResetTo(qpos, qvel, LiberoSimTask::HomePosture()).ok());
    std::vector<double> xs;
    task_->sim().OnSubStep([&] { xs.push_back(task_->sim().data().qpos[qpos_] - centre_.x()); });
    EXPECT_TRUE(task_->StepExact(Eigen::Matrix<double, 7, 1>::Zero(), false).ok());
    task_->sim().OnSubStep(nullptr);
    return xs;
  }

 private:
  std::unique_ptr<LiberoSimTask> task_;
  int qpos_ = 0, qvel_ = 0;
  double half_ = 0;
  Eigen::Vector3d centre_;
};

// The originals look once per control step, after mj_step without a forward: at the poses from
// which the last of 25 sub-steps started.
TEST(LiberoTaskTest, SuccessIsOfTheOriginalsMoment) {
  SKIP_WITHOUT_SHARED_DATA();
  constexpr double kSpeed = 1;  // 2 mm in a sub-step
  for (const Stepping stepping : {Stepping::kParity, Stepping::kFast}) {
    FlyingPlate plate(stepping);
    const std::vector<double> flight = plate.Step(0, kSpeed);
    ASSERT_EQ(flight.size(), 25u);
    const double middle_of_last = (flight[23] + flight[24]) / 2;
    // Leaves the zone within the last sub-step, then enters it within the last sub-step.
    std::vector<double> xs = plate.Step(plate.half() - middle_of_last, kSpeed);
    ASSERT_LT(xs[23], plate.half());
    ASSERT_GT(xs[24], plate.half());
    EXPECT_TRUE(plate.task().Success());
    xs = plate.Step(-plate.half() - middle_of_last, kSpeed);
    ASSERT_LT(xs[23], -plate.half());
    ASSERT_GT(xs[24], -plate.half());
    EXPECT_FALSE(plate.task().Success());
    // What crosses the zone between two looks is not seen.
    xs = plate.Step(-0.2, 8);
    ASSERT_LT(xs[0], -plate.half());
    ASSERT_GT(xs[24], plate.half());
    EXPECT_FALSE(plate.task().Success());
  }
}

// openpi's episode: the suites' horizons, and ten settle steps of a zero command with an open hand.
TEST(LiberoTaskTest, HorizonsAreOpenpis) {
  const std::map<std::string, int> horizons = {
      {"libero_spatial", 220}, {"libero_object", 280}, {"libero_goal", 300}, {"libero_10", 520}};
  for (const auto& [suite, horizon] : horizons) {
    ASSERT_NE(FindSuite(suite), nullptr) << suite;
    EXPECT_EQ(FindSuite(suite)->horizon, horizon) << suite;
    EXPECT_EQ(FindSuite(suite)->num_tasks, 10) << suite;
    EXPECT_EQ(LiberoTaskNames(suite)->size(), 10u) << suite;
  }
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  EXPECT_EQ((*task)->horizon(), 300) << "the settle steps are not among them";
  UnitConfig limited = GoalUnit();
  limited.horizon = 280;
  EXPECT_EQ(LiberoSimTask::Create(limited, kBowlOnPlate).value()->horizon(), 280);
}

TEST(LiberoTaskTest, AResetTakesTenSettleStepsThatAreNotTheEpisodes) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig bare = GoalUnit();
  bare.sim.settle_steps = 0;
  const auto settled = LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  const auto stepped = LiberoSimTask::Create(bare, kBowlOnPlate);
  ASSERT_TRUE(settled.ok() && stepped.ok()) << settled.status() << stepped.status();
  ASSERT_TRUE((*settled)->Reset(4).ok());
  ASSERT_TRUE((*stepped)->Reset(4).ok());
  EXPECT_NEAR((*settled)->sim().data().time, 10 * 0.05, 1e-9);
  EXPECT_EQ((*settled)->sim().steps_taken(), 0);
  EXPECT_FALSE((*settled)->Success());
  Eigen::Matrix<double, 7, 1> dummy = Eigen::Matrix<double, 7, 1>::Zero();
  dummy[6] = -1;
  for (int i = 0; i < 10; ++i) ASSERT_TRUE((*stepped)->StepExact(dummy, /*settling=*/true).ok());
  for (int i = 0; i < (*settled)->scene().model->nq; ++i)
    EXPECT_EQ((*settled)->sim().data().qpos[i], (*stepped)->sim().data().qpos[i]) << i;
}

// openpi's _quat2axisangle, in its order x y z w.
Eigen::Vector3d OpenpiAxisAngle(const double* xyzw) {
  const double w = std::clamp(xyzw[3], -1.0, 1.0), den = std::sqrt(1 - w * w);
  if (den == 0) return Eigen::Vector3d::Zero();
  return Eigen::Vector3d(xyzw[0], xyzw[1], xyzw[2]) * 2 * std::acos(w) / den;
}

// The state that openpi's client builds of the originals' recorded observations, row by row.
TEST(LiberoTaskTest, ObservesTheOriginalsStateInParityMode) {
  SKIP_WITHOUT_SHARED_DATA();
  const std::string file = SharedFolder() + "/oracles/libero/libero_goal_00.safetensors";
  if (!fs::exists(file)) GTEST_SKIP() << file << " is absent";
  UnitConfig unit = GoalUnit();
  unit.sim.stepping = Stepping::kParity;
  const auto task = LiberoSimTask::Create(unit, 0);
  ASSERT_TRUE(task.ok()) << task.status();
  const auto oracle = SafetensorsFile::Open(file);
  ASSERT_TRUE(oracle.ok()) << oracle.status();
  const auto recording = ReadRecording(*oracle, **task);
  ASSERT_TRUE(recording.ok()) << recording.status();
  ASSERT_TRUE((*task)->MoveFixtures(recording->fixtures).ok());
  const int nq = (*task)->scene().model->nq;
  const absl::Span<const double> start = recording->init_state;
  ASSERT_TRUE((*task)->ResetTo(start.subspan(1, nq), start.subspan(1 + nq), recording->home).ok());
  const std::vector<double> pos = *oracle->ReadDoubles("eef_pos"),
                            quat = *oracle->ReadDoubles("eef_quat"),
                            fingers = *oracle->ReadDoubles("gripper_qpos");
  for (int t = 0; t < recording->steps(); ++t) {
    const Eigen::Map<const Eigen::Matrix<double, 7, 1>> action(recording->actions.data() + 7 * t);
    ASSERT_TRUE((*task)->StepExact(action, /*settling=*/t < 10).ok());
    const auto observation = (*task)->Observe(PolicySpec());
    ASSERT_TRUE(observation.ok()) << observation.status();
    const Eigen::VectorXf& state = observation->proprioception;
    const int row = t + 1;
    const Eigen::Vector3d rotation = OpenpiAxisAngle(quat.data() + 4 * row);
    for (int i = 0; i < 3; ++i) {
      EXPECT_EQ(state[i], static_cast<float>(pos[3 * row + i])) << t;
      EXPECT_NEAR(state[3 + i], rotation[i], 1e-6) << t;
    }
    for (int i = 0; i < 2; ++i) EXPECT_NEAR(state[6 + i], fingers[2 * row + i], 1e-8) << t;
  }
}

// Where a world point lies in an upright picture of a camera [px].
Eigen::Vector2d Project(const mjModel& model, const mjData& data, const char* camera,
                        const Eigen::Vector3d& p, int size) {
  const int id = mj_name2id(&model, mjOBJ_CAMERA, camera);
  const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(data.cam_xmat + 9 * id);
  const Eigen::Vector3d d =
      R.transpose() * (p - Eigen::Map<const Eigen::Vector3d>(data.cam_xpos + 3 * id));
  const double focal = size / 2.0 / std::tan(model.cam_fovy[id] / 2 * std::numbers::pi / 180);
  return {size / 2.0 - focal * d.x() / d.z(), size / 2.0 + focal * d.y() / d.z()};
}

// The centre of the pixels in which two pictures differ [px].
Eigen::Vector2d CentreOfChange(const Image& a, const Image& b) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  int changed = 0;
  for (int i = 0; i < a.width * a.height; ++i) {
    if (std::equal(&a.data[3 * i], &a.data[3 * i] + 3, &b.data[3 * i])) continue;
    const auto column = i % a.width, row = i / a.width;
    sum += Eigen::Vector2d(column + 0.5, row + 0.5);
    ++changed;
  }
  return sum / std::max(changed, 1);
}

// A bowl that is put aside leaves a hole where the camera's geometry says, left and right
// exchanged: LIBERO's bottom-up pixels turned by 180 degrees.
TEST(LiberoTaskTest, ViewsStandUprightWithLeftAndRightExchanged) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit();
  unit.sim.settle_steps = 0;
  const auto task = LiberoSimTask::Create(unit, kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  const mjModel& model = (*task)->sim().model();
  const int joint = (*task)->scene().objects.at("akita_black_bowl_1").joints.back();
  const double* row = (*task)->init_states().row(0);
  std::vector<double> qpos(row + 1, row + 1 + model.nq);
  const std::vector<double> rest(model.nv, 0.0);
  const Eigen::Vector3d bowl(0.1, 0.3, 0.93);
  PolicySpec spec;
  spec.cameras = {"agentview"};
  spec.image_width = spec.image_height = 256;
  std::vector<Image> views;
  for (const double aside : {0.0, 20.0}) {
    double* position = &qpos[model.jnt_qposadr[joint]];
    for (int i = 0; i < 3; ++i) position[i] = bowl[i];
    position[0] += aside;
    ASSERT_TRUE((*task)->ResetTo(qpos, rest, LiberoSimTask::HomePosture()).ok());
    const auto observation = (*task)->Observe(spec);
    if (!observation.ok()) GTEST_SKIP() << observation.status();
    views.push_back(observation->views[0].image);
  }
  const Eigen::Vector2d upright =
      Project(model, (*task)->sim().data(), "agentview", bowl, spec.image_width);
  const Eigen::Vector2d seen = CentreOfChange(views[0], views[1]);
  EXPECT_GT(std::abs(upright.x() - 128), 40) << "the bowl stands clearly on one side";
  EXPECT_NEAR(seen.x(), 256 - upright.x(), 10);
  EXPECT_NEAR(seen.y(), upright.y(), 10);
}

TEST(LiberoTaskTest, SampledFixturesAreReproducibleAndStayInTheirRegions) {
  SKIP_WITHOUT_SHARED_DATA();
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task =
      LiberoSimTask::Create(GoalUnit(), kBowlOnPlate);
  ASSERT_TRUE(task.ok()) << task.status();
  const LiberoScene& scene = (*task)->scene();
  const std::vector<FixturePose> a = SampleFixtures(scene, 7), b = SampleFixtures(scene, 7),
                                 c = SampleFixtures(scene, 8);
  ASSERT_EQ(a.size(), 3u);
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].pos, b[i].pos);
    EXPECT_NE(a[i].pos, c[i].pos);
    for (int k = 0; k < 2; ++k)
      EXPECT_NEAR(a[i].pos[k], scene.centred_fixtures[i].pos[k], 0.01) << "regions are 2 cm wide";
    EXPECT_EQ(a[i].pos[2], scene.centred_fixtures[i].pos[2]);
  }
  // The heights that the originals computed for their draw.
  EXPECT_NEAR(scene.centred_fixtures[0].pos[2], 0.905, 1e-12);
  EXPECT_NEAR(scene.centred_fixtures[2].pos[2], 0.92, 1e-12);
}

// The simulator asks for contacts among near geoms; objects that lie on a floor of its own meet
// it twice, as in MuJoCo.
TEST(LiberoTaskTest, ContactsAreMuJoCosToTheBit) {
  SKIP_WITHOUT_SHARED_DATA();
  for (int i = 0; i < 40; ++i) {
    UnitConfig unit = GoalUnit();
    unit.suite = std::vector{"libero_spatial", "libero_object", "libero_goal", "libero_10"}[i / 10];
    unit.scenario = "aged_joint_elbow";
    SCOPED_TRACE(absl::StrCat(unit.suite, " ", i % 10));
    const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task = LiberoSimTask::Create(unit, i % 10);
    ASSERT_TRUE(task.ok()) << task.status();
    PandaSim& sim = (*task)->sim();
    const mjModel& model = std::as_const(sim).model();
    mjData* bare = mj_makeData(&model);
    int sub_step = 0, contacts = 0;
    sim.OnSubStep([&] {
      if (++sub_step % 7 != 0 || HasFatalFailure()) return;
      CollideAlike(model, sim.data(), *bare);
      ExpectSameContacts(sim.data(), *bare);
      contacts += bare->ncon;
    });
    ASSERT_TRUE((*task)->Reset(1).ok());
    for (int step = 0; step < 20; ++step) {
      Eigen::VectorXf command(7);
      command << 0.8f, step < 10 ? 0.7f : -0.9f, -1, 0.3f, -0.5f, 0.6f, step % 8 < 4 ? 1 : -1;
      ASSERT_TRUE((*task)->Step(command).ok());
    }
    sim.OnSubStep(nullptr);
    mj_deleteData(bare);
    ASSERT_FALSE(HasFatalFailure());
    EXPECT_GT(contacts, 700);
  }
}

// The rack is a fixture without joints: it moves in the model, and nothing in the state.
TEST(LiberoTaskTest, AMovedFixtureIsMetAtOnce) {
  SKIP_WITHOUT_SHARED_DATA();
  UnitConfig unit = GoalUnit();
  unit.sim.settle_steps = 0;
  const absl::StatusOr<std::unique_ptr<LiberoSimTask>> task = LiberoSimTask::Create(unit, 8);
  ASSERT_TRUE(task.ok()) << task.status();
  const PandaSim& sim = (*task)->sim();
  const mjModel& model = sim.model();
  const absl::StatusOr<FixturePose> rack = [&]() -> absl::StatusOr<FixturePose> {
    for (const FixturePose& pose : (*task)->scene().centred_fixtures)
      if (pose.fixture == "wine_rack_1") return pose;
    return absl::NotFoundError("no rack");
  }();
  ASSERT_TRUE(rack.ok());
  ASSERT_TRUE((*task)->Reset(1).ok());
  const std::vector<double> qpos(sim.data().qpos, sim.data().qpos + model.nq), qvel(model.nv, 0.0);
  Eigen::Matrix<double, 7, 1> home;
  for (int i = 0; i < 7; ++i) {
    const int joint = mj_name2id(&model, mjOBJ_JOINT, absl::StrCat("robot0_joint", i + 1).c_str());
    home[i] = qpos[model.jnt_qposadr[joint]];
  }
  const int plate = mj_name2id(&model, mjOBJ_BODY, "plate_1_main");
  FixturePose on_plate = *rack;
  on_plate.pos[0] = sim.data().xpos[3 * plate];
  on_plate.pos[1] = sim.data().xpos[3 * plate + 1];
  mjData* bare = mj_makeData(&model);
  const auto snapshot = sim.Save();
  for (const bool restored : {false, true}) {
    ASSERT_TRUE((*task)->MoveFixtures({*rack}).ok());
    ASSERT_TRUE((*task)->ResetTo(qpos, qvel, home).ok());
    int contacts = -1;
    for (const FixturePose& pose : {*rack, on_plate}) {
      ASSERT_TRUE((*task)->MoveFixtures({pose}).ok());
      if (restored) {
        (*task)->sim().Restore(*snapshot);
      } else {
        ASSERT_TRUE((*task)->ResetTo(qpos, qvel, home).ok());
      }
      CollideAlike(model, sim.data(), *bare);
      ExpectSameContacts(sim.data(), *bare);
      EXPECT_NE(bare->ncon, std::exchange(contacts, bare->ncon)) << "the rack is in nobody's way";
    }
  }
  mj_deleteData(bare);
}

TEST(LiberoTaskTest, BadInputNamesTheFileAndTheRemedy) {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = "/nowhere";
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("--libero-root /nowhere"));
  SKIP_WITHOUT_SHARED_DATA();
  unit = GoalUnit();
  EXPECT_THAT(ErrorOf(unit, 10),
              HasSubstr("task 10 of suite 'libero_goal' does not exist; tasks are 0 to 9"));
  unit.suite = "libero_90";
  EXPECT_THAT(ErrorOf(unit, 0),
              HasSubstr("'libero_90' is not a LIBERO suite; known: libero_spatial"));
  unit.suite = "libero_goal";
  unit.robosuite_root = LiberoTree();
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("expected a robosuite 1.4 checkout"));
  unit.robosuite_root.clear();
  unsetenv("ROBOSUITE_ROOT");
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("give --robosuite-root DIR or set ROBOSUITE_ROOT"));
}

TEST(LiberoTaskTest, AMissingCollisionMeshIsAnErrorAndAMissingVisualIsNot) {
  SKIP_WITHOUT_SHARED_DATA();
  DamagedTree robosuite(RobosuiteTree());
  UnitConfig unit = GoalUnit();
  unit.robosuite_root = robosuite.path();
  robosuite.Remove("robosuite/models/assets/mounts/meshes/rethink_mount/pedestal.stl");
  const absl::StatusOr<std::unique_ptr<SimTask>> task = MakeLiberoTask(unit, 0);
  EXPECT_TRUE(task.ok()) << task.status();
  robosuite.Remove("robosuite/models/assets/robots/panda/meshes/link5.stl");
  EXPECT_THAT(ErrorOf(unit, 0),
              ::testing::AllOf(HasSubstr("collision mesh 'robot0_link5' is missing"),
                               HasSubstr("link5.stl")));
  robosuite.Write("robosuite/models/assets/grippers/panda_gripper.xml", "<mujoco><worldbody>");
  EXPECT_THAT(ErrorOf(unit, 0), HasSubstr("panda_gripper.xml:1: not XML"));
}

TEST(LiberoTaskTest, ALiberoWithoutItsAssetsSaysWhereTheyBelong) {
  const fs::path root = fs::temp_directory_path() / absl::StrCat("robostress_bare_", getpid());
  fs::create_directories(root / "libero/libero/bddl_files");
  const absl::StatusOr<LiberoPaths> paths = FindLibero(root, root);
  fs::remove_all(root);
  EXPECT_THAT(std::string(paths.status().message()),
              ::testing::AllOf(HasSubstr("--libero-root " + root.string() + ": no assets beside"),
                               HasSubstr("`robostress libero setup` finds and links them")));
}

TEST(LiberoTaskTest, AnErrorOfTheCompilerQuotesTheElement) {
  SKIP_WITHOUT_SHARED_DATA();
  DamagedTree robosuite(RobosuiteTree());
  UnitConfig unit = GoalUnit();
  unit.robosuite_root = robosuite.path();
  const std::string mount = "robosuite/models/assets/mounts/rethink_mount.xml";
  std::string text = *ReadFile(RobosuiteTree() + "/" + mount);
  text.insert(text.find("<geom ") + 6, "colour=\"1\" ");
  robosuite.Write(mount, text);
  EXPECT_THAT(ErrorOf(unit, 0), ::testing::AllOf(HasSubstr("unrecognized attribute: 'colour'"),
                                                 HasSubstr("in the composed scene: <geom colour"),
                                                 HasSubstr("\"mount0_")));
}

}  // namespace
}  // namespace robostress::libero
