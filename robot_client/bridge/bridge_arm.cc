#include "robot_client/bridge/bridge_arm.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"
#include "robot_client/bridge/driver_abilities.h"

namespace robostress::bridge {
namespace {

constexpr int64_t kPoll_ns = 2'000'000;
constexpr double kHeartbeatPeriods = 1.5;   // without a target until a heartbeat is sent
constexpr int64_t kAsked_ns = 200'000'000;  // a stop that is not repeated for so long is over
constexpr int kMostReads = 4;               // in one Poll: a driver that floods is left behind
constexpr double kMostAhead_s = 0.02;       // of a driver's stamp before our clock
constexpr double kJumpFactor = 4;           // of a joint's most velocity ...
constexpr double kJump = 0.1;               // ... and this [rad], [m]: a measurement may be noisy
constexpr uint32_t kKnownFaults = (kFaultNotStopped << 1) - 1;

double Seconds(int64_t ns) { return static_cast<double>(ns) * 1e-9; }

}  // namespace

BridgeArm::BridgeArm(BridgeRobot robot, std::string address, Clock& clock, BridgeArmOptions options)
    : robot_(std::move(robot)),
      address_(std::move(address)),
      dial_([this](double wait_s) { return DriverSocket::Connect(address_, wait_s, clock_); }),
      clock_(clock),
      options_(options) {}

BridgeArm::BridgeArm(BridgeRobot robot, Dial dial, Clock& clock, BridgeArmOptions options)
    : robot_(std::move(robot)),
      address_("a stream"),
      dial_(std::move(dial)),
      clock_(clock),
      options_(options) {}

BridgeArm::~BridgeArm() {
  if (socket_ == nullptr || socket_->closed()) return;
  std::array<uint8_t, kHeaderBytes> bye;
  EncodeHeader({FrameKind::kBye, 0, ++sent_sequence_}, bye.data());
  socket_->Send(bye.data(), bye.size());
}

std::string BridgeArm::Named(const std::string& text) const {
  return absl::StrCat("bridge ", address_, ": ", text);
}

std::string BridgeArm::description() const {
  return absl::StrCat(robot_.name, " behind ", welcome_.driver, " (", welcome_.robot, ") at ",
                      address_);
}

std::string BridgeArm::stop_effect() const {
  return welcome_.stop ? "stop: the driver's own"
                       : "stop: the driver has none, so it holds where the arm stands; the switch "
                         "takes the power off";
}

std::vector<std::string> BridgeArm::Warnings() const {
  return WhatADriverSays(robot_, welcome_, options_.velocity_window_s);
}

template <class Done>
bool BridgeArm::WaitFor(double seconds, const Done& done) {
  const int64_t end_ns = clock_.now_ns() + static_cast<int64_t>(seconds * 1e9);
  while (true) {
    Poll();
    if (done()) return true;
    const int64_t now_ns = clock_.now_ns();
    if (now_ns >= end_ns) return false;
    clock_.SleepUntil(std::min(now_ns + kPoll_ns, end_ns));
  }
}

absl::Status BridgeArm::Connect() {
  RS_RETURN_IF_ERROR(Open(options_.wait_s, options_.welcome_s, [] { return false; }));
  connected_ = true;
  return absl::OkStatus();
}

absl::Status BridgeArm::Reconnect(const std::function<bool()>& cancelled) {
  broken_ = "";
  refusal_.clear();
  filled_ = 0;
  welcomed_ = commanding_ = stopped_ = false;
  state_ = {};
  state_sequence_ = 0;
  sample_.enabled = false;
  grip_.reset();
  anywhere_ = true;
  places_seen_ = 0;
  absl::Status status =
      Open(options_.again_s, options_.again_s, [&] { return cancelled && cancelled(); });
  if (const std::string why = Differs(welcome_, greeting_); status.ok() && !why.empty())
    status = absl::FailedPreconditionError(Named(why));
  if (status.ok()) return status;
  welcomed_ = true;  // by the first
  Broken("the connection is gone");
  return status;
}

absl::Status BridgeArm::Stopped() const {
  return absl::CancelledError(Named("a person stopped it before the driver had answered"));
}

absl::Status BridgeArm::Open(double wait_s, double answer_s, const std::function<bool()>& stop) {
  RS_ASSIGN_OR_RETURN(socket_, dial_(wait_s));
  RS_RETURN_IF_ERROR(Greet(answer_s, stop));
  if (const std::string why = Unfit(robot_, greeting_); !why.empty())
    return absl::FailedPreconditionError(Named(why));
  const uint64_t first = sample_.sequence;
  const auto sampled = [&] { return sample_.sequence != first || *broken_ != '\0' || stop(); };
  WaitFor(answer_s, sampled);
  if (*broken_ != '\0') return absl::UnavailableError(Named(broken_));
  if (sample_.sequence == first && stop()) return Stopped();
  if (sample_.sequence == first) {
    if (counters_.not_finite > 0)
      return absl::UnavailableError(
          Named("the driver sends positions that are no numbers; look at its messages"));
    return absl::UnavailableError(
        Named(absl::StrCat("no state of the arm within ", answer_s,
                           " s; look at the driver's messages and at the arm's power")));
  }
  const double age = Seconds(clock_.now_ns() - sample_.stamp_ns);
  if (!(age >= -kMostAhead_s && age <= 1)) {
    return absl::FailedPreconditionError(
        Named(absl::StrCat("the driver's stamps are ", age,
                           " s behind this machine's CLOCK_MONOTONIC; it must use that clock, or "
                           "say clock none in its welcome")));
  }
  return absl::OkStatus();
}

absl::Status BridgeArm::Greet(double answer_s, const std::function<bool()>& stop) {
  const std::vector<uint8_t> hello = EncodeText(
      FrameKind::kHello, ++sent_sequence_,
      HelloText(robot_.name, robot_.names(), robot_.limits.axes.gripper, robot_.rate_hz));
  std::ignore =
      socket_->Send(hello.data(), hello.size());  // a driver that refuses may have hung up already
  WaitFor(answer_s, [&] { return welcomed_ || !refusal_.empty() || *broken_ != '\0' || stop(); });
  if (!refusal_.empty()) return absl::FailedPreconditionError(Named(refusal_));
  if (welcomed_) return absl::OkStatus();
  if (stop()) return Stopped();
  if (*broken_ != '\0')
    return absl::UnavailableError(Named(absl::StrCat(
        broken_, " instead of a welcome; is this a driver of version ", int{kVersion}, "?")));
  return absl::DeadlineExceededError(
      Named(absl::StrCat("no welcome within ", answer_s, " s; look at the driver's messages")));
}

// Allocates nothing once the driver was welcomed.
void BridgeArm::Broken(const char* why) {
  if (*broken_ == '\0') broken_ = why;
  if (socket_ != nullptr) socket_->Close();
  filled_ = 0;
}

void BridgeArm::Poll() {
  TakeBytes();
  const int64_t now_ns = clock_.now_ns();
  if (welcomed_ && Seconds(now_ns - sent_ns_) >= kHeartbeatPeriods / robot_.rate_hz)
    SendFrame(CommandMode::kHeartbeat, {}, 0).IgnoreError();
  WatchStop(now_ns);
  Publish();
}

void BridgeArm::TakeBytes() {
  if (socket_ == nullptr || socket_->closed()) return;
  for (int read = 0; read < kMostReads; ++read) {
    size_t received = 0;
    const DriverSocket::Result result =
        socket_->Receive(buffer_.data() + filled_, buffer_.size() - filled_, received);
    if (result == DriverSocket::Result::kClosed) return Broken("the driver has hung up");
    if (result == DriverSocket::Result::kWouldWait) return;
    filled_ += received;
    size_t at = 0;
    while (at < filled_) {
      FrameHeader header;
      const Decoded decoded = DecodeHeader(buffer_.data() + at, filled_ - at, header);
      if (decoded == Decoded::kMore) break;
      if (decoded != Decoded::kFrame) return Broken(DecodedName(decoded));
      TakeFrame(header, buffer_.data() + at + kHeaderBytes);
      if (socket_->closed()) return;
      at += kHeaderBytes + header.size;
    }
    std::memmove(buffer_.data(), buffer_.data() + at, filled_ - at);
    filled_ -= at;
  }
}

void BridgeArm::TakeFrame(const FrameHeader& header, const uint8_t* payload) {
  if (header.kind == FrameKind::kState && welcomed_) return TakeState(header, payload);
  if (header.kind == FrameKind::kBye) return Broken("the driver has said goodbye");
  if (welcomed_) return Broken("a second greeting");
  const std::string text(reinterpret_cast<const char*>(payload), header.size);
  if (header.kind == FrameKind::kRefusal) {
    refusal_ = absl::StrCat("the driver refuses: ", ParseRefusal(text));
    return Broken("it was refused");
  }
  if (header.kind != FrameKind::kWelcome) return Broken("a frame before the welcome");
  absl::StatusOr<Welcome> welcome = ParseWelcome(text);
  if (!welcome.ok()) {
    refusal_ = std::string(welcome.status().message());
    return Broken("its welcome cannot be read");
  }
  greeting_ = *std::move(welcome);
  if (!connected_) welcome_ = greeting_;
  welcomed_ = true;
}

void BridgeArm::TakeState(const FrameHeader& header, const uint8_t* payload) {
  StateFrame state;
  const Decoded decoded = DecodeState(payload, header.size, robot_.limits.axes.count(), state);
  if (decoded == Decoded::kLength) return Broken(DecodedName(decoded));
  if (header.sequence <= state_sequence_) {
    ++counters_.repeated;
    return;
  }
  if (decoded == Decoded::kNotFinite) {
    ++counters_.not_finite;
    latched_ |= kFaultDriver;
    return;
  }
  state_sequence_ = header.sequence;
  const int64_t now_ns = clock_.now_ns();
  if (!welcome_.monotonic) state.stamp_ns = now_ns;
  sample_.enabled = (state.flags & kPowered) != 0;
  if (!sample_.enabled) grip_.reset();
  sample_.faults =
      (state.faults & kKnownFaults) | (state.faults & ~kKnownFaults ? kFaultOther : 0u);
  const int64_t before_ns = std::exchange(state_, state).stamp_ns;
  if (state.stamp_ns <= before_ns || Seconds(state.stamp_ns - now_ns) > kMostAhead_s) {
    ++counters_.repeated;  // it says that the driver lives, and nothing about the arm
    state_.stamp_ns = before_ns;
  } else if (!TakeSample(state)) {
    state_.stamp_ns = before_ns;
  }
}

bool BridgeArm::Jumps(const ArmVector& position, int64_t stamp_ns) const {
  if (sample_.sequence == 0) return false;
  // While samples are refused the last one that was taken gets older, and no longer way likelier.
  const double dt = std::min(Seconds(stamp_ns - sample_.stamp_ns), jump_s_);
  for (int i = 0; i < robot_.limits.axes.count(); ++i) {
    const double most = kJump + kJumpFactor * robot_.limits.max_velocity[i] * dt;
    if (std::abs(position[i] - sample_.position[i]) > most) return true;
  }
  return false;
}

bool BridgeArm::TakeSample(const StateFrame& state) {
  ArmVector position{};
  for (int i = 0; i < robot_.limits.axes.count(); ++i)
    position[i] = robot_.conversions[i].Ours(state.position[i]);
  if (Jumps(position, state.stamp_ns)) {
    if (!anywhere_) {
      ++counters_.jumps;
      jump_s_ = std::min(Seconds(state.stamp_ns - sample_.stamp_ns), jump_s_);
      return false;
    }
    places_seen_ = 0;
  }
  anywhere_ = false;
  jump_s_ = std::numeric_limits<double>::infinity();
  sample_.position = position;
  sample_.stamp_ns = state.stamp_ns;
  ++sample_.sequence;
  ++counters_.states;
  // What is measured is recorded; it is judged where the robot file says what pressing is.
  sample_.has_effort = welcome_.measures_effort && robot_.watches_torque();
  for (int i = 0; i < robot_.limits.axes.count(); ++i) {
    // A torque turns with the joint's sign, its size is Nm already.
    sample_.effort[i] = welcome_.measures_effort
                            ? std::copysign(1.0, robot_.conversions[i].scale) * state.effort[i]
                            : 0;
    if (welcome_.measures_velocity)
      sample_.velocity[i] = robot_.conversions[i].scale * state.velocity[i];
  }
  places_[places_seen_ % kPlaces] = {state.stamp_ns, position};
  ++places_seen_;
  if (!welcome_.measures_velocity) EstimateVelocity();
  if (sample_reader_ != nullptr) sample_reader_->Push(sample_);
  return true;
}

// Against the oldest sample within the window: a servo's encoder has steps of a few milliradians,
// and from one sample to the next each looks like a motion.
void BridgeArm::EstimateVelocity() {
  const auto window_ns = static_cast<int64_t>(options_.velocity_window_s * 1e9);
  const Place* oldest = nullptr;
  for (size_t back = 1; back < std::min(places_seen_, kPlaces); ++back) {
    const Place& place = places_[(places_seen_ - 1 - back) % kPlaces];
    if (oldest != nullptr && sample_.stamp_ns - place.stamp_ns > window_ns) break;
    oldest = &place;
  }
  for (int i = 0; i < robot_.limits.axes.count(); ++i) {
    const double dt = oldest == nullptr ? 0 : Seconds(sample_.stamp_ns - oldest->stamp_ns);
    sample_.velocity[i] = dt > 0 && i < robot_.limits.axes.joints
                              ? (sample_.position[i] - oldest->position[i]) / dt
                              : 0;
  }
}

// A driver that was told to stop says so, and the arm comes to rest.
void BridgeArm::WatchStop(int64_t now_ns) {
  if (!stopped_ || now_ns - stop_asked_ns_ > kAsked_ns) return;
  const double since = Seconds(now_ns - stop_ns_);
  const bool said = (state_.flags & kStopped) != 0;
  bool moves = false;
  for (int j = 0; j < robot_.limits.axes.joints; ++j)
    moves = moves || std::abs(sample_.velocity[j]) > options_.stopped_velocity;
  if ((since > options_.stop_s && !said) || (since > options_.stopped_s && moves))
    latched_ |= kFaultNotStopped;
}

void BridgeArm::Publish() {
  ArmSnapshot published = sample_;
  published.faults |= latched_;
  if (*broken_ != '\0') published.faults |= kFaultBus;
  if (commanding_ && (state_.flags & kTaking) == 0) published.faults |= kFaultMode;
  snapshot_.Store(published);
}

absl::Status BridgeArm::SendFrame(CommandMode mode, const ArmVector& position,
                                  double gripper_effort) {
  if (*broken_ != '\0' || socket_ == nullptr) return absl::UnavailableError("");
  CommandFrame command;
  command.stamp_ns = clock_.now_ns();
  command.state = state_sequence_;
  command.mode = mode;
  command.gripper_effort = gripper_effort;
  command.axes = robot_.limits.axes.count();
  for (int i = 0; i < command.axes; ++i)
    command.position[i] = robot_.conversions[i].Drivers(position[i]);
  std::array<uint8_t, kMostFrame> bytes;
  const size_t size = EncodeCommand(command, sent_sequence_ + 1, bytes);
  switch (socket_->Send(bytes.data(), size)) {
    case DriverSocket::Result::kDone:
      ++sent_sequence_;
      sent_ns_ = command.stamp_ns;
      return absl::OkStatus();
    case DriverSocket::Result::kWouldWait:
      ++counters_.full;
      return absl::ResourceExhaustedError("");
    case DriverSocket::Result::kClosed:
      Broken("the driver has hung up");
  }
  return absl::UnavailableError("");
}

// Where the arm stands is its target; a gripper goes on holding what it holds.
absl::Status BridgeArm::SendHold(CommandMode mode) {
  ArmVector position = sample_.position;
  const int opening = robot_.limits.axes.opening();
  if (grip_ && robot_.limits.axes.gripper) position[opening] = grip_->position[opening];
  for (int i = 0; i < robot_.limits.axes.count(); ++i)
    position[i] = std::clamp(position[i], robot_.limits.lower[i], robot_.limits.upper[i]);
  return SendFrame(mode, position, grip_ ? grip_->gripper_effort : 0);
}

absl::Status BridgeArm::CheckStands(double still) const {
  if (*broken_ != '\0')
    return absl::UnavailableError(
        Named(absl::StrCat(broken_, "; start the driver again, then type enable")));
  const double age = Seconds(clock_.now_ns() - sample_.stamp_ns);
  if (sample_.sequence == 0 || !(age <= options_.fresh_s && age >= -kMostAhead_s))
    return absl::UnavailableError(Named(absl::StrCat(
        "the newest state is ", 1000 * age, " ms old, at most ", 1000 * options_.fresh_s,
        " are allowed: where the arm stands is not known; look at the driver, then type enable")));
  for (int j = 0; j < robot_.limits.axes.joints; ++j) {
    if (!(std::abs(sample_.velocity[j]) <= still))
      return absl::FailedPreconditionError(Named(
          absl::StrFormat("J%d moves at %.2f rad/s; wait until the arm stands, then type enable",
                          j + 1, sample_.velocity[j])));
  }
  return absl::OkStatus();
}

absl::Status BridgeArm::Enable(const std::function<bool()>& cancelled) {
  if (!welcomed_) return absl::FailedPreconditionError(Named("Enable before Connect"));
  const auto stop = [&] { return cancelled && cancelled(); };
  const auto stands = [&] { return stop() || CheckStands(options_.still).ok(); };
  WaitFor(options_.reply_s, stands);  // a driver may be late once
  RS_RETURN_IF_ERROR(CheckStands(options_.still));
  const auto told =
      absl::CancelledError(Named("enable was cancelled; the driver holds where the arm is"));
  if (stop()) return told;
  const absl::Status sent = SendHold(CommandMode::kEnable);
  if (!sent.ok())
    return absl::Status(sent.code(), Named("the driver does not read; look at its messages"));
  stopped_ = false;
  latched_ &= ~static_cast<uint32_t>(kFaultNotStopped);
  const uint64_t asked = sent_sequence_;
  const auto taken = [&] {
    return stop() || *broken_ != '\0' ||
           (state_.command >= asked && (state_.flags & kTaking) != 0 && sample_.enabled);
  };
  if (!WaitFor(options_.enable_s, taken))
    return absl::DeadlineExceededError(
        Named(absl::StrCat("the driver does not say within ", options_.enable_s,
                           " s that the joints have power and that it takes targets; it reports: ",
                           ArmFaultNames(Latest().faults))));
  if (stop()) return told;
  // A joint that gets power may give way a little before it holds.
  WaitFor(options_.enable_s, stands);
  if (stop()) return told;
  RS_RETURN_IF_ERROR(CheckStands(options_.still));
  const absl::Status held = SendHold(CommandMode::kTarget);
  if (!held.ok())
    return absl::Status(held.code(), Named("the driver does not read; look at its messages"));
  commanding_ = true;
  return absl::OkStatus();
}

absl::Status BridgeArm::Disable() {
  if (!welcomed_) return absl::FailedPreconditionError(Named("Disable before Connect"));
  commanding_ = false;
  if (!welcome_.torque_off)
    return absl::UnimplementedError(
        Named("the driver cannot take the power off: the joints still have it; use the switch"));
  Poll();
  const absl::Status sent = SendHold(CommandMode::kPowerOff);
  if (!sent.ok())
    return absl::Status(sent.code(), Named("the driver does not read: use the switch"));
  stopped_ = false;
  if (!WaitFor(options_.enable_s, [&] { return !sample_.enabled || *broken_ != '\0'; }) ||
      sample_.enabled)
    return absl::DeadlineExceededError(
        Named("the driver still reports that the joints have power; use the switch"));
  return absl::OkStatus();
}

void BridgeArm::Acknowledge() {
  latched_ = 0;
  commanding_ = false;
  anywhere_ = true;
  SendFrame(CommandMode::kAcknowledge, {}, 0).IgnoreError();
}

absl::Status BridgeArm::Send(const ArmCommand& command) {
  if (!welcomed_ || stopped_ || !commanding_) return absl::FailedPreconditionError("");
  for (int axis = 0; axis < robot_.limits.axes.count(); ++axis) {
    // Written so that a NaN is refused.
    if (!(command.position[axis] >= robot_.limits.lower[axis] &&
          command.position[axis] <= robot_.limits.upper[axis]))
      return absl::InvalidArgumentError("");
  }
  absl::Status sent = SendFrame(CommandMode::kTarget, command.position, command.gripper_effort);
  if (sent.ok()) grip_ = command;
  return sent;
}

absl::Status BridgeArm::QuickStop() {
  stop_asked_ns_ = clock_.now_ns();
  if (!stopped_) stop_ns_ = stop_asked_ns_;
  stopped_ = true;
  commanding_ = false;
  return SendHold(CommandMode::kStop);
}

}  // namespace robostress::bridge
