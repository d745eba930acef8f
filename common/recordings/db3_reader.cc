#include "common/recordings/db3_reader.h"

#include <sqlite3.h>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int kMostBytes = 256 << 20;            // of one message, as in an MCAP file
constexpr int64_t kLastTime = int64_t{1} << 62;  // [ns] year 2116

struct FinalizeStatement {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using StatementHandle = std::unique_ptr<sqlite3_stmt, FinalizeStatement>;

StatementHandle Prepare(sqlite3* database, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  sqlite3_prepare_v2(database, sql, -1, &statement, nullptr);
  return StatementHandle(statement);
}

std::string TextOf(sqlite3_stmt* statement, int column) {
  const unsigned char* const text = sqlite3_column_text(statement, column);
  return text == nullptr ? "" : std::string(reinterpret_cast<const char*>(text));
}

}  // namespace

absl::Status Db3Reader::Wrong(const std::string& what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(path_, ": ", what,
                   "; is it a whole bag of rosbag2? copy it again with its -wal file, if any"));
}

Db3Reader::~Db3Reader() {
  sqlite3_finalize(messages_);
  sqlite3_close(database_);
}

// An ordinary table: views and virtual tables have no pages of their own.
absl::StatusOr<bool> Db3Reader::HasTable(const char* name) const {
  const StatementHandle statement = Prepare(
      database_, "SELECT 1 FROM sqlite_master WHERE type='table' AND rootpage>0 AND name=?");
  if (statement == nullptr) return Wrong(sqlite3_errmsg(database_));
  sqlite3_bind_text(statement.get(), 1, name, -1, SQLITE_STATIC);
  const int code = sqlite3_step(statement.get());
  if (code != SQLITE_ROW && code != SQLITE_DONE) return Wrong(sqlite3_errmsg(database_));
  return code == SQLITE_ROW;
}

absl::StatusOr<std::unique_ptr<Db3Reader>> Db3Reader::Open(const std::string& path) {
  std::unique_ptr<Db3Reader> reader(new Db3Reader(path));
  if (sqlite3_open_v2(path.c_str(), &reader->database_, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX,
                      nullptr) != SQLITE_OK)
    return reader->Wrong(sqlite3_errmsg(reader->database_));
  sqlite3_limit(reader->database_, SQLITE_LIMIT_LENGTH, kMostBytes);
  sqlite3_db_config(reader->database_, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(reader->database_, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(reader->database_, SQLITE_DBCONFIG_ENABLE_TRIGGER, 0, nullptr);
  for (const char* table : {"topics", "messages"}) {
    RS_ASSIGN_OR_RETURN(const bool found, reader->HasTable(table));
    if (!found) return reader->Wrong(absl::StrCat("has no table ", table));
  }
  RS_RETURN_IF_ERROR(reader->ReadTopics());
  RS_RETURN_IF_ERROR(reader->ReadDefinitions());
  reader->messages_ =
      Prepare(reader->database_, "SELECT topic_id, timestamp, data FROM messages ORDER BY id")
          .release();
  if (reader->messages_ == nullptr)
    return reader->Wrong(absl::StrCat("table messages: ", sqlite3_errmsg(reader->database_)));
  return reader;
}

absl::Status Db3Reader::ReadTopics() {
  const StatementHandle statement =
      Prepare(database_, "SELECT id, name, type, serialization_format FROM topics");
  if (statement == nullptr) return Wrong(absl::StrCat("table topics: ", sqlite3_errmsg(database_)));
  int code = SQLITE_ROW;
  while ((code = sqlite3_step(statement.get())) == SQLITE_ROW) {
    topics_[sqlite3_column_int64(statement.get(), 0)] = {
        TextOf(statement.get(), 1), TextOf(statement.get(), 2), TextOf(statement.get(), 3), "", {}};
    if (topics_.size() > RowStream::kMostChannels)
      return Wrong(absl::StrCat("table topics has over ", RowStream::kMostChannels, " rows"));
  }
  if (code != SQLITE_DONE) return Wrong(absl::StrCat("table topics: ", sqlite3_errmsg(database_)));
  return absl::OkStatus();
}

// Bags since Iron hold the text of every type; an empty one was not found by the recorder.
absl::Status Db3Reader::ReadDefinitions() {
  RS_ASSIGN_OR_RETURN(const bool found, HasTable("message_definitions"));
  if (!found) return absl::OkStatus();
  const StatementHandle statement = Prepare(
      database_,
      "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type=?");
  if (statement == nullptr)
    return Wrong(absl::StrCat("table message_definitions: ", sqlite3_errmsg(database_)));
  for (auto& [id, topic] : topics_) {
    sqlite3_reset(statement.get());
    sqlite3_bind_text(statement.get(), 1, topic.type.c_str(), -1, SQLITE_TRANSIENT);
    const int code = sqlite3_step(statement.get());
    if (code != SQLITE_ROW && code != SQLITE_DONE)
      return Wrong(absl::StrCat("table message_definitions: ", sqlite3_errmsg(database_)));
    std::string text = code == SQLITE_ROW ? TextOf(statement.get(), 1) : "";
    if (text.empty()) continue;
    topic.schema_encoding = TextOf(statement.get(), 0);
    topic.schema = std::move(text);
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> Db3Reader::Next(int64_t* topic, int64_t* log_ns, absl::string_view* data) {
  const int code = sqlite3_step(messages_);
  if (code == SQLITE_DONE) return false;
  if (code != SQLITE_ROW) return Wrong(absl::StrCat("table messages: ", sqlite3_errmsg(database_)));
  *topic = sqlite3_column_int64(messages_, 0);
  *log_ns = sqlite3_column_int64(messages_, 1);
  const void* const bytes = sqlite3_column_blob(messages_, 2);
  *data = {static_cast<const char*>(bytes),
           bytes == nullptr ? 0 : static_cast<size_t>(sqlite3_column_bytes(messages_, 2))};
  if (topics_.count(*topic) == 0)
    return Wrong(absl::StrCat("table messages has topic_id ", *topic, ", table topics has not"));
  if (*log_ns < 0 || *log_ns > kLastTime)
    return Wrong(
        absl::StrCat("table messages has timestamp ", *log_ns, ", must be 0 to ", kLastTime));
  return true;
}

}  // namespace robostress
