#include "common/libero/demonstrations.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using View = LiberoDemonstrationFile::View;

// Of this process: two builds may run the test at once.
std::string TempPath(const std::string& name) {
  return absl::StrCat(::testing::TempDir(), "/", getpid(), "_", name);
}

// Values that say where they belong: column c of row t is base + t + c / 100.
std::vector<double> Ramp(double base, int64_t steps, int64_t width) {
  std::vector<double> values;
  for (int64_t t = 0; t < steps; ++t) {
    for (int64_t c = 0; c < width; ++c) values.push_back(base + t + 0.01 * c);
  }
  return values;
}

LiberoDemonstration MakeDemonstration(int64_t steps, bool ours = true) {
  LiberoDemonstration demonstration;
  LiberoColumns& columns = demonstration.columns;
  columns.steps = steps;
  columns.actions = Ramp(0, steps, 7);
  columns.states = Ramp(10, steps, 33);
  columns.robot_states = Ramp(20, steps, 9);
  columns.ee_pos = Ramp(30, steps, 3);
  columns.ee_ori = Ramp(40, steps, 3);
  columns.gripper_states = Ramp(50, steps, 2);
  columns.joint_states = Ramp(60, steps, 7);
  if (ours) {
    columns.proprioception = Ramp(70, steps, 8);
    columns.aux = Ramp(80, steps, 8);
  }
  for (int64_t t = 0; t < steps; ++t) {
    Image image{8, 12, std::vector<uint8_t>(3 * 8 * 12)};
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = static_cast<uint8_t>(i / (3 * 8) * 10 + t);  // row * 10 + t
    demonstration.agentview.push_back(image);
    for (uint8_t& value : image.data) value += 100;
    demonstration.eye_in_hand.push_back(image);
  }
  demonstration.model_file = "<mujoco/>";
  return demonstration;
}

std::string WriteFile(const std::string& name, bool ours = true) {
  const std::string path = TempPath(name);
  std::filesystem::remove(path);  // of an earlier run
  auto writer = LiberoDemonstrationWriter::Create(
      path, {"tabletop_goal", "turn_on_the_stove", "turn on the stove"});
  EXPECT_TRUE(writer.ok()) << writer.status();
  for (int i = 0; i < 11; ++i) EXPECT_TRUE(writer->Add(MakeDemonstration(3 + i, ours)).ok());
  EXPECT_FALSE(std::filesystem::exists(path)) << "it appears when it is whole";
  const absl::Status published = writer->Publish();
  EXPECT_TRUE(published.ok()) << published;
  return path;
}

TEST(LiberoDemonstrations, AFailureIsDoneWithoutAReward) {
  const std::string path = TempPath("libero_failure.hdf5");
  std::filesystem::remove(path);
  auto writer = LiberoDemonstrationWriter::Create(path, {"suite", "task", "do it"});
  LiberoDemonstration failure = MakeDemonstration(4);
  failure.success = false;
  failure.columns.sent = Ramp(5, 4, 7);
  ASSERT_TRUE(writer->Add(MakeDemonstration(4)).ok() && writer->Add(failure).ok());
  ASSERT_TRUE(writer->Publish().ok());
  const auto file = Hdf5File::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  for (const int64_t row : {0, 3}) {
    for (const int demo : {0, 1}) {
      uint8_t reward = 9, done = 9;
      const std::string group = absl::StrCat("data/demo_", demo);
      ASSERT_TRUE(file->ReadByteRow(group + "/rewards", row, absl::MakeSpan(&reward, 1)).ok());
      ASSERT_TRUE(file->ReadByteRow(group + "/dones", row, absl::MakeSpan(&done, 1)).ok());
      EXPECT_EQ(done, row == 3);
      EXPECT_EQ(reward, row == 3 && demo == 0);
    }
  }
  EXPECT_EQ(*file->ReadDoubles("data/demo_1/actions_sent", {4, 7}, 4), failure.columns.sent);
  EXPECT_FALSE(file->Has("data/demo_0/actions_sent"));
}

TEST(LiberoDemonstrations, ReadBackAsWritten) {
  const auto file = LiberoDemonstrationFile::Open(WriteFile("libero_back.hdf5"));
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->instruction(), "turn on the stove");
  ASSERT_EQ(file->demonstrations(), 11);
  EXPECT_EQ(file->steps(2), 5) << "demo_10 comes after demo_2";
  EXPECT_EQ(file->steps(10), 13);
  EXPECT_TRUE(file->has_aux());
  const LiberoColumns columns = file->ReadColumns(2).value();
  const LiberoColumns expected = MakeDemonstration(5).columns;
  EXPECT_EQ(columns.actions, expected.actions);
  EXPECT_EQ(columns.ee_pos, expected.ee_pos);
  EXPECT_EQ(columns.ee_ori, expected.ee_ori);
  EXPECT_EQ(columns.gripper_states, expected.gripper_states);
  EXPECT_EQ(columns.joint_states, expected.joint_states);
  EXPECT_EQ(columns.proprioception, expected.proprioception);
  EXPECT_EQ(columns.aux, expected.aux);
  EXPECT_EQ(file->ReadView(2, View::kAgent, 4)->data, MakeDemonstration(5).agentview[4].data);
  EXPECT_EQ(file->ReadView(2, View::kEyeInHand, 1)->data, MakeDemonstration(5).eye_in_hand[1].data);
}

TEST(LiberoDemonstrations, StoreTheBottomRowFirst) {
  const std::string path = WriteFile("libero_rows.hdf5");
  const Hdf5File file = Hdf5File::Open(path).value();
  std::vector<uint8_t> row(3 * 8 * 12);
  ASSERT_TRUE(file.ReadByteRow("data/demo_0/obs/agentview_rgb", 1, absl::MakeSpan(row)).ok());
  EXPECT_EQ(row.front(), 111) << "row 11 of image 1";
  EXPECT_EQ(row.back(), 1);
  EXPECT_EQ(file.StringAttribute("data", "macros_image_convention").value(), "opengl");
  EXPECT_EQ(file.IntAttribute("data", "num_demos").value(), 11);
  EXPECT_EQ(file.IntAttribute("data", "total").value(), 11 * 8);
}

TEST(LiberoDemonstrations, SayWhetherActionsAreTargets) {
  for (const bool absolute : {false, true}) {
    const std::string path = TempPath("absolute.hdf5");
    std::filesystem::remove(path);
    auto writer = LiberoDemonstrationWriter::Create(path, {"piper", "task", "do", 30, absolute});
    ASSERT_TRUE(writer.ok() && writer->Add(MakeDemonstration(3)).ok() && writer->Publish().ok());
    EXPECT_EQ(LiberoDemonstrationFile::Open(path)->absolute_actions(), absolute);
  }
  EXPECT_FALSE(LiberoDemonstrationFile::Open(WriteFile("delta.hdf5"))->absolute_actions());
}

TEST(LiberoDemonstrations, DoWithoutWhatThisProjectAdds) {
  const auto file = LiberoDemonstrationFile::Open(WriteFile("libero_plain.hdf5", false));
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_FALSE(file->has_aux());
  EXPECT_FALSE(file->has_proprioception());
  EXPECT_TRUE(file->ReadColumns(0)->proprioception.empty());
}

// A file whose parts can be spoilt one by one; `change` writes what stands out.
std::string Refusal(const std::string& name, const std::function<void(Hdf5File&)>& write) {
  const std::string path = TempPath("libero_bad_" + name + ".hdf5");
  Hdf5File file = Hdf5File::Create(path).value();
  write(file);
  EXPECT_TRUE(file.Publish().ok());
  const auto opened = LiberoDemonstrationFile::Open(path);
  absl::Status status = opened.status();
  if (opened.ok()) status = opened->ReadColumns(0).status();
  EXPECT_FALSE(status.ok()) << name;
  EXPECT_THAT(std::string(status.message()), HasSubstr(path));
  return std::string(status.message());
}

TEST(LiberoDemonstrations, RefuseWhatDoesNotFitWithFileFieldAndValue) {
  const auto head = [](Hdf5File& file) {
    EXPECT_TRUE(file.SetAttribute("data", "problem_info",
                                  std::string(R"({"language_instruction": ["a", "b"]})"))
                    .ok());
  };
  const auto demo = [&](Hdf5File& file, int64_t samples, int64_t rows, double value) {
    head(file);
    const std::vector<uint8_t> images(2 * 8 * 8 * 3);
    for (const char* view : {"agentview_rgb", "eye_in_hand_rgb"}) {
      ASSERT_TRUE(
          file.WriteBytes(absl::StrCat("data/demo_0/obs/", view), {2, 8, 8, 3}, images).ok());
    }
    ASSERT_TRUE(file.SetAttribute("data/demo_0", "num_samples", samples).ok());
    const std::vector<double> actions(rows * 7, value);
    ASSERT_TRUE(file.WriteDoubles("data/demo_0/actions", {rows, 7}, actions).ok());
  };
  EXPECT_THAT(Refusal("no_task",
                      [](Hdf5File& file) {
                        EXPECT_TRUE(file.SetAttribute("data", "tag", std::string("x")).ok());
                      }),
              HasSubstr("data@problem_info is missing"));
  EXPECT_THAT(
      Refusal("no_words",
              [](Hdf5File& file) {
                EXPECT_TRUE(file.SetAttribute("data", "problem_info", std::string("{}")).ok());
              }),
      HasSubstr("no language_instruction"));
  EXPECT_THAT(Refusal("empty", head), HasSubstr("holds 0 demonstrations"));
  EXPECT_THAT(Refusal("samples", [&](Hdf5File& file) { demo(file, 3, 2, 0); }),
              AllOf(HasSubstr("num_samples is 3"), HasSubstr("images are 2")));
  EXPECT_THAT(Refusal("rows", [&](Hdf5File& file) { demo(file, 2, 5, 0); }),
              AllOf(HasSubstr("data/demo_0/actions is [5,7]"), HasSubstr("must be [2,7]")));
  EXPECT_THAT(Refusal("nan", [&](Hdf5File& file) { demo(file, 2, 2, std::nan("")); }),
              HasSubstr("data/demo_0/actions holds nan at 0"));
  EXPECT_THAT(
      Refusal(
          "views",
          [&](Hdf5File& file) {
            head(file);
            const std::vector<uint8_t> bytes(2 * 8 * 8);
            ASSERT_TRUE(file.WriteBytes("data/demo_0/obs/agentview_rgb", {2, 8, 8}, bytes).ok());
          }),
      AllOf(HasSubstr("agentview_rgb is [2,8,8]"), HasSubstr("uint8 [T,H,W,3]")));
}

TEST(LiberoDemonstrations, RefuseTruncatedAndForeignFiles) {
  const std::string whole = ReadFile(WriteFile("libero_whole.hdf5")).value();
  const std::string path = TempPath("libero_cut.hdf5");
  for (const size_t length :
       {size_t{0}, size_t{7}, size_t{600}, whole.size() / 2, whole.size() - 1}) {
    ASSERT_TRUE(WriteFileAtomically(path, whole.substr(0, length)).ok());
    const auto file = LiberoDemonstrationFile::Open(path);
    ASSERT_FALSE(file.ok()) << length;
    EXPECT_THAT(std::string(file.status().message()), HasSubstr(path));
  }
  EXPECT_TRUE(absl::IsNotFound(LiberoDemonstrationFile::Open("/nowhere.hdf5").status()));
}

// Files that only another writer makes: h5py, where it is installed.
TEST(LiberoDemonstrations, RefuseLinksAndSizesThatAreNotThere) {
  if (std::system("/usr/bin/python3 -c 'import h5py' 2>/dev/null") != 0)
    GTEST_SKIP() << "python3-h5py is not installed";
  const std::string script = TempPath("libero_hostile.py");
  ASSERT_TRUE(WriteFileAtomically(script, R"py(
import h5py, json, sys
for kind in "huge soft external storage text".split():
    f = h5py.File(sys.argv[1] + kind + ".hdf5", "w")
    d = f.create_group("data")
    d.attrs["problem_info"] = json.dumps({"language_instruction": "x"})
    o = d.create_group("demo_0/obs")
    if kind == "huge":
        o.create_dataset("agentview_rgb", (90000, 2048, 2048, 3), "u1", chunks=(1, 2048, 2048, 3))
    elif kind == "soft":
        o["agentview_rgb"] = h5py.SoftLink("/elsewhere")
    elif kind == "external":
        o["agentview_rgb"] = h5py.ExternalLink("/etc/passwd", "/x")
    elif kind == "storage":
        o.create_dataset("agentview_rgb", (2, 8, 8, 3), "u1", external=[("/etc/passwd", 0, 384)])
    elif kind == "text":
        o.create_dataset("agentview_rgb", data=["a", "b"])
    f.close()
)py")
                  .ok());
  const std::string stem = TempPath("libero_hostile_");
  ASSERT_EQ(std::system(absl::StrCat("/usr/bin/python3 ", script, " ", stem).c_str()), 0);
  const auto refusal = [&](const std::string& kind) {
    const std::string path = absl::StrCat(stem, kind, ".hdf5");
    const auto file = LiberoDemonstrationFile::Open(path);
    EXPECT_FALSE(file.ok()) << kind;
    EXPECT_THAT(std::string(file.status().message()),
                AllOf(HasSubstr(path), HasSubstr("data/demo_0/obs/agentview_rgb")));
    return std::string(file.status().message());
  };
  EXPECT_THAT(refusal("huge"), HasSubstr("bytes and stores 0"));
  EXPECT_THAT(refusal("soft"), HasSubstr("link to elsewhere"));
  EXPECT_THAT(refusal("external"), HasSubstr("link to elsewhere"));
  EXPECT_THAT(refusal("storage"), HasSubstr("stored in other files"));
  EXPECT_THAT(refusal("text"), HasSubstr("neither integers nor floats"));
}

// The independent reader: h5py, as LIBERO's own code uses it.
TEST(LiberoDemonstrations, AreWhatH5pyReads) {
  if (std::system("/usr/bin/python3 -c 'import h5py' 2>/dev/null") != 0)
    GTEST_SKIP() << "python3-h5py is not installed";
  const std::string path = WriteFile("libero_h5py.hdf5"), script = TempPath("libero_h5py.py");
  ASSERT_TRUE(WriteFileAtomically(script, R"py(
import h5py, json, numpy as np, sys
f = h5py.File(sys.argv[1], "r")
d = f["data"]
assert json.loads(d.attrs["problem_info"])["language_instruction"] == "turn on the stove"
assert json.loads(d.attrs["env_args"])["problem_name"] == "tabletop_goal"
assert d.attrs["num_demos"] == 11 == len(d.keys()) and d.attrs["total"] == 88
for i in range(11):
    e, T = d[f"demo_{i}"], 3 + i
    assert e.attrs["num_samples"] == T and e.attrs["model_file"] == "<mujoco/>"
    assert np.array_equal(e.attrs["init_state"], e["states"][0]) and e["states"].shape == (T, 33)
    assert np.allclose(e["actions"][()], np.arange(T)[:, None] + 0.01 * np.arange(7))
    assert e["robot_states"].shape == (T, 9) and e["rewards"].dtype == np.uint8
    assert e["dones"][()].sum() == 1 and e["dones"][-1] == 1
    o = e["obs"]
    assert np.array_equal(np.hstack((o["ee_pos"], o["ee_ori"])), o["ee_states"])
    assert o["joint_states"].shape == (T, 7) and o["gripper_states"].shape == (T, 2)
    for k, base in (("agentview_rgb", 0), ("eye_in_hand_rgb", 100)):
        assert o[k].dtype == np.uint8 and o[k].shape == (T, 12, 8, 3)
        assert o[k][1, 0, 0, 0] == base + 111 and o[k][1, 11, 7, 2] == base + 1
)py")
                  .ok());
  EXPECT_EQ(std::system(absl::StrCat("/usr/bin/python3 ", script, " ", path).c_str()), 0);
}

// LIBERO's readers make an environment of the class that problem_name says.
TEST(LiberoDemonstrations, OfLiberosSuitesNameItsClassAndItsFile) {
  if (std::system("/usr/bin/python3 -c 'import h5py' 2>/dev/null") != 0)
    GTEST_SKIP() << "python3-h5py is not installed";
  const std::string path = TempPath("libero_named.hdf5"), script = TempPath("libero_named.py");
  std::filesystem::remove(path);
  auto writer =
      LiberoDemonstrationWriter::Create(path, {.suite = "libero_goal",
                                               .task = "push",
                                               .instruction = "push",
                                               .problem = "libero_tabletop_manipulation"});
  LiberoDemonstration demonstration = MakeDemonstration(4);
  demonstration.initial_state = 1008;
  ASSERT_TRUE(writer->Add(demonstration).ok());
  ASSERT_TRUE(writer->Publish().ok());
  ASSERT_TRUE(WriteFileAtomically(script, R"py(
import h5py, json, sys
d = h5py.File(sys.argv[1], "r")["data"]
for name in ("problem_info", "env_args"):
    assert json.loads(d.attrs[name])["problem_name"] == "libero_tabletop_manipulation"
assert d.attrs["env_name"] == "libero_tabletop_manipulation"
assert d.attrs["bddl_file_name"] == "bddl_files/libero_goal/push.bddl"
assert d["demo_0"].attrs["initial_state"] == 1008
)py")
                  .ok());
  EXPECT_EQ(std::system(absl::StrCat("/usr/bin/python3 ", script, " ", path).c_str()), 0);
}

}  // namespace
}  // namespace robostress
