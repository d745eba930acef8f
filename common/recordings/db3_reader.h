#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/recordings/ros_recording.h"

struct sqlite3;
struct sqlite3_stmt;

namespace robostress {

// A .db3 file of rosbag2's sqlite3 storage: tables `topics` and `messages`, and, of newer ones,
// `message_definitions`. Messages come in the order in which they were written, one in memory at a
// time. The schema is not trusted: only ordinary tables are read. INVALID_ARGUMENT names file,
// table and value.
class Db3Reader {
 public:
  static absl::StatusOr<std::unique_ptr<Db3Reader>> Open(const std::string& path);
  ~Db3Reader();

  const std::map<int64_t, RosTopic>& topics() const { return topics_; }  // by their id
  // False at the end; `data` is valid until the next call.
  absl::StatusOr<bool> Next(int64_t* topic, int64_t* log_ns, absl::string_view* data);

 private:
  explicit Db3Reader(std::string path) : path_(std::move(path)) {}
  absl::Status Wrong(const std::string& what) const;
  absl::StatusOr<bool> HasTable(const char* name) const;
  absl::Status ReadTopics();
  absl::Status ReadDefinitions();

  const std::string path_;
  sqlite3* database_ = nullptr;
  sqlite3_stmt* messages_ = nullptr;
  std::map<int64_t, RosTopic> topics_;
};

}  // namespace robostress
