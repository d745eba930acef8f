#include "robot_client/state_reporter.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress {
namespace {

// The joint whose value is largest.
template <class Value>
int Worst(int joints, const Value& value) {
  int worst = 0;
  for (int j = 1; j < joints; ++j) {
    if (value(j) > value(worst)) worst = j;
  }
  return worst;
}

}  // namespace

std::string CauseText(const TickRecord& r) {
  const auto error = [&](int j) { return std::abs(r.sent[j] - r.position[j]); };
  switch (r.cause) {
    case StateCause::kPressing: {
      const int j = Worst(r.axes.joints, [&](int i) { return std::abs(r.excess[i]); });
      return absl::StrFormat("J%d presses with %.1f Nm more than its motion needs", j + 1,
                             std::abs(r.excess[j]));
    }
    case StateCause::kBlocked:
    case StateCause::kFollowingError: {
      const int j = Worst(r.axes.joints, error);
      return absl::StrFormat("J%d is %.3f rad off its command and does not come nearer", j + 1,
                             error(j));
    }
    case StateCause::kDelayed:
      return absl::StrFormat("the arm follows %.0f ms late", 1000 * r.delay_s);
    case StateCause::kPolicyInvalid:
      return "the policy's actions are not numbers of this arm's shape";
    case StateCause::kRecordFailed:
      return "the recording has failed, its disk is full or gone";
    case StateCause::kWorkspace:
      return "the way leads out of the workspace";
    case StateCause::kArmFault:
      return ArmFaultNames(r.faults, r.fault_joints);
    case StateCause::kArmSilent:
      return "no fresh sample of the arm";
    case StateCause::kServerSilent:
      return "no usable chunk from the policy server";
    case StateCause::kInputSilent:
      return "the leader arm, keyboard or gamepad is not heard any more";
    case StateCause::kCameraStale:
      return "a camera's newest picture is old, or of a time to come";
    default:
      return r.faults == 0 ? "" : ArmFaultNames(r.faults, r.fault_joints);
  }
}

const char* NextStep(ClientState state, StateCause cause) {
  if (state == ClientState::kFault) {
    return cause == StateCause::kQuickStop
               ? "support the arm; quit limp takes its power off, then start anew"
               : "remove the cause, then type clear, then enable";
  }
  if (state != ClientState::kHold) return "";
  switch (cause) {
    case StateCause::kOperator:
      return "type resume to go on, or end";
    case StateCause::kPressing:
    case StateCause::kBlocked:
    case StateCause::kFollowingError:
      return "clear the arm's way, then type resume or end";
    case StateCause::kWorkspace:
      return "type end, then home or jog";
    case StateCause::kInputSilent:
      return "look at its cable, then type end, then follow";
    case StateCause::kRecordFailed:
      return "type end and quit; free space before the next run";
    case StateCause::kPolicyInvalid:
      return "look at the policy server's log; type resume to ask again, or end";
    default:
      return "remove the cause, then type resume or end";
  }
}

void StateReporter::Say(std::string line) {
  absl::MutexLock lock(&mu_);
  if (lines_.size() < kMostLines) lines_.push_back(std::move(line));
}

void StateReporter::Note(const TickRecord& r) {
  if (origin_ns_ == 0) origin_ns_ = r.start_ns;
  const bool goes_on = (r.faults & kFaultNotStopped) != 0;  // told once, however late it shows
  if (r.state == state_ && r.cause == cause_ && goes_on == goes_on_) return;
  goes_on_ = goes_on;
  state_ = r.state;
  cause_ = r.cause;
  std::string line =
      absl::StrFormat("%9.3f s  %s (%s)", static_cast<double>(r.start_ns - origin_ns_) * 1e-9,
                      StateName(r.state), CauseName(r.cause));
  if (const std::string cause = CauseText(r); !cause.empty()) absl::StrAppend(&line, ": ", cause);
  if (const std::string next = NextStep(r.state, r.cause); !next.empty())
    absl::StrAppend(&line, "; ", next);
  Say(std::move(line));
}

void StateReporter::Write(const std::string& text) {
  size_t written = 0;
  while (written < text.size()) {
    pollfd ready{descriptor_, POLLOUT, 0};
    if (poll(&ready, 1, 100) <= 0) return;  // stuck: the rest of the line is lost
    const ssize_t count =
        write(descriptor_, text.data() + written, std::min<size_t>(text.size() - written, 512));
    if (count < 0 && errno != EINTR && errno != EAGAIN) return;
    if (count > 0) written += static_cast<size_t>(count);
  }
}

void StateReporter::Drain() {
  TickRecord record;
  while (ring_.Pop(record)) Note(record);
  std::deque<std::string> lines;
  {
    absl::MutexLock lock(&mu_);
    lines.swap(lines_);
  }
  std::string text;
  for (const std::string& line : lines) absl::StrAppend(&text, line, "\n");
  Write(text);
}

void StateReporter::Run(const std::atomic<bool>& stop) {
  while (!stop.load(std::memory_order_acquire)) {
    Drain();
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  Drain();
}

}  // namespace robostress
