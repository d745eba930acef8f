#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/safetensors.h"
#include "sim_worker/libero/preprocess.h"
#include "sim_worker/robosuite_rotation.h"
#include "tests/common/wire/openpi_venv.h"
#include "tests/sim_worker/libero/picture_comparison.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;

Image Grey(int size, uint8_t level) {
  return Image{size, size, std::vector<uint8_t>(size_t{3} * size * size, level)};
}

TEST(PictureDifferenceTest, TellsMeanLargestAndVisible) {
  const Image theirs = Grey(16, 100);
  Image ours = theirs;
  EXPECT_EQ(Compare(ours, theirs).mean, 0);
  ours.data[0] = 117;
  ours.data[1] = 84;
  const PictureDifference difference = Compare(ours, theirs);
  EXPECT_DOUBLE_EQ(difference.mean, 33.0 / (3 * 16 * 16));
  EXPECT_EQ(difference.largest, 17);
  EXPECT_DOUBLE_EQ(difference.visible, 1.0 / (3 * 16 * 16)) << "16 is not visible, 17 is";
}

TEST(PictureDifferenceTest, ABlockSeesWhatMovedAndNotWhereAnEdgeFell) {
  const Image theirs = Grey(16, 100);
  Image edge = theirs, patch = theirs;
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) {
      const size_t at = 3 * (16 * y + x);
      edge.data[at] = x % 2 == 0 ? 140 : 60;  // averages to what it was
      patch.data[at] = 140;
    }
  }
  EXPECT_EQ(Compare(edge, theirs).block, 0);
  EXPECT_EQ(Compare(patch, theirs).block, 40);
  EXPECT_EQ(Compare(edge, theirs).mean, Compare(patch, theirs).mean);
}

// The originals, installed and run once per build folder.
class Originals {
 public:
  static const Originals& Get() {
    static const Originals& originals = *new Originals();
    return originals;
  }
  std::string failure;  // why tests must be skipped
  std::string folder, site;

 private:
  Originals() : folder(LIBERO_ORIGINALS_FOLDER "/pictures") {
    const std::string done = folder + "/DONE";
    if (std::getenv("ROBOSTRESS_LIBERO_PICTURES") == nullptr && !fs::exists(done)) {
      failure =
          "installs 0.9 GB of packages from PyPI; set ROBOSTRESS_LIBERO_PICTURES=1 to have it";
      return;
    }
    const OpenpiVenv venv = OpenpiVenv::Make(LIBERO_ORIGINALS_FOLDER "/venv",
                                             LIBERO_ORIGINALS "/requirements.txt", "LIBERO");
    failure = venv.failure;
    if (!failure.empty()) return;
    const auto [where, found] = RunProgram(
        venv.python, "-c \"import sysconfig; print(sysconfig.get_paths()['purelib'], end='')\"");
    site = where;
    if (found != 0) failure = where;
    if (!failure.empty() || fs::exists(done)) return;
    const auto [output, code] = RunProgram(
        venv.python, absl::StrCat(LIBERO_ORIGINALS "/look.py --reseeded 2 --out ", folder,
                                  " --suites libero_goal,libero_10 --tasks 0,3,5"));
    EXPECT_EQ(code, 0) << output;
    if (code == 0) std::ofstream(done) << output;
  }
};

class LiberoPicturesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!Originals::Get().failure.empty()) GTEST_SKIP() << Originals::Get().failure;
  }
  static ComparedTask CompareOne(const std::string& suite, int task) {
    const absl::StatusOr<ComparedTask> compared =
        CompareTask(FileOf(suite, task), suite, task, Originals::Get().site);
    EXPECT_TRUE(compared.ok()) << compared.status();
    return compared.ok() ? *compared : ComparedTask();
  }
  static std::string FileOf(const std::string& suite, int task) {
    return absl::StrCat(Originals::Get().folder, "/", suite, "_", task, ".safetensors");
  }
};

// A table, a living room, a kitchen and a study.
constexpr std::pair<const char*, int> kScenes[] = {
    {"libero_goal", 0}, {"libero_10", 0}, {"libero_10", 3}, {"libero_10", 5}};

TEST_F(LiberoPicturesTest, PicturesAreTheOriginals) {
  for (const auto& [suite, task] : kScenes) {
    const ComparedTask compared = CompareOne(suite, task);
    EXPECT_EQ(compared.same_state.size(), 12u);
    for (const ComparedPicture& picture : compared.same_state) {
      SCOPED_TRACE(absl::StrCat(suite, " ", task, " ", picture.moment, " ", picture.camera));
      EXPECT_LT(picture.difference.mean, 0.2);  // 0.074 is the worst of 40 tasks
      EXPECT_LT(picture.difference.block, 16) << "something structural";  // 10.3
    }
    for (const auto& [array, difference] : compared.model_arrays)
      EXPECT_LT(difference, 1e-5) << suite << " " << task << " " << array;
    EXPECT_LT(compared.fixtures, 1e-15) << suite << " " << task;
  }
}

TEST_F(LiberoPicturesTest, ProprioceptionIsTheOriginalsAfterOurOwnWay) {
  for (const auto& [suite, task] : kScenes) {
    const ComparedTask compared = CompareOne(suite, task);
    EXPECT_LT(compared.start_proprioception, 1e-6) << suite << " " << task;
    EXPECT_EQ(compared.whole_way_proprioception.size(), 2u);
    for (const auto& [moment, error] : compared.whole_way_proprioception)
      EXPECT_LT(error, 1e-6) << suite << " " << task << " " << moment;
  }
}

TEST_F(LiberoPicturesTest, TurnsAreRobosuites) {
  const absl::StatusOr<SafetensorsFile> file =
      SafetensorsFile::Open(Originals::Get().folder + "/turns.safetensors");
  ASSERT_TRUE(file.ok()) << file.status();
  const std::vector<double> quats = *file->ReadDoubles("quats", {-1, 4}),
                            turns = *file->ReadDoubles("turns", {-1, 3});
  ASSERT_GT(quats.size(), 4000u);
  for (size_t i = 0; i < quats.size() / 4; ++i) {
    const double* q = quats.data() + 4 * i;
    const double wxyz[] = {q[3], q[0], q[1], q[2]};
    const Eigen::Vector3d ours = AxisAngleAsRobosuite(wxyz);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(ours[k], turns[3 * i + k], 1e-12) << i;
  }
}

// As LeRobot resets: seed 1000 + k, after one reset more.
TEST_F(LiberoPicturesTest, FixturesStandWhereLerobotsResetsPutThem) {
  for (const auto& [suite, task] : kScenes) {
    const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(FileOf(suite, task));
    ASSERT_TRUE(file.ok()) << file.status();
    UnitConfig unit = OriginalsUnit(suite, Originals::Get().site);
    unit.libero_fixtures = "numpy-each:1000";
    const auto ours = LiberoSimTask::Create(unit, task);
    ASSERT_TRUE(ours.ok()) << ours.status();
    for (const int trial : {0, 1}) {
      ASSERT_TRUE((*ours)->Reset(trial).ok());
      for (const FixturePose& pose : (*ours)->scene().centred_fixtures) {
        const absl::StatusOr<std::vector<double>> theirs =
            file->ReadDoubles(absl::StrCat("reseeded.", trial, ".fixture.", pose.fixture), {7});
        ASSERT_TRUE(theirs.ok()) << theirs.status();
        const int body = (*ours)->scene().objects.at(pose.fixture).body;
        for (int i = 0; i < 3; ++i)
          EXPECT_EQ((*ours)->placed_model().body_pos[3 * body + i], (*theirs)[i]) << pose.fixture;
      }
    }
  }
}

}  // namespace
}  // namespace robostress::libero
