#include "robot_client/cameras/faulty_source.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/random.h"

namespace robostress {
namespace {
constexpr size_t kHistory = 64;  // two seconds at 30 Hz
}  // namespace

void FaultySource::Set(CameraFault fault, double amount, int64_t from_ns) {
  amount_.store(amount);
  from_ns_.store(from_ns);
  fault_.store(fault);
}

CameraFault FaultySource::fault() const {
  return clock_->now_ns() < from_ns_.load() ? CameraFault::kNone : fault_.load();
}

bool FaultySource::Drops(int64_t stamp_ns) const {
  RandomStream stream(StreamKey("camera_drop").With(static_cast<int64_t>(seed_)).With(stamp_ns));
  return stream.Uniform() < amount_.load();
}

int64_t FaultySource::newest_stamp_ns() const {
  const int64_t newest = source_->newest_stamp_ns();
  switch (fault()) {
    case CameraFault::kUnplug:
      return last_stamp_ns_.load();
    case CameraFault::kDrop:
      if (newest != 0 && Drops(newest)) return last_stamp_ns_.load();
      break;
    case CameraFault::kDelay:
      return newest == 0 ? 0 : newest - static_cast<int64_t>(amount_.load() * 1e9);
    case CameraFault::kFuture:
      return newest == 0 ? 0 : newest + static_cast<int64_t>(amount_.load() * 1e9);
    default:
      break;
  }
  last_stamp_ns_.store(newest);
  return newest;
}

std::shared_ptr<const Frame> FaultySource::Latest() {
  const CameraFault fault = this->fault();
  if (fault == CameraFault::kUnplug) return last_;
  std::shared_ptr<const Frame> frame = source_->Latest();
  if (frame == nullptr) return last_;
  if (history_.empty() || history_.back()->sequence != frame->sequence) history_.push_back(frame);
  if (history_.size() > kHistory) history_.pop_front();

  switch (fault) {
    case CameraFault::kDrop:
      if (Drops(frame->stamp_ns)) return last_;
      break;
    case CameraFault::kFreeze: {
      if (last_ == nullptr) break;
      auto frozen = std::make_shared<Frame>(*last_);
      frozen->stamp_ns = frame->stamp_ns;
      frozen->sequence = frame->sequence;
      return last_ = std::move(frozen);
    }
    case CameraFault::kDelay: {
      const int64_t until = clock_->now_ns() - static_cast<int64_t>(amount_.load() * 1e9);
      std::shared_ptr<const Frame> old;
      for (const auto& candidate : history_) {
        if (candidate->stamp_ns <= until) old = candidate;
      }
      return old;
    }
    case CameraFault::kFuture: {
      auto ahead = std::make_shared<Frame>(*frame);
      ahead->stamp_ns += static_cast<int64_t>(amount_.load() * 1e9);
      last_ = frame;
      return ahead;
    }
    case CameraFault::kCorrupt: {
      auto corrupt = std::make_shared<Frame>(*frame);
      RandomStream noise(StreamKey("camera_noise")
                             .With(static_cast<int64_t>(seed_))
                             .With(static_cast<int64_t>(frame->sequence)));
      const size_t band = corrupt->image.data.size() / 4;
      for (size_t i = 0; i < band; ++i)
        corrupt->image.data[i] = static_cast<uint8_t>(noise.Uniform() * 256);
      last_ = frame;
      return corrupt;
    }
    default:
      break;
  }
  return last_ = std::move(frame);
}

absl::Status FaultySource::status() const {
  if (fault() == CameraFault::kUnplug)
    return absl::UnavailableError(absl::StrCat("camera '", name(), "' was unplugged"));
  return source_->status();
}

absl::Status ParseCameraFault(const std::string& text, CameraFault* fault) {
  const std::pair<const char*, CameraFault> names[] = {
      {"none", CameraFault::kNone},       {"drop", CameraFault::kDrop},
      {"freeze", CameraFault::kFreeze},   {"delay", CameraFault::kDelay},
      {"corrupt", CameraFault::kCorrupt}, {"unplug", CameraFault::kUnplug},
      {"future", CameraFault::kFuture}};
  for (const auto& [name, value] : names) {
    if (text == name) {
      *fault = value;
      return absl::OkStatus();
    }
  }
  return absl::InvalidArgumentError(
      absl::StrCat("camera fault '", text,
                   "' is unknown; use none, drop, freeze, delay, corrupt, unplug or "
                   "future"));
}

}  // namespace robostress
