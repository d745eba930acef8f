#include "common/rollout/chunk_ledger.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {

absl::Status ChunkLedger::Add(ExecutedChunk chunk) {
  if (chunk.sequence != sent_ + 1) {
    return absl::FailedPreconditionError(
        absl::StrCat("feedback sequence is ", chunk.sequence, ", must be ", sent_ + 1));
  }
  if (kept_.size() >= capacity_) {
    return absl::FailedPreconditionError(
        absl::StrCat("feedback ", chunk.sequence, " is dropped: ", kept_.size(),
                     " chunks wait for an acknowledgement, from ", acknowledged_ + 1,
                     " on; see why the server takes none"));
  }
  sent_ = chunk.sequence;
  kept_.push_back(std::move(chunk));
  return absl::OkStatus();
}

absl::Status ChunkLedger::Acknowledge(uint64_t watermark) {
  if (watermark > sent_) {
    return absl::InternalError(absl::StrCat("the server acknowledged feedback ", watermark,
                                            ", expected ", acknowledged_, " to ", sent_));
  }
  if (watermark < acknowledged_) {
    return absl::DataLossError(absl::StrCat("the server has feedback up to ", watermark, ", but ",
                                            acknowledged_,
                                            " was acknowledged: its disk lost some; open a new "
                                            "session"));
  }
  acknowledged_ = watermark;
  while (!kept_.empty() && kept_.front().sequence <= watermark) kept_.pop_front();
  return absl::OkStatus();
}

void ChunkLedger::DropOldest() {
  if (kept_.empty()) return;
  kept_.pop_front();
  for (ExecutedChunk& chunk : kept_) --chunk.sequence;
  --sent_;
}

void ChunkLedger::Restart(uint64_t sequence) {
  sent_ = acknowledged_ = sequence;
  kept_.clear();
}

}  // namespace robostress
