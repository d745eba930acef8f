#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/record/expert_demonstration.h"
#include "sim_worker/record/libero_recorder.h"
#include "tests/common/libero/shared_data.h"
#include "tests/run_program.h"

namespace robostress::libero {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

constexpr int kDraw = kFirstTrainingDraw;

std::unique_ptr<LiberoSimTask> BowlOnPlate() {
  UnitConfig unit;
  unit.suite = "libero_goal";
  unit.libero_root = LiberoTree();
  unit.robosuite_root = RobosuiteTree();
  unit.sim.pictures = SimOptions::kPlainPictures;
  auto task = LiberoSimTask::Create(unit, 8);
  EXPECT_TRUE(task.ok()) << task.status();
  return *std::move(task);
}

// A policy of LIBERO reads of the file what Observe gives: state without obs/proprioception, views
// turned by 180 degrees.
TEST(LiberoRecord, AnEpisodeIsStoredAsLiberoStoresItsOwn) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = BowlOnPlate();
  RecordOptions options;
  options.stride = 1;
  options.image_size = 32;
  options.noisy_share = 0;
  options.simulator_state = true;
  ASSERT_TRUE(task->Reset(kDraw).ok());
  const auto episode =
      RecordExpert(*task, task->MakeExpert().value(), options, StreamKey("libero record"));
  if (absl::IsUnavailable(episode.status())) GTEST_SKIP() << episode.status().message();
  ASSERT_TRUE(episode.ok()) << episode.status();
  ASSERT_TRUE(episode->success);
  const std::string path = ::testing::TempDir() + "/libero_record_test.hdf5";
  auto writer =
      LiberoDemonstrationWriter::Create(path, {"libero_goal", task->name(), task->instruction()});
  ASSERT_TRUE(writer.ok()) << writer.status();
  ASSERT_TRUE(writer->Add(ToLibero(*episode, task->mjcf(), /*libero_suite=*/true)).ok());
  ASSERT_TRUE(writer->Publish().ok());
  const auto file = LiberoDemonstrationFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_FALSE(file->has_proprioception());
  EXPECT_TRUE(file->has_aux());
  const LiberoColumns columns = file->ReadColumns(0).value();
  ASSERT_EQ(columns.steps, episode->steps);
  for (int t = 0; t < episode->steps; ++t) {
    const Eigen::VectorXf& state = episode->frames[t].proprioception;
    for (int i = 0; i < 3; ++i) {
      EXPECT_EQ(static_cast<float>(columns.ee_pos[3 * t + i]), state[i]);
      EXPECT_NEAR(columns.ee_ori[3 * t + i], state[3 + i], 1e-5);
    }
    EXPECT_EQ(static_cast<float>(columns.gripper_states[2 * t]), state[6]);
  }
  EXPECT_EQ(MirrorColumns(*file->ReadView(0, LiberoDemonstrationFile::View::kAgent, 9)).data,
            episode->frames[9].views[0].data);
  std::remove(path.c_str());
}

// Fixtures are not in qpos: only the scene's text says where they stood in an episode.
TEST(LiberoRecord, TheSceneThatIsStoredHasItsFixturesInPlace) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = BowlOnPlate();
  EXPECT_EQ(task->problem(), "libero_tabletop_manipulation");
  std::set<std::string> texts;
  for (const int draw : {kDraw, kDraw + 1}) {
    ASSERT_TRUE(task->Reset(draw).ok());
    const std::string text = task->mjcf();
    texts.insert(text);
    const mjModel& played = task->sim().model();
    std::array<char, 1000> error = {};
    const std::string file = ::testing::TempDir() + "/placed.xml";
    ASSERT_TRUE(WriteFileAtomically(file, text).ok());
    mjModel* const stored = mj_loadXML(file.c_str(), nullptr, error.data(), error.size());
    ASSERT_NE(stored, nullptr) << error.data();
    ASSERT_EQ(stored->nbody, played.nbody);
    for (int i = 0; i < 3 * stored->nbody; ++i)
      EXPECT_NEAR(stored->body_pos[i], played.body_pos[i], 1e-12) << "body " << i / 3;
    for (int i = 0; i < 4 * stored->nbody; ++i)
      EXPECT_NEAR(stored->body_quat[i], played.body_quat[i], 1e-12) << "body " << i / 4;
    mj_deleteModel(stored);
  }
  EXPECT_EQ(texts.size(), 2u);
}

// The bowl, then the plate; the bowl is held in between; the task is done at the end.
TEST(LiberoRecord, TheExpertSaysWhatItLooksAt) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = BowlOnPlate();
  ASSERT_TRUE(task->Reset(kDraw).ok());
  const Expert expert = task->MakeExpert().value();
  const auto place = [&](const char* body) {
    const mjModel& model = task->sim().model();
    const mjData& data = task->sim().data();
    const int id = mj_name2id(&model, mjOBJ_BODY, body);
    const int base = mj_name2id(&model, mjOBJ_BODY, "robot0_base");
    return Eigen::Vector3d(Eigen::Map<const Eigen::Vector3d>(data.xpos + 3 * id) -
                           Eigen::Map<const Eigen::Vector3d>(data.xpos + 3 * base));
  };
  const ExpertDecision first = expert();
  EXPECT_LT((first.target - place("akita_black_bowl_1_main")).norm(), 1e-9);
  EXPECT_LT((first.destination - place("plate_1_main")).head<2>().norm(), 1e-9);
  EXPECT_FALSE(first.holding);
  EXPECT_EQ(first.progress, 0);
  bool held = false;
  for (int step = 0; step < task->horizon() && !task->Success(); ++step) {
    const ExpertDecision decision = expert();
    held |= decision.holding && decision.progress == 0.5;
    ASSERT_TRUE(task->Step(decision.command).ok());
  }
  EXPECT_TRUE(held);
  ASSERT_TRUE(task->Success());
}

// A label is the expert's own future, and to ask for it changes nothing.
TEST(LiberoRecord, ABranchLeavesNoTrace) {
  SKIP_WITHOUT_SHARED_DATA();
  const auto task = BowlOnPlate();
  ASSERT_TRUE(task->Reset(kDraw).ok());
  const Expert expert = task->MakeExpert().value();
  for (int i = 0; i < 30; ++i) ASSERT_TRUE(task->Step(expert().command).ok());
  const auto label = BranchLabel(*task, expert);
  ASSERT_TRUE(label.ok()) << label.status();
  for (int i = 0; i < 20; ++i) {
    const Eigen::VectorXf command = expert().command;
    EXPECT_EQ(label->row(i).transpose(), command) << "row " << i;
    ASSERT_TRUE(task->Step(command).ok());
  }
}

// Two objects in a region of 2 cm: no draw has room. The task beside it is recorded all the same.
TEST(LiberoRecord, ATaskWithoutRoomTakesNothingFromTheOthers) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path folder = fs::path(::testing::TempDir()) / "libero_record_no_room";
  const fs::path libero = fs::path(LiberoTree()) / "libero/libero", tasks = folder / "tasks";
  fs::remove_all(folder);
  fs::create_directories(tasks);
  for (const std::string task :
       {"put_the_bowl_on_the_plate", "put_the_bowl_on_top_of_the_cabinet"}) {
    fs::copy(libero / "init_files/libero_goal" / (task + ".pruned_init"), tasks);
    fs::copy(libero / "bddl_files/libero_goal" / (task + ".bddl"), tasks);
  }
  const std::string bddl = (tasks / "put_the_bowl_on_the_plate.bddl").string();
  const std::string text = ReadFile(bddl).value();
  ASSERT_TRUE(WriteFileAtomically(
                  bddl, absl::StrReplaceAll(
                            text, {{"(On akita_black_bowl_1 main_table_akita_black_bowl_region)",
                                    "(On akita_black_bowl_1 main_table_plate_region)"}}))
                  .ok());
  const std::string command = absl::StrCat(
      "--episodes 1 --plain-pictures --libero-root ", LiberoTree(), " --robosuite-root ",
      RobosuiteTree(), " --libero-tasks ", tasks.string(), " --out ", (folder / "out").string());
  const auto [output, code] = RunProgram(ROBOSTRESS_RECORD, command);
  if (absl::StrContains(output, "EGL")) GTEST_SKIP() << output;
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, HasSubstr("draws without room for an object: 1000 1001"));
  EXPECT_THAT(output, HasSubstr("task 0: none of the draws 1000 to 1001"));
  EXPECT_FALSE(fs::exists(folder / "out/tasks_task00_expert_1000.safetensors"));
  EXPECT_TRUE(fs::exists(folder / "out/tasks_task01_expert_1000.safetensors")) << output;
  ASSERT_TRUE(WriteFileAtomically(bddl, text).ok());
  EXPECT_THAT(RunProgram(ROBOSTRESS_RECORD, command).first,
              HasSubstr("task01_expert_1000.safetensors was recorded with"))
      << "in a folder of other tasks";
}

// Settings of `record` that leave the file's name as it is.
TEST(LiberoRecord, AFileOfOtherSettingsIsNotWrittenOver) {
  SKIP_WITHOUT_SHARED_DATA();
  const fs::path folder = fs::path(::testing::TempDir()) / "libero_record_settings";
  fs::remove_all(folder);
  const auto record = [&](const std::string& more, int episodes = 1) {
    return RunProgram(
        ROBOSTRESS_RECORD,
        absl::StrCat("--suite libero_object --tasks 0 --episodes ", episodes, " --plain-pictures ",
                     "--image-size 16 --libero-root ", LiberoTree(), " --robosuite-root ",
                     RobosuiteTree(), " --out ", folder.string(), " ", more));
  };
  for (const std::string form : {"shards", "hdf5"}) {
    const auto [output, code] = record("--format " + form, 2);
    if (absl::StrContains(output, "EGL")) GTEST_SKIP() << output;
    ASSERT_EQ(code, 0) << output;
    const auto [shorter, fewer] = record("--format " + form);
    EXPECT_EQ(fewer, 1) << shorter;
    EXPECT_THAT(shorter, HasSubstr("--episodes 2, of which --episodes 1 would leave a part"));
    const auto [refused, refusal] = record("--scenario aged_joint_uniform --format " + form);
    EXPECT_EQ(refusal, 1) << refused;
    EXPECT_THAT(refused, AllOf(HasSubstr("was recorded with {\"scenario\":\"clean\""),
                               HasSubstr("give another --out or --tag, or remove it")));
    const fs::path file = folder / absl::StrCat("libero_object_task00_expert_1000.",
                                                form == "hdf5" ? "hdf5" : "safetensors");
    std::ofstream(file, std::ios::trunc) << "another's";
    const auto [foreign, kept] = record("--format " + form);
    EXPECT_EQ(kept, 1) << foreign;
    EXPECT_THAT(foreign, HasSubstr("was recorded with settings that it does not name"));
    EXPECT_EQ(fs::file_size(file), 9u);
  }
  const auto [both, code] = record("--libero-tasks " + folder.string());
  EXPECT_EQ(code, 2) << both;
  EXPECT_THAT(record("--tasks 12").first, HasSubstr("task 12 of libero_object does not exist"));
}

}  // namespace
}  // namespace robostress::libero
