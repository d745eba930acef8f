#include "common/recordings/recording.h"

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/recordings/bag_folder.h"
#include "common/recordings/byte_source.h"
#include "common/recordings/csv_recording.h"
#include "common/recordings/db3_reader.h"
#include "common/recordings/hdf5_recording.h"
#include "common/recordings/lerobot_recording.h"
#include "common/recordings/mcap_reader.h"
#include "common/recordings/ros_recording.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// Of a bag whose messages are packed one by one.
absl::Status TakeMessage(bool packed, size_t topic, int64_t log_ns, absl::string_view data,
                         const std::string& path, RosRecording* recording) {
  if (!packed) return recording->Take(topic, log_ns, data);
  const auto inflated = InflateBlock("zstd", data, RosRecording::kMostMessage);
  if (!inflated.ok())
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": a message at ", log_ns, " ns ", inflated.status().message()));
  return recording->Take(topic, log_ns, *inflated);
}

absl::Status ReadMcap(const std::string& path, bool messages_packed, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<McapReader> reader, McapReader::Open(path));
  RosRecording recording(path, rows);
  std::map<uint16_t, size_t> topics;  // of the file's channels
  McapMessage message;
  while (true) {
    RS_ASSIGN_OR_RETURN(const bool found, reader->Next(&message));
    if (!found) break;
    auto topic = topics.find(message.channel);
    if (topic == topics.end()) {
      const McapChannel& channel = reader->channel(message.channel);
      const McapSchema* schema = reader->schema(channel.schema);
      RosTopic declared{channel.topic, "", channel.encoding, "", {}};
      if (schema != nullptr) {
        declared.type = schema->name;
        declared.schema_encoding = schema->encoding;
        declared.schema = schema->text;
      }
      RS_ASSIGN_OR_RETURN(const size_t number, recording.AddTopic(declared));
      topic = topics.emplace(message.channel, number).first;
    }
    RS_RETURN_IF_ERROR(TakeMessage(messages_packed, topic->second,
                                   static_cast<int64_t>(message.log_time_ns), message.data, path,
                                   &recording));
  }
  recording.Finish();
  for (const std::string& note : reader->notes()) rows->visitor().OnNote(note);
  return absl::OkStatus();
}

absl::Status ReadDb3(const std::string& path, const std::string& name, bool messages_packed,
                     RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Db3Reader> reader, Db3Reader::Open(path));
  RosRecording recording(name, rows);
  std::map<int64_t, size_t> topics;
  for (const auto& [id, declared] : reader->topics()) {
    RS_ASSIGN_OR_RETURN(topics[id], recording.AddTopic(declared));
  }
  int64_t topic = 0, log_ns = 0;
  absl::string_view data;
  while (true) {
    RS_ASSIGN_OR_RETURN(const bool found, reader->Next(&topic, &log_ns, &data));
    if (!found) break;
    RS_RETURN_IF_ERROR(TakeMessage(messages_packed, topics[topic], log_ns, data, name, &recording));
  }
  recording.Finish();
  return absl::OkStatus();
}

// SQLite reads files only: a packed one is unpacked into the folder for temporary files first.
absl::Status ReadPackedDb3(const std::string& path, bool messages_packed, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<ByteSource> source, ByteSource::Open(path));
  std::error_code error;
  const fs::path folder = fs::temp_directory_path(error);
  if (error) {
    return absl::UnavailableError(absl::StrCat("cannot unpack ", path,
                                               ": no folder for temporary files: ", error.message(),
                                               "; set TMPDIR to one"));
  }
  std::string name = (folder / "robostress_bag_XXXXXX").string();
  const int handle = mkstemp(name.data());
  if (handle < 0)
    return absl::UnavailableError(
        absl::StrCat("cannot write '", name, "': ", std::strerror(errno)));
  const absl::Cleanup remove = [&] {
    close(handle);
    unlink(name.c_str());
  };
  std::string bytes;
  while (true) {
    RS_RETURN_IF_ERROR(source->Read(uint64_t{1} << 20, &bytes));
    if (bytes.empty()) break;
    if (write(handle, bytes.data(), bytes.size()) != static_cast<ssize_t>(bytes.size()))
      return absl::UnavailableError(absl::StrCat("cannot unpack ", path, " to '", name,
                                                 "': ", std::strerror(errno),
                                                 "; free some space, or set TMPDIR"));
  }
  return ReadDb3(name, path, messages_packed, rows);
}

absl::Status ReadBagFile(const std::string& path, bool messages_packed, RowStream* rows) {
  if (IsMcapName(path)) return ReadMcap(path, messages_packed, rows);
  if (IsZstdName(path)) return ReadPackedDb3(path, messages_packed, rows);
  return ReadDb3(path, path, messages_packed, rows);
}

absl::Status ReadBag(const std::string& folder, RowStream* rows) {
  RS_ASSIGN_OR_RETURN(const BagFolder bag, OpenBagFolder(folder));
  for (const std::string& note : bag.notes) rows->visitor().OnNote(note);
  for (const std::string& file : bag.files)
    RS_RETURN_IF_ERROR(ReadBagFile(file, bag.messages_packed, rows));
  return absl::OkStatus();
}

// In the order of their numbers.
std::vector<std::string> Hdf5Files(const std::string& folder) {
  std::vector<std::string> names = FilesByNumber(folder, IsHdf5Name);
  for (std::string& name : names) name = (fs::path(folder) / name).string();
  return names;
}

absl::Status Read(const std::string& path, const ReadRecordingOptions& options, RowStream* rows) {
  std::error_code error;
  if (fs::is_directory(path, error)) {
    if (IsLerobotFolder(path)) return ReadLerobotRecording(path, rows);
    if (IsBagFolder(path)) return ReadBag(path, rows);
    for (const std::string& file : Hdf5Files(path))
      RS_RETURN_IF_ERROR(ReadHdf5Recording(file, options.rate_hz, rows));
    return absl::OkStatus();
  }
  if (IsHdf5Name(path)) return ReadHdf5Recording(path, options.rate_hz, rows);
  if (absl::EndsWith(path, ".csv")) return ReadCsvRecording(path, rows);
  return ReadBagFile(path, false, rows);
}

}  // namespace

absl::StatusOr<std::string> KindOfRecording(const std::string& path) {
  std::error_code error;
  if (!fs::exists(path, error))
    return absl::NotFoundError(absl::StrCat("'", path, "' is not there"));
  if (fs::is_directory(path, error)) {
    if (IsLerobotFolder(path)) return "LeRobot data set";
    if (IsBagFolder(path)) return "rosbag2 folder";
    if (!Hdf5Files(path).empty()) return "folder of HDF5 files";
  } else {
    if (IsMcapName(path)) return "MCAP file";
    if (IsDb3Name(path)) return "rosbag2 file (.db3)";
    if (IsHdf5Name(path)) return "HDF5 file";
    if (absl::EndsWith(path, ".csv")) return "CSV file";
  }
  return absl::InvalidArgumentError(absl::StrCat(
      path, ": is no recording that is known: .mcap, .db3 (also .zstd), .hdf5, .csv, or a folder ",
      "of rosbag2, of LeRobot or of HDF5 files"));
}

absl::Status ReadRecording(const std::string& path, const ReadRecordingOptions& options,
                           RecordingVisitor* visitor) {
  RS_RETURN_IF_ERROR(KindOfRecording(path).status());
  RowStream rows(visitor);
  const absl::Status status = Read(path, options, &rows);
  // What is wrong with rows is said without their file.
  if (status.ok() || absl::StrContains(status.message(), path)) return status;
  return absl::Status(status.code(), absl::StrCat(path, ": ", status.message()));
}

}  // namespace robostress
