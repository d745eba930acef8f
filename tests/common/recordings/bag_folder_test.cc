#include "common/recordings/bag_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "common/recordings/recording.h"
#include "tests/common/recordings/collected_rows.h"
#include "tests/common/recordings/recording_bytes.h"

namespace robostress::recording_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string EmptyFolder(const std::string& name) {
  const fs::path folder = fs::path(testing::TempDir()) / name;
  fs::remove_all(folder);
  fs::create_directories(folder);
  return folder.string();
}

void Write(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

std::string Metadata(const std::string& files, const std::string& rest = "") {
  return "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"
         "  relative_file_paths:\n" +
         files + rest;
}

std::string McapOf(int first, int count) {
  std::string bytes = McapMagic() + McapHeader() +
                      McapSchemaRecord(1, "sensor_msgs/msg/JointState", JointStateText()) +
                      McapChannelRecord(1, 1, "/joint_states");
  for (int i = first; i < first + count; ++i)
    bytes += McapMessageRecord(1, static_cast<uint64_t>(i),
                               JointStateBytes({100 + i, {"a"}, {1.0 * i}}));
  return bytes + McapEnd();
}

// A bag of rosbag2's sqlite3 storage, by its tables.
std::string Db3(const std::string& path, const std::string& type,
                const std::vector<std::string>& messages, const std::string& definition = "") {
  fs::remove(path);
  sqlite3* database = nullptr;
  EXPECT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  const std::string definitions =
      definition.empty()
          ? ""
          : "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, "
            "encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, "
            "type_description_hash TEXT NOT NULL); INSERT INTO message_definitions VALUES(1,'" +
                type + "','ros2msg','" + definition + "','');";
  EXPECT_EQ(
      sqlite3_exec(database,
                   ("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT "
                    "NULL, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
                    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
                    "timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
                    "INSERT INTO topics VALUES(4,'/joints','" +
                    type + "','cdr','');" + definitions)
                       .c_str(),
                   nullptr, nullptr, nullptr),
      SQLITE_OK);
  sqlite3_stmt* insert = nullptr;
  sqlite3_prepare_v2(database, "INSERT INTO messages VALUES(NULL,4,?,?)", -1, &insert, nullptr);
  for (size_t i = 0; i < messages.size(); ++i) {
    sqlite3_bind_int64(insert, 1, static_cast<int64_t>(i));
    sqlite3_bind_blob(insert, 2, messages[i].data(), static_cast<int>(messages[i].size()),
                      SQLITE_TRANSIENT);
    EXPECT_EQ(sqlite3_step(insert), SQLITE_DONE);
    sqlite3_reset(insert);
  }
  sqlite3_finalize(insert);
  sqlite3_close(database);
  return path;
}

absl::StatusOr<CollectedRows> Collect(const std::string& path) {
  CollectedRows rows;
  const absl::Status status = ReadRecording(path, {}, &rows);
  if (!status.ok()) return status;
  return rows;
}

std::string WhyRefused(const std::string& path) {
  const auto rows = Collect(path);
  EXPECT_FALSE(rows.ok());
  return std::string(rows.status().message());
}

TEST(BagFolderTest, ReadsSplitFilesInTheOrderOfTheMetadata) {
  const std::string folder = EmptyFolder("split_bag");
  Write(folder + "/x_0.mcap", McapOf(0, 2));
  Write(folder + "/x_1.mcap.zstd", Packed("zstd", McapOf(2, 2)));
  Write(folder + "/metadata.yaml",
        Metadata("    - x_0.mcap\n    - split_bag/x_1.mcap\n",
                 "  compression_format: zstd\n  compression_mode: FILE\n"));
  const auto rows = Collect(folder);
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 4);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(rows->rows[i].values.at("position a"), i);
  EXPECT_EQ(rows->channels.size(), 1) << "a topic of two files is one channel";
}

TEST(BagFolderTest, ReadsAFolderWithoutMetadataByNumbers) {
  const std::string folder = EmptyFolder("open_bag");
  for (const int i : {0, 2, 10}) Write(absl::StrCat(folder, "/bag_", i, ".mcap"), McapOf(i, 1));
  const auto rows = Collect(folder);
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 3);
  EXPECT_EQ(rows->rows[1].values.at("position a"), 2);
  EXPECT_EQ(rows->rows[2].values.at("position a"), 10);
  EXPECT_THAT(rows->notes, ElementsAre(HasSubstr("has no metadata.yaml")));
}

TEST(BagFolderTest, NamesTheFileThatIsMissingAndOtherCompressions) {
  const std::string folder = EmptyFolder("bad_bag");
  EXPECT_THAT(WhyRefused(folder), HasSubstr("is no recording that is known"));
  Write(folder + "/metadata.yaml", Metadata("    - ../../etc/passwd\n"));
  EXPECT_THAT(WhyRefused(folder), HasSubstr("relative_file_paths names 'passwd'"));
  Write(folder + "/x.mcap", McapOf(0, 1));
  Write(folder + "/metadata.yaml",
        Metadata("    - x.mcap\n", "  compression_format: lzma\n  compression_mode: FILE\n"));
  EXPECT_THAT(WhyRefused(folder), HasSubstr("compression_format is 'lzma'; read is zstd"));
  Write(folder + "/metadata.yaml", Metadata("    - x.mcap\n", "  compression_mode: odd\n"));
  EXPECT_THAT(WhyRefused(folder), HasSubstr("compression_mode is 'odd'"));
  Write(folder + "/metadata.yaml", "a: [");
  EXPECT_THAT(WhyRefused(folder), HasSubstr("metadata.yaml: not YAML"));
  Write(folder + "/metadata.yaml", "- 1");
  EXPECT_THAT(WhyRefused(folder), HasSubstr("has no rosbag2_bagfile_information"));
}

TEST(BagFolderTest, ReadsMessagesThatArePackedOneByOne) {
  const std::string folder = EmptyFolder("packed_messages");
  const std::string message = JointStateBytes({9, {"a"}, {0.25}});
  Db3(folder + "/x_0.db3", "sensor_msgs/msg/JointState", {Packed("zstd", message)});
  Write(folder + "/metadata.yaml",
        Metadata("    - x_0.db3\n", "  compression_format: zstd\n  compression_mode: MESSAGE\n"));
  const auto rows = Collect(folder);
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->rows.size(), 1);
  EXPECT_EQ(rows->rows[0].values.at("position a"), 0.25);
}

TEST(Db3ReaderTest, ReadsByTheFilesDefinitionAndElseByItsOwnAndSaysSo) {
  const std::string folder = EmptyFolder("db3");
  const std::vector<std::string> messages = {JointStateBytes({9, {"a"}, {0.25}, {}, {2}}),
                                             JointStateBytes({10, {"a"}, {0.5}, {}, {3}})};
  for (const std::string& definition : {std::string(), JointStateText()}) {
    const auto rows =
        Collect(Db3(folder + "/x.db3", "sensor_msgs/msg/JointState", messages, definition));
    ASSERT_TRUE(rows.ok()) << rows.status();
    ASSERT_EQ(rows->rows.size(), 2);
    EXPECT_EQ(rows->rows[1].values.at("position a"), 0.5);
    EXPECT_EQ(rows->rows[1].values.at("effort a"), 3);
    EXPECT_EQ(rows->rows[1].stamp_ns, 10);
    ASSERT_EQ(rows->notes.size(), definition.empty() ? 1 : 0);
    if (definition.empty()) {
      EXPECT_THAT(rows->notes[0], HasSubstr("read by this program's own"));
    }
  }
}

TEST(Db3ReaderTest, ReadsAFileThatIsPackedAsAWholeAndLeavesNoCopy) {
  const std::string folder = EmptyFolder("db3_packed");
  const std::string path =
      Db3(folder + "/x.db3", "sensor_msgs/msg/JointState", {JointStateBytes({9, {"a"}, {0.25}})});
  std::ifstream file(path, std::ios::binary);
  Write(path + ".zstd", Packed("zstd", {std::istreambuf_iterator<char>(file), {}}));
  const char* before = std::getenv("TMPDIR");
  const std::string kept = before == nullptr ? "" : before;
  setenv("TMPDIR", "/nonexistent", 1);
  EXPECT_THAT(std::string(Collect(path + ".zstd").status().message()),
              testing::HasSubstr("no folder for temporary files"));
  before == nullptr ? unsetenv("TMPDIR") : setenv("TMPDIR", kept.c_str(), 1);
  const auto rows = Collect(path + ".zstd");
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_EQ(rows->rows.size(), 1);
  for (const auto& entry : fs::directory_iterator(fs::temp_directory_path()))
    EXPECT_THAT(entry.path().string(), ::testing::Not(HasSubstr("robostress_bag_")));
}

TEST(Db3ReaderTest, LeavesOutMessagesThatCanNotBeReadAndSaysHowMany) {
  const std::string folder = EmptyFolder("db3_damaged");
  const auto rows = Collect(Db3(folder + "/x.db3", "sensor_msgs/msg/JointState",
                                {"rubbish", JointStateBytes({9, {"a"}, {0.25}}), "", "more"}));
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_EQ(rows->rows.size(), 1);
  EXPECT_THAT(rows->notes.back(), HasSubstr("/joints: 3 of 4 messages are left out; message 1:"));
}

TEST(Db3ReaderTest, RefusesWhatIsNoBag) {
  const std::string folder = EmptyFolder("db3_bad");
  Write(folder + "/text.db3", "no database, whatever its name says");
  EXPECT_THAT(WhyRefused(folder + "/text.db3"), HasSubstr("text.db3: "));
  sqlite3* database = nullptr;
  sqlite3_open((folder + "/view.db3").c_str(), &database);
  sqlite3_exec(database,
               "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);"
               "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i+1 FROM "
               "n) SELECT i AS id, 1 AS topic_id, i AS timestamp, x'' AS data FROM n;",
               nullptr, nullptr, nullptr);
  sqlite3_close(database);
  EXPECT_THAT(WhyRefused(folder + "/view.db3"), HasSubstr("has no table messages"));
  sqlite3_open((folder + "/odd.db3").c_str(), &database);
  sqlite3_exec(database,
               "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);"
               "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
               "INSERT INTO messages VALUES(1,7,1,x'');",
               nullptr, nullptr, nullptr);
  sqlite3_close(database);
  EXPECT_THAT(WhyRefused(folder + "/odd.db3"), HasSubstr("topic_id 7"));
}

}  // namespace
}  // namespace robostress::recording_test
