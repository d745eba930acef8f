#include "eval/store/store_index.h"

#include <sqlite3.h>
#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "eval/plan/plan.h"
#include "eval/store/run_directory.h"
#include "eval/store/unit_files.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr int kSchemaVersion = 1;
constexpr char kSchema[] =
    "DROP TABLE IF EXISTS units; DROP TABLE IF EXISTS episodes;"
    "CREATE TABLE units(store TEXT, unit TEXT, suite TEXT, scenario TEXT, severity INTEGER, policy "
    "TEXT, method TEXT, seed INTEGER, state TEXT, episodes INTEGER, successes INTEGER, updates "
    "INTEGER, wall_s REAL, model_hash TEXT, episodes_sha256 TEXT, machines TEXT, stamp TEXT, "
    "PRIMARY KEY(store, unit)) WITHOUT ROWID;"
    "CREATE TABLE episodes(store TEXT, unit TEXT, task INTEGER, episode INTEGER, initial_state "
    "INTEGER, success INTEGER, steps INTEGER, chunks INTEGER, updates INTEGER, residual REAL, "
    "intent REAL, PRIMARY KEY(store, unit, task, episode)) WITHOUT ROWID;";

struct CloseDatabase {
  void operator()(sqlite3* db) const { sqlite3_close(db); }
};
struct Finalize {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Database = std::unique_ptr<sqlite3, CloseDatabase>;

absl::Status Error(sqlite3* db, const std::string& what) {
  return absl::InternalError(absl::StrCat(what, ": ", sqlite3_errmsg(db),
                                          "; the index holds nothing of its own: delete it and run "
                                          "again"));
}

absl::Status Execute(sqlite3* db, const std::string& sql) {
  if (sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK)
    return absl::OkStatus();
  return Error(db, "SQLite");
}

// A prepared statement whose parameters are bound in order.
class Statement {
 public:
  Statement(sqlite3* db, const char* sql) : db_(db) {
    sqlite3_stmt* statement = nullptr;
    sqlite3_prepare_v2(db, sql, -1, &statement, nullptr);
    statement_.reset(statement);
  }
  Statement& operator<<(const std::string& value) {
    sqlite3_bind_text(statement_.get(), ++bound_, value.data(), static_cast<int>(value.size()),
                      SQLITE_TRANSIENT);
    return *this;
  }
  Statement& operator<<(int64_t value) {
    sqlite3_bind_int64(statement_.get(), ++bound_, value);
    return *this;
  }
  Statement& operator<<(const std::optional<double>& value) {
    if (value) {
      sqlite3_bind_double(statement_.get(), ++bound_, *value);
    } else {
      sqlite3_bind_null(statement_.get(), ++bound_);
    }
    return *this;
  }
  // True while there is a row.
  absl::StatusOr<bool> Step() {
    const int code = sqlite3_step(statement_.get());
    if (code == SQLITE_ROW) return true;
    const absl::Status status =
        code == SQLITE_DONE ? absl::OkStatus() : Error(db_, "SQLite cannot write");
    sqlite3_reset(statement_.get());
    bound_ = 0;
    if (!status.ok()) return status;
    return false;
  }
  std::string Text(int column) const {
    const auto* text = sqlite3_column_text(statement_.get(), column);
    return text == nullptr ? "" : reinterpret_cast<const char*>(text);
  }

 private:
  sqlite3* db_;
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
  int bound_ = 0;
};

// Changes whenever a file that the index reads does.
std::string Stamp(const std::string& folder) {
  std::string stamp;
  for (const char* name : {"/episodes.jsonl", "/DONE", "/config.yaml", "/machines.jsonl"}) {
    struct stat info {};
    if (stat((folder + name).c_str(), &info) != 0) {
      stamp += "- ";
      continue;
    }
    absl::StrAppend(&stamp, info.st_size, ":", info.st_mtim.tv_sec, ".", info.st_mtim.tv_nsec, ":",
                    info.st_ino, " ");
  }
  return stamp;
}

class Index {
 public:
  explicit Index(sqlite3* db)
      : db_(db),
        unit_(db, "INSERT OR REPLACE INTO units VALUES(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)"),
        episode_(db, "INSERT OR REPLACE INTO episodes VALUES(?,?,?,?,?,?,?,?,?,?,?)"),
        drop_unit_(db, "DELETE FROM units WHERE store=? AND unit=?"),
        drop_episodes_(db, "DELETE FROM episodes WHERE store=? AND unit=?") {}

  absl::Status Update(const std::string& store, IndexResult& result) {
    std::map<std::string, std::string> known;
    Statement query(db_, "SELECT unit, stamp FROM units WHERE store=?");
    query << store;
    while (true) {
      RS_ASSIGN_OR_RETURN(const bool row, query.Step());
      if (!row) break;
      known[query.Text(0)] = query.Text(1);
    }
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> folders, UnitFolders(store));
    for (const std::string& folder : folders) {
      const std::string id = fs::path(folder).filename().string(), stamp = Stamp(folder);
      const auto before = known.find(id);
      const bool same = before != known.end() && before->second == stamp;
      if (before != known.end()) known.erase(before);
      if (same) {
        ++result.unchanged;
        continue;
      }
      ++result.read;
      RS_RETURN_IF_ERROR(Write(store, InspectUnit(folder, texts_), stamp, result));
    }
    for (const auto& [id, stamp] : known) {
      RS_RETURN_IF_ERROR(Drop(store, id));
      ++result.removed;
    }
    return absl::OkStatus();
  }

 private:
  absl::Status Drop(const std::string& store, const std::string& id) {
    drop_unit_ << store << id;
    drop_episodes_ << store << id;
    RS_RETURN_IF_ERROR(drop_unit_.Step().status());
    return drop_episodes_.Step().status();
  }

  absl::Status Write(const std::string& store, const UnitInspection& inspection,
                     const std::string& stamp, IndexResult& result) {
    const UnitResult& unit = inspection.unit;
    RS_RETURN_IF_ERROR(Drop(store, unit.id));
    const bool damaged = !inspection.damage.empty();
    for (const std::string& damage : inspection.damage) result.damaged.push_back(damage);
    int64_t successes = 0, updates = 0;
    for (const EpisodeRow& row : unit.episodes) {
      successes += row.success;
      updates = row.updates;
    }
    const UnitConfig& config = unit.config;
    unit_ << store << unit.id << config.suite << ScenarioLabel(config.scenario)
          << int64_t{config.severity} << PolicyLabel(config.policy) << config.method->method
          << config.seed
          << std::string(damaged               ? "damaged"
                         : inspection.finished ? "finished"
                                               : "unfinished")
          << int64_t(unit.episodes.size()) << successes << updates
          << std::optional<double>(unit.timing.wall_s) << TextAt(unit.provenance, "model_hash")
          << inspection.episodes_sha256 << absl::StrJoin(unit.machines, "; ") << stamp;
    RS_RETURN_IF_ERROR(unit_.Step().status());
    if (damaged || !inspection.finished) return absl::OkStatus();
    for (const EpisodeRow& row : unit.episodes) {
      episode_ << store << unit.id << int64_t{row.task} << int64_t{row.episode}
               << int64_t{row.initial_state} << int64_t{row.success} << int64_t{row.steps}
               << int64_t{row.chunks} << int64_t{row.updates} << row.residual << row.intent;
      RS_RETURN_IF_ERROR(episode_.Step().status());
    }
    return absl::OkStatus();
  }

  sqlite3* db_;
  Statement unit_, episode_, drop_unit_, drop_episodes_;
  UnitTextReader texts_;
};

absl::Status OpenSchema(sqlite3* db) {
  RS_RETURN_IF_ERROR(
      Execute(db, "PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL; BEGIN IMMEDIATE"));
  Statement version(db, "PRAGMA user_version");
  RS_RETURN_IF_ERROR(version.Step().status());
  const std::string present = version.Text(0);
  RS_RETURN_IF_ERROR(version.Step().status());  // its end: tables of a running query stay
  if (present == absl::StrCat(kSchemaVersion)) return absl::OkStatus();
  return Execute(db, absl::StrCat(kSchema, "PRAGMA user_version=", kSchemaVersion));
}

}  // namespace

absl::StatusOr<IndexResult> UpdateIndex(const std::string& index,
                                        const std::vector<std::string>& stores) {
  RS_RETURN_IF_ERROR(CheckRunDirectories(stores));
  sqlite3* handle = nullptr;
  const int code = sqlite3_open(index.c_str(), &handle);
  const Database db(handle);
  if (code != SQLITE_OK) return Error(handle, absl::StrCat("cannot open ", index));
  sqlite3_busy_timeout(handle, 60000);
  RS_RETURN_IF_ERROR(OpenSchema(handle));
  IndexResult result;
  {
    Index writer(handle);
    for (const std::string& store : stores) {
      const std::string name = fs::absolute(store).lexically_normal().string();
      RS_RETURN_IF_ERROR(writer.Update(name, result));
    }
  }
  RS_RETURN_IF_ERROR(Execute(handle, "COMMIT"));
  return result;
}

}  // namespace robostress
