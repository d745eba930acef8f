#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server/sessions/session_event.h"

// A session's events as the records of its journal (proto/robostress/v1/state.proto), and back.
namespace robostress {

namespace v1 {
class StateRecord;
}  // namespace v1

// For SessionJournal::Append; needs no lock.
std::string EncodeEvent(const Prediction& prediction);
std::string EncodeEvent(const ExecutedChunk& executed);
std::string EncodeEvent(const EpisodeStarted& started);
std::string EncodeEvent(const AdapterImported& imported);
std::string EncodeEvent(const AdapterRolledBack& back);
std::string EncodeEvent(const VersionPinned& pin);

// Trusts nothing but that it is a record; a prediction comes without its prefix. DATA_LOSS or
// INVALID_ARGUMENT names field, value and limit.
absl::StatusOr<SessionEvent> DecodeEvent(const v1::StateRecord& record);

}  // namespace robostress
