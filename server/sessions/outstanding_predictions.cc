#include "server/sessions/outstanding_predictions.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/sessions/state_rules.h"

namespace robostress {

absl::StatusOr<uint64_t> OutstandingPredictions::Next() {
  RS_RETURN_IF_ERROR(StateRules::CheckCount("prediction", next_ + 1));
  return next_++;
}

void OutstandingPredictions::Keep(Prediction prediction) {
  ++made_;
  const uint64_t id = prediction.id;
  kept_.emplace(id, std::move(prediction));
  while (kept_.size() > kMost) {
    kept_.erase(kept_.begin());
    ++dropped_;
  }
}

absl::Status OutstandingPredictions::Skip(uint64_t id) {
  RS_RETURN_IF_ERROR(StateRules::CheckCount("prediction", id + 1));
  next_ = std::max(next_, id + 1);
  return absl::OkStatus();
}

absl::Status OutstandingPredictions::NotKept(const std::string& what,
                                             const std::string& which) const {
  return absl::FailedPreconditionError(absl::StrCat(what, which, "; it made ", last(),
                                                    ", keeps the last ", kMost,
                                                    " and none that is older than one already "
                                                    "reported"));
}

absl::StatusOr<const Prediction*> OutstandingPredictions::Find(uint64_t id) const {
  if (id == 0 && !kept_.empty()) return &kept_.rbegin()->second;
  const auto found = kept_.find(id);
  if (found != kept_.end()) return &found->second;
  return NotKept(absl::StrCat("prediction ", id), " is not one that this session holds");
}

absl::StatusOr<Prediction*> OutstandingPredictions::ReportedBy(const ExecutedChunk& executed) {
  const auto found = kept_.find(executed.prediction_id);
  if (found == kept_.end()) {
    return NotKept(absl::StrCat("feedback ", executed.sequence, " is about prediction ",
                                executed.prediction_id),
                   ", which this session does not hold");
  }
  const ChunkKey& key = found->second.key;
  if (key == KeyOf(executed)) return &found->second;
  return absl::FailedPreconditionError(absl::StrCat(
      "feedback ", executed.sequence, " says task ", executed.task, " episode ", executed.episode,
      " chunk ", executed.chunk, "; prediction ", executed.prediction_id, " was made for task ",
      key.episode.task, " episode ", key.episode.episode, " chunk ", key.chunk));
}

void OutstandingPredictions::Settle(uint64_t id) {
  kept_.erase(kept_.begin(), kept_.lower_bound(id));
}

std::vector<Prediction> OutstandingPredictions::Kept() const {
  std::vector<Prediction> kept;
  for (const auto& [id, prediction] : kept_) kept.push_back(prediction);
  return kept;
}

void OutstandingPredictions::Restore(const std::vector<Prediction>& kept, uint64_t next,
                                     uint64_t made, uint64_t dropped) {
  for (const Prediction& prediction : kept) kept_.emplace(prediction.id, prediction);
  next_ = next;
  made_ = made;
  dropped_ = dropped;
}

void OutstandingPredictions::MarkJournaled() {
  for (auto& [id, prediction] : kept_) prediction.journaled = true;
}

void OutstandingPredictions::MarkAsIn(const std::vector<Prediction>& before) {
  for (const Prediction& prediction : before) {
    const auto found = kept_.find(prediction.id);
    if (found != kept_.end()) found->second.journaled = prediction.journaled;
  }
}

}  // namespace robostress
