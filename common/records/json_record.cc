#include "common/records/json_record.h"

#include "absl/strings/str_cat.h"

namespace robostress {

void RecordReader::Fail(const char* key, const char* expected) {
  if (!status_.ok()) return;
  const auto field = record_.find(key);
  status_ = absl::DataLossError(
      absl::StrCat(source_, ": field ", key,
                   field == record_.end() ? " is missing" : absl::StrCat(" is ", field->dump()),
                   ", must be ", expected, "; the file was not written by this version's worker"));
}

absl::StatusOr<nlohmann::json> ParseRecordLine(const std::string& source, const std::string& line) {
  nlohmann::json record = nlohmann::json::parse(line, nullptr, false);
  if (record.is_object()) return record;
  return absl::DataLossError(
      absl::StrCat(source, ": not a JSON object: '", line.substr(0, 80), "'"));
}

}  // namespace robostress
