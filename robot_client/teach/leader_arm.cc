#include "robot_client/teach/leader_arm.h"

#include <pthread.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "robot_client/piper/protocol.h"

namespace robostress {
namespace {

constexpr int64_t kPoll_ns = 2'000'000;
constexpr int64_t kConnect_ns = 1'000'000'000;
constexpr int kFramesPerPoll = 4096;  // more than a second of a leader

}  // namespace

LeaderArm::~LeaderArm() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

std::string LeaderArm::description() const {
  return absl::StrCat("leader on ", bus_->description());
}

absl::Status LeaderArm::Connect() {
  RS_RETURN_IF_ERROR(bus_->Open());
  const int64_t until = clock_.now_ns() + kConnect_ns;
  while (sample_.sequence == 0 && clock_.now_ns() < until) {
    clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
    Poll();
  }
  if (sample_.sequence > 0) return absl::OkStatus();
  const std::string what = absl::StrCat("leader on '", bus_->description(), "': ");
  if (feedback_ > 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(what, "the arm there reports where it is (", feedback_,
                     " frames) and leads nobody; make it a leader with the vendor's tool, then "
                     "switch it off and on"));
  }
  return absl::UnavailableError(absl::StrCat(
      what,
      "no whole sample (0x155, 0x156, 0x157) within 1 s; check power, wiring, bit rate (1 "
      "Mbit/s), and that the arm is in leader mode"));
}

void LeaderArm::Poll() {
  StampedFrame received;
  for (int i = 0; i < kFramesPerPoll && bus_->Receive(received); ++i) {
    if (const auto gripper = piper::DecodeGripperTarget(received.frame)) {
      sample_.position[piper::kJoints] = gripper->opening;
    } else if (const auto pair = piper::DecodeJointTargets(received.frame)) {
      const auto whole = assembler_.Add(*pair, received.stamp_ns);
      if (!whole) continue;
      std::copy(whole->q.begin(), whole->q.end(), sample_.position.begin());
      sample_.stamp_ns = whole->stamp_ns;
      ++sample_.sequence;
      newest_.Store(sample_);
    } else if (piper::DecodeJointAngles(received.frame)) {
      ++feedback_;
    }
  }
}

void LeaderArm::StartThread() {
  thread_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "leader");
    while (!stop_.load(std::memory_order_acquire)) {
      Poll();
      clock_.SleepUntil(clock_.now_ns() + kPoll_ns);
    }
  });
}

}  // namespace robostress
