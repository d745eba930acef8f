#include "common/records/arm_episode.h"

#include "common/records/json_record.h"
#include "common/status_macros.h"

namespace robostress {

std::string ArmEpisodeLine(const ArmEpisode& row) { return RecordJson(row).dump(); }

absl::StatusOr<ArmEpisode> ParseArmEpisode(const std::string& source, const std::string& line) {
  RS_ASSIGN_OR_RETURN(const nlohmann::json fields, ParseRecordLine(source, line));
  ArmEpisode row;
  RS_RETURN_IF_ERROR(ReadRecord(source, fields, row));
  return row;
}

}  // namespace robostress
