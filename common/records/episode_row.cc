#include "common/records/episode_row.h"

#include "common/records/json_record.h"
#include "common/status_macros.h"

namespace robostress {

using nlohmann::json;

std::string EpisodeLine(const EpisodeIdentity& identity, const EpisodeRow& row) {
  json line = RecordJson(row);  // json sorts
  line.update(json(RecordJson(identity)));
  return line.dump();
}

absl::StatusOr<EpisodeRow> ParseEpisode(const std::string& source, const std::string& line) {
  RS_ASSIGN_OR_RETURN(const json fields, ParseRecordLine(source, line));
  EpisodeRow row;
  RS_RETURN_IF_ERROR(ReadRecord(source, fields, row));
  row.record = line;
  return row;
}

bool IsRowOf(const EpisodeIdentity& identity, const std::string& line) {
  const json fields = json::parse(line, nullptr, false);
  EpisodeIdentity read;
  return fields.is_object() && ReadRecord("", fields, read).ok() && read == identity;
}

std::string TimingLine(const TimingRow& row) { return json(RecordJson(row)).dump(); }

std::optional<TimingRow> ParseTiming(const std::string& line) {
  const json fields = json::parse(line, nullptr, false);
  TimingRow row;
  if (!fields.is_object() || !ReadRecord("", fields, row).ok()) return std::nullopt;
  return row;
}

}  // namespace robostress
