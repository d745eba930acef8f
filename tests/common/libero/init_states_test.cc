#include "common/libero/init_states.h"

#include <gmock/gmock.h>

#include <cmath>
#include <cstring>
#include <filesystem>

#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "tests/common/libero/init_file.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using namespace std::string_literals;
using ::testing::AnyOf;
using ::testing::HasSubstr;

const std::vector<double> kValues = {0, 1.5, -2.25, 1e-300, 3.141592653589793, -0.0};

std::string ErrorOf(const std::string& bytes) {
  const absl::StatusOr<InitStates> states = ParseInitStates("task.pruned_init", bytes);
  return states.ok() ? "read" : std::string(states.status().message());
}

TEST(InitStatesTest, ReadsAMatrixBitForBit) {
  const absl::StatusOr<InitStates> states =
      ParseInitStates("a", Zip("archive/data.pkl", Pickle(kValues, 2, 3)));
  ASSERT_TRUE(states.ok()) << states.status();
  EXPECT_EQ(states->rows, 2);
  EXPECT_EQ(states->columns, 3);
  // NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): bit by bit
  EXPECT_EQ(std::memcmp(states->values.data(), kValues.data(), sizeof(double) * 6), 0);
  EXPECT_EQ(states->row(1)[0], 1e-300);
  EXPECT_TRUE(CheckEpisodeRows(*states, 1, 1).ok());
  EXPECT_THAT(std::string(CheckEpisodeRows(*states, 1, 2).message()),
              HasSubstr("from states 1 to 2, and a has states 0 to 1; give fewer episodes, begin"));
  EXPECT_THAT(std::string(CheckEpisodeRows(*states, 2147483647, 2).message()),
              HasSubstr("states 2147483647 to 2147483648, and a has states 0 to 1; begin with an"));
}

TEST(InitStatesTest, ReadsAnNpzStoredOrDeflated) {
  for (const uint16_t method : {0, 8}) {
    const absl::StatusOr<InitStates> states =
        ParseInitStates("a", Zip("states.npy", Npy(kValues, "2, 3"), method));
    ASSERT_TRUE(states.ok()) << states.status();
    EXPECT_EQ(states->rows, 2);
    // NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): bit by bit
    EXPECT_EQ(std::memcmp(states->values.data(), kValues.data(), sizeof(double) * 6), 0);
  }
}

TEST(InitStatesTest, AnNpzThatIsNotAMatrixOfStatesSaysWhatItIs) {
  const auto error = [](const std::string& npy) { return ErrorOf(Zip("states.npy", npy, 8)); };
  EXPECT_THAT(error(Npy({}, "0,", "True")), HasSubstr("empty or stored by columns"));
  EXPECT_THAT(error(Npy({}, "0, 3")), HasSubstr("shape (0, 3) is not"));
  EXPECT_THAT(error(Npy(kValues, "6,")), HasSubstr("is not [rows, columns]"));
  EXPECT_THAT(error(Npy(kValues, "3, 3")), HasSubstr("shape (3, 3) needs 72 bytes, got 48"));
  EXPECT_THAT(error(Npy(kValues, "99999999, 99999999")), HasSubstr("of a sensible size"));
  EXPECT_THAT(error(Npy(kValues, "2, 3", "False", ">f8")), HasSubstr("little-endian float64"));
  EXPECT_THAT(error(Npy(kValues, "2, 3").substr(0, 40)), HasSubstr("cut off"));
  EXPECT_THAT(error("no numbers"), HasSubstr("no .npy in the zip"));
  std::string zip = Zip("states.npy", Npy(kValues, "2, 3"), 8);
  zip[60] ^= 0x40;
  EXPECT_THAT(ErrorOf(zip), AnyOf(HasSubstr("does not unpack"), HasSubstr("checksum")));
}

TEST(InitStatesTest, AnEntryThatUnpacksToTooMuchIsRefusedUnread) {
  std::string zip = Zip("states.npy", std::string(1000, 'x'), 8);
  const size_t directory = zip.find("PK\x01\x02");
  zip.replace(directory + 24, 4, "\xff\xff\xff\x7f");
  EXPECT_THAT(ErrorOf(zip), HasSubstr("has 2147483647 bytes, at most"));
}

TEST(InitStatesTest, RefusesWhatCouldExecute) {
  const std::string good = Pickle(kValues, 2, 3);
  // A name that Python would import and call.
  const std::string system =
      std::string("\x80\x02", 2) + "cos\nsystem\n" + Unicode("id") + "\x85R.";
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", system)),
              HasSubstr("the name 'os.system' is not on the list"));
  for (const char opcode : std::string("oi\x81\x82\x93]}luseaQP0")) {
    const std::string pickle = good.substr(0, 2) + opcode + good.substr(2);
    EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", pickle)), HasSubstr("is not on the list"))
        << static_cast<int>(opcode);
  }
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", absl::StrReplaceAll(good, {{"f8", "O8"}}))),
              HasSubstr("type 'O8'"));
}

// Found by fuzzing: tuples nested this deep overflowed the stack when they were released.
TEST(InitStatesTest, RefusesTuplesThatNestWithoutEnd) {
  const std::string nested =
      std::string("\x80\x02K\0", 4) + std::string(300000, '\x85') + "." + std::string(4, ' ');
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", nested)),
              HasSubstr("byte 259 of data.pkl: more than 256 opcodes"));
}

// Each encoding of a remembered text copies it: a small file could ask for any amount of memory.
TEST(InitStatesTest, RefusesToEncodeOneTextManyTimes) {
  std::string pickle = std::string("\x80\x02", 2) + "c_codecs\nencode\nq" + '\1';
  pickle += Unicode(std::string(1000, 'a')) + "q" + '\2' + Unicode("latin1") + "q" + '\3';
  for (int i = 0; i < 20; ++i)
    pickle += std::string("h") + '\1' + "h" + '\2' + "h" + '\3' + "\x86R";
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", pickle)),
              HasSubstr("encodes more text than the pickle holds"));
}

TEST(InitStatesTest, ErrorsNameFileAndPlace) {
  const std::string good = Pickle(kValues, 2, 3);
  EXPECT_THAT(ErrorOf("hello"), HasSubstr("task.pruned_init: 5 bytes are too few"));
  EXPECT_THAT(ErrorOf(std::string(100, 'x')), HasSubstr("not a zip file"));
  EXPECT_THAT(ErrorOf(Zip("archive/other", good)),
              HasSubstr("no entry ends in '/data.pkl' or 'states.npy'"));
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", good, 9)), HasSubstr("compressed by method 9"));
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", Pickle(kValues, 3, 3))),
              HasSubstr("shape [3, 3] needs 72 bytes, got 48"));
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", good.substr(0, good.size() - 1))),
              HasSubstr("without STOP"));
  std::string flipped = Zip("archive/data.pkl", good);
  flipped[100] ^= 1;
  EXPECT_THAT(ErrorOf(flipped), HasSubstr("checksum"));
  EXPECT_THAT(ErrorOf(Zip("archive/data.pkl", Pickle({0, NAN, 0, 0, 0, 0}, 2, 3))),
              HasSubstr("row 0, column 1 is nan, must be -1e+06 to 1e+06"));
}

TEST(InitStatesTest, ARowOfTheWrongLengthNamesFileAndSizes) {
  const absl::StatusOr<InitStates> states =
      ParseInitStates("task.pruned_init", Zip("archive/data.pkl", Pickle(kValues, 2, 3)));
  ASSERT_TRUE(states.ok());
  EXPECT_TRUE(CheckInitStates(*states, 1, 1).ok());
  EXPECT_THAT(CheckInitStates(*states, 41, 37).message(),
              HasSubstr("task.pruned_init: rows have 3 values, the composed model needs 1 + nq + "
                        "nv = 1 + 41 + 37 = 79"));
}

TEST(InitStatesTest, APoseThatIsNoneNamesRowBodyAndColumns) {
  const auto error = [](const std::vector<double>& pose) {
    std::vector<double> values(18, 0);  // two rows of time, a joint, a body's pose
    values[5] = 1;
    std::copy(pose.begin(), pose.end(), values.begin() + 11);
    const absl::StatusOr<InitStates> states =
        ParseInitStates("task.pruned_init", Zip("archive/data.pkl", Pickle(values, 2, 9)));
    return std::string(CheckFreeBodies(*states, {{"mug_1", 1}}).message());
  };
  const double half = std::sqrt(0.5);
  EXPECT_EQ(error({-3, 4, 1, half, 0, 0, -half}), "");
  EXPECT_THAT(error({0, 0, 0, 0, 0, 0, 0}),
              HasSubstr("task.pruned_init: row 1: the quaternion of 'mug_1', columns 5 to 8, has "
                        "norm 0, must be 1"));
  EXPECT_THAT(error({0, 0, 0, 0, 0, 5, 0}), HasSubstr("has norm 5"));
  EXPECT_THAT(error({0, 9e5, 0, 1, 0, 0, 0}),
              HasSubstr("row 1: the position of 'mug_1', columns 2 to 4, is 900000 m from"));
}

TEST(InitStatesTest, AJointFarOutOfItsLimitsIsNamed) {
  const auto error = [](double value) {
    const absl::StatusOr<InitStates> states = ParseInitStates(
        "task.pruned_init", Zip("archive/data.pkl", Pickle({0, 0.1, 0, 0, value, 0}, 2, 3)));
    return std::string(CheckLimitedJoints(*states, {{"drawer", 0, -0.16, 0}}).message());
  };
  EXPECT_EQ(error(-0.16), "");
  EXPECT_EQ(error(0.09), "");
  EXPECT_THAT(error(90), HasSubstr("task.pruned_init: row 1: joint 'drawer', column 1, is 90, its "
                                   "limits are -0.16 and 0"));
  EXPECT_THAT(error(-0.3), HasSubstr("row 1: joint 'drawer'"));
}

TEST(InitStatesTest, SurvivesDamagedFiles) {
  const std::string pickle = Pickle(kValues, 2, 3);
  RandomStream random(StreamKey("init states damage"));
  for (int i = 0; i < 5000; ++i) {
    // Damage inside the pickle under a correct checksum, and damage to the container.
    std::string inner = pickle;
    for (int k = 0; k <= i % 3; ++k)
      inner[random.UniformInt(static_cast<int>(inner.size()))] =
          static_cast<char>(random.UniformInt(256));
    (void)ParseInitStates("a", Zip("archive/data.pkl", inner));
    std::string outer = Zip("archive/data.pkl", pickle);
    outer[random.UniformInt(static_cast<int>(outer.size()))] =
        static_cast<char>(random.UniformInt(256));
    if (i % 2 == 0) outer.resize(random.UniformInt(static_cast<int>(outer.size())));
    (void)ParseInitStates("a", outer);
    std::string npz = Zip("states.npy", Npy(kValues, "2, 3"), i % 2 == 0 ? 8 : 0);
    npz[random.UniformInt(static_cast<int>(npz.size()))] =
        static_cast<char>(random.UniformInt(256));
    (void)ParseInitStates("a", npz);
  }
}

TEST(InitStatesTest, ReadsEveryTaskOfTheFourSuites) {
  SKIP_WITHOUT_SHARED_DATA();
  int files = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(LiberoTree() + "/libero/libero/init_files")) {
    if (entry.path().extension() != ".pruned_init") continue;
    const absl::StatusOr<InitStates> states = ReadInitStates(entry.path());
    ASSERT_TRUE(states.ok()) << states.status();
    EXPECT_EQ(states->rows, 50);
    EXPECT_EQ(states->row(0)[0], 0) << "time";
    ++files;
  }
  EXPECT_EQ(files, 40);
}

}  // namespace
}  // namespace robostress::libero
