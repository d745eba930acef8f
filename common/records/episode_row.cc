#include "common/records/episode_row.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "common/records/json_record.h"
#include "common/status_macros.h"

namespace robostress {

using nlohmann::json;

std::string EpisodeLine(const EpisodeIdentity& identity, const EpisodeRow& row) {
  json line = RecordJson(row);  // json sorts
  line.update(json(RecordJson(identity)));
  return line.dump();
}

namespace {

// Counts and sizes, none of which is negative.
absl::Status CheckRanges(const std::string& source, const EpisodeRow& row) {
  const auto fail = [&](const char* name, double value, const char* range) {
    return absl::DataLossError(
        absl::StrCat(source, ": ", name, " is ", value, ", must be ", range));
  };
  for (const auto& [name, value] : {std::pair{"steps", row.steps},
                                    {"chunks", row.chunks},
                                    {"updates", row.updates},
                                    {"task", row.task},
                                    {"episode", row.episode},
                                    {"initial_state", row.initial_state}}) {
    if (value < 0) return fail(name, value, "0 or more");
  }
  for (const auto& [name, value] : {std::pair{"adapter_distance", row.adapter_distance},
                                    {"residual", row.residual},
                                    {"eta_sq", row.eta_sq},
                                    {"a_sq", row.a_sq},
                                    {"residual_tracking", row.residual_tracking},
                                    {"tracking_eta_sq", row.tracking_eta_sq},
                                    {"intent", row.intent},
                                    {"intent_tracking", row.intent_tracking},
                                    {"intent_eta_sq", row.intent_eta_sq},
                                    {"intent_tracking_eta_sq", row.intent_tracking_eta_sq},
                                    {"intent_a_sq", row.intent_a_sq},
                                    {"mean_abs_action", row.mean_abs_action},
                                    {"lag_residual", row.lag_residual},
                                    {"lag_eta_sq", row.lag_eta_sq}}) {
    if (value && !(*value >= 0)) return fail(name, *value, "0 or more");
  }
  if (row.clipped_share && !(*row.clipped_share >= 0 && *row.clipped_share <= 1))
    return fail("clipped_share", *row.clipped_share, "0 to 1");
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<EpisodeRow> ParseEpisode(const std::string& source, const std::string& line) {
  RS_ASSIGN_OR_RETURN(const json fields, ParseRecordLine(source, line));
  EpisodeRow row;
  RS_RETURN_IF_ERROR(ReadRecord(source, fields, row));
  RS_RETURN_IF_ERROR(CheckRanges(source, row));
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
