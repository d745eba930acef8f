#include "robot_client/piper/piper_arm.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/limit_check.h"

namespace robostress::piper {
namespace {

constexpr int64_t kPollInterval_ns = 1'000'000;
// Frames that one Poll takes in: half a second at the arm's full rate.
constexpr int kFramesPerPoll = 1600;

}  // namespace

int PercentOf(double joint_velocity) {
  return std::clamp(static_cast<int>(std::ceil(110 * joint_velocity / kMaxJointSpeed)), 1, 100);
}

PiperArm::PiperArm(std::unique_ptr<CanBus> bus, Clock& clock, PiperArmOptions options)
    : bus_(std::move(bus)), clock_(clock), options_(options), state_(options.max_skew_ns) {}

std::string PiperArm::Named(const std::string& text) const {
  return absl::StrCat("Piper on '", bus_->description(), "': ", text);
}

std::string PiperArm::description() const {
  return absl::StrCat("piper on ", bus_->description(),
                      connected_ ? absl::StrCat(", firmware ", FirmwareName(firmware_)) : "");
}

void PiperArm::Poll() {
  StampedFrame received;
  for (int i = 0; i < kFramesPerPoll && bus_->Receive(received); ++i) {
    if (state_.Take(received) && sample_reader_ != nullptr)
      sample_reader_->Push(state_.Snapshot(received.stamp_ns));
  }
  const int64_t now_ns = clock_.now_ns();
  ArmSnapshot snapshot = state_.Snapshot(now_ns);
  // Beside samples that go on coming: an arm that says nothing at all is silent.
  if (connected_ && snapshot.stamp_ns - state_.status_stamp_ns() > ArmState::kDriverAge_ns)
    snapshot.faults |= kFaultStatus;
  if (commanding_ && state_.status() && state_.status()->control != ControlMode::kCan)
    snapshot.faults |= kFaultMode;
  const CanState bus = bus_->health().state;
  if (bus == CanState::kBusOff || bus == CanState::kDown) snapshot.faults |= kFaultBus;
  if (snapshot.sequence == published_.sequence && snapshot.faults == published_.faults &&
      snapshot.enabled == published_.enabled && snapshot.taught == published_.taught)
    return;
  published_ = snapshot;
  snapshot_.Store(snapshot);
}

void PiperArm::Acknowledge() {
  commanding_ = false;
  if (clock_.now_ns() - state_.last_foreign_ns() >= options_.foreign_ns)
    state_.ForgetForeignCommands();
}

template <class Done>
bool PiperArm::WaitFor(int64_t duration_ns, const Done& done) {
  const int64_t end_ns = clock_.now_ns() + duration_ns;
  while (true) {
    Poll();
    if (done()) return true;
    const int64_t now_ns = clock_.now_ns();
    if (now_ns >= end_ns) return false;
    clock_.SleepUntil(std::min(now_ns + kPollInterval_ns, end_ns));
  }
}

absl::Status PiperArm::SendAllowed(const CanFrame& frame, Consent consent) {
  RS_RETURN_IF_ERROR(CheckMaySend(frame, consent));
  return bus_->Send(frame);
}

// Errors of the bus carry no text where they may come up in the control loop.
absl::Status PiperArm::Explained(const absl::Status& status) const {
  if (status.ok() || !status.message().empty()) return status;
  const std::string advice = BusAdvice(bus_->description(), bus_->health());
  return absl::Status(status.code(),
                      Named(advice.empty() ? "the bus does not take a frame" : advice));
}

absl::Status PiperArm::Connect() { return Explained(TryConnect()); }

absl::Status PiperArm::Enable(const std::function<bool()>& cancelled) {
  return Explained(TryEnable(cancelled));
}

absl::Status PiperArm::TryConnect() {
  RS_RETURN_IF_ERROR(bus_->Open());
  RS_RETURN_IF_ERROR(Listen());
  RS_RETURN_IF_ERROR(AskFirmware());
  RS_RETURN_IF_ERROR(AskLimits());
  connected_ = true;
  return absl::OkStatus();
}

absl::Status PiperArm::Listen() {
  state_.ForgetForeignCommands();
  // The whole time, so that a sender of a slow cycle is heard too.
  WaitFor(options_.listen_ns, [] { return false; });
  if (state_.foreign_commands() > 0)
    return absl::FailedPreconditionError(Named(absl::StrFormat(
        "another sender commands this arm (%d frames, the last 0x%03X); stop the other program, "
        "take the leader arm off the bus, or set the arm to follower mode",
        state_.foreign_commands(), state_.last_foreign_id())));
  if (published_.sequence == 0)
    return absl::UnavailableError(Named(absl::StrFormat(
        "no complete joint sample within %.1f s (%d frames of an arm, %d torn samples); check "
        "power, "
        "wiring and bit rate (1 Mbit/s); an arm in leader mode is silent",
        1e-9 * static_cast<double>(options_.listen_ns), state_.frames(), state_.torn_samples())));
  return absl::OkStatus();
}

absl::Status PiperArm::AskFirmware() {
  for (int attempt = 0; attempt < options_.attempts; ++attempt) {
    state_.ForgetFirmware();
    RS_RETURN_IF_ERROR(SendAllowed(EncodeFirmwareQuery(), Consent::kMotion));
    const auto known = [&] { return ParseFirmware(state_.firmware_text()).has_value(); };
    if (!WaitFor(options_.reply_ns, known)) continue;
    // The patch number's last digit may be in a frame that is still on its way.
    WaitFor(10 * kPollInterval_ns, [] { return false; });
    firmware_ = *ParseFirmware(state_.firmware_text());
    if (firmware_ < options_.oldest_firmware)
      return absl::FailedPreconditionError(Named(absl::StrCat(
          "firmware ", FirmwareName(firmware_), " is older than ",
          FirmwareName(options_.oldest_firmware), "; update it with the vendor's tool")));
    JointVector torque_per_ampere;
    for (int j = 0; j < kJoints; ++j)
      torque_per_ampere[j] = TorquePerAmpere(j) * CurrentScale(firmware_, j);
    state_.SetTorquePerAmpere(torque_per_ampere);
    return absl::OkStatus();
  }
  return absl::DeadlineExceededError(
      Named(absl::StrCat("no firmware version (\"S-V\") in the answer to 0x4AF after ",
                         options_.attempts, " questions; is this a Piper?")));
}

absl::Status PiperArm::AskLimits() {
  state_.ForgetLimits();
  const auto complete = [&] {
    for (int j = 0; j < kJoints; ++j) {
      if (!state_.joint_limits()[j] || !state_.accelerations()[j]) return false;
    }
    return state_.gripper_range().has_value();
  };
  for (int attempt = 0; attempt < options_.attempts && !complete(); ++attempt) {
    for (int j = 0; j < kJoints; ++j) {
      if (!state_.joint_limits()[j])
        RS_RETURN_IF_ERROR(SendAllowed(Encode(LimitQuery{j + 1, false}), Consent::kMotion));
      if (!state_.accelerations()[j])
        RS_RETURN_IF_ERROR(SendAllowed(Encode(LimitQuery{j + 1, true}), Consent::kMotion));
    }
    if (!state_.gripper_range())
      RS_RETURN_IF_ERROR(SendAllowed(EncodeParameterQuery(kGripperRangeQuery), Consent::kMotion));
    WaitFor(options_.reply_ns, complete);
  }
  for (int j = 0; j < kJoints; ++j) {
    if (!state_.joint_limits()[j] || !state_.accelerations()[j])
      return absl::DeadlineExceededError(Named(
          absl::StrCat("joint ", j + 1, " did not answer 0x472 after ", options_.attempts,
                       " questions; power the arm off and on, check the cable to that joint")));
    if (absl::Status fit = CheckJointLimit(*state_.joint_limits()[j], *state_.accelerations()[j]);
        !fit.ok())
      return absl::FailedPreconditionError(Named(std::string(fit.message())));
  }
  if (state_.gripper_range() == 0.0)
    return absl::FailedPreconditionError(
        Named("the gripper's range is not configured (0x47E answers 0 mm), so its opening is not "
              "reported; set 70 or 100 mm once with the vendor's tool"));
  limits_ = UsableLimits(state_.joint_limits(), state_.accelerations(),
                         state_.gripper_range().value_or(kGripperOpening), options_.limit_margin);
  return absl::OkStatus();
}

// An arm of an older firmware may not answer: that is shown, not an error.
absl::Status PiperArm::AskCollisionLevels() {
  state_.ForgetCollisionLevels();
  for (int attempt = 0; attempt < options_.attempts; ++attempt) {
    RS_RETURN_IF_ERROR(SendAllowed(EncodeParameterQuery(kCollisionLevelQuery), Consent::kMotion));
    if (WaitFor(options_.reply_ns, [&] { return state_.collision_levels().has_value(); })) break;
  }
  return absl::OkStatus();
}

absl::Status PiperArm::SetCollisionLevel(int level) {
  if (level < 0 || level > kMostCollisionLevel)
    return absl::InvalidArgumentError(Named(
        absl::StrCat("collision level ", level, ", must be 0 (off) to ", kMostCollisionLevel)));
  std::array<int, kJoints> levels;
  levels.fill(level);
  RS_RETURN_IF_ERROR(SendAllowed(EncodeCollisionWrite(levels), Consent::kSettings));
  RS_RETURN_IF_ERROR(AskCollisionLevels());
  if (state_.collision_levels() != levels)
    return absl::FailedPreconditionError(
        Named(absl::StrCat("the arm did not take collision level ", level,
                           "; power it off and on, or leave arm.collision_level out")));
  return absl::OkStatus();
}

absl::Status PiperArm::SendTargets(const JointVector& q, int speed_percent) {
  const ModeControl mode{ControlMode::kCan, MoveMode::kJ, speed_percent, options_.follow};
  RS_RETURN_IF_ERROR(SendAllowed(Encode(mode), Consent::kMotion));
  for (int pair = 0; pair < kJoints / 2; ++pair) {
    RS_RETURN_IF_ERROR(
        SendAllowed(EncodeJointTargets({pair, q[2 * pair], q[2 * pair + 1]}), Consent::kMotion));
  }
  return absl::OkStatus();
}

absl::Status PiperArm::HoldMeasuredPose() {
  JointVector q;
  for (int j = 0; j < kJoints; ++j)
    q[j] = std::clamp(published_.position[j], limits_.lower[j], limits_.upper[j]);
  return SendTargets(q, std::min(options_.enable_percent, options_.speed_percent));
}

// A pose may be commanded only while it is where the arm is.
absl::Status PiperArm::CheckStands(double still) {
  if (state_.foreign_commands() > 0)
    return absl::FailedPreconditionError(Named(absl::StrFormat(
        "another sender commands this arm (last 0x%03X); stop it, then type clear and enable",
        state_.last_foreign_id())));
  const int64_t age_ns = clock_.now_ns() - published_.stamp_ns;
  if (age_ns > options_.fresh_ns)
    return absl::UnavailableError(Named(absl::StrCat(
        "the newest joint sample is ", age_ns / 1'000'000, " ms old, at most ",
        options_.fresh_ns / 1'000'000,
        " are allowed: where the arm stands is not known; look at the bus, then type enable")));
  for (int j = 0; j < kJoints; ++j) {
    if (std::abs(published_.velocity[j]) > still)
      return absl::FailedPreconditionError(Named(absl::StrFormat(
          "joint %d moves at %.2f rad/s; wait until the arm stands, then type enable", j + 1,
          published_.velocity[j])));
  }
  return absl::OkStatus();
}

absl::Status PiperArm::TryEnable(const std::function<bool()>& cancelled) {
  if (!connected_) return absl::FailedPreconditionError(Named("Enable before Connect"));
  Poll();
  if (stopped_ || (published_.faults & kFaultEmergencyStop) != 0)
    return absl::FailedPreconditionError(
        Named("the arm is in an emergency stop; support it, then Disable, which lets it fall, and "
              "Enable again"));
  RS_RETURN_IF_ERROR(CheckStands(options_.still));
  const auto stop = [&] { return cancelled && cancelled(); };
  const auto told = absl::CancelledError(
      Named("enable was cancelled; joints that have power hold where they are"));
  if (options_.enable_listen_ns > 0) {
    const auto heard = [&] { return stop() || state_.foreign_commands() > 0; };
    if (WaitFor(options_.enable_listen_ns, heard) && stop()) return told;
  }
  const int64_t end_ns = clock_.now_ns() + options_.enable_ns;
  // Two rounds at least: after a reset the firmware takes the first one without effect
  // (piper_sdk issue 66). Motors are enabled one by one, because "all" also moves the gripper.
  for (int round = 0; round < 2 || !published_.enabled; ++round) {
    if (clock_.now_ns() >= end_ns)
      return absl::DeadlineExceededError(
          Named(absl::StrCat("not every joint was enabled within ", options_.enable_ns / 1'000'000,
                             " ms; reported: ", ArmFaultNames(published_.faults))));
    // A joint that gets power may give way a little before it holds.
    RS_RETURN_IF_ERROR(CheckStands(10 * options_.still));
    RS_RETURN_IF_ERROR(HoldMeasuredPose());
    for (int j = 0; j < kJoints; ++j)
      RS_RETURN_IF_ERROR(SendAllowed(Encode(MotorPower{j + 1, true}), Consent::kMotion));
    if (WaitFor(100 * kPollInterval_ns, stop)) return told;
  }
  WaitFor(end_ns - clock_.now_ns(), [&] { return stop() || CheckStands(options_.still).ok(); });
  if (stop()) return told;
  RS_RETURN_IF_ERROR(CheckStands(options_.still));
  RS_RETURN_IF_ERROR(HoldMeasuredPose());
  const auto in_mode = [&] { return state_.status()->control == ControlMode::kCan; };
  if (!state_.status() || !WaitFor(options_.reply_ns, in_mode))
    return absl::FailedPreconditionError(
        Named("the arm does not enter the mode in which it takes commands over the bus; end "
              "teaching with the button on the arm, then type enable"));
  commanding_ = true;
  return absl::OkStatus();
}

absl::Status PiperArm::Disable() {
  if (!connected_) return absl::FailedPreconditionError(Named("Disable before Connect"));
  Poll();
  if (stopped_ || (published_.faults & kFaultEmergencyStop) != 0)
    RS_RETURN_IF_ERROR(SendAllowed(EncodeStop(Stop::kReset), Consent::kPowerOff));
  RS_RETURN_IF_ERROR(SendAllowed(Encode(MotorPower{kAllMotors, false}), Consent::kPowerOff));
  stopped_ = commanding_ = false;
  const auto off = [&] {
    return !published_.enabled && (published_.faults & kFaultEmergencyStop) == 0;
  };
  if (!WaitFor(options_.enable_ns, off))
    return absl::DeadlineExceededError(Named(absl::StrCat(
        "the arm still reports its joints enabled, or a stop: ", ArmFaultNames(published_.faults),
        "; cut its power")));
  return absl::OkStatus();
}

absl::Status PiperArm::Send(const ArmCommand& command) {
  if (!connected_ || stopped_) return absl::FailedPreconditionError("");
  for (int axis = 0; axis < kAxes; ++axis) {
    // Written so that a NaN is refused.
    if (!(command.position[axis] >= limits_.lower[axis] &&
          command.position[axis] <= limits_.upper[axis]))
      return absl::InvalidArgumentError("");
  }
  JointVector q;
  std::copy_n(command.position.begin(), kJoints, q.begin());
  RS_RETURN_IF_ERROR(SendTargets(q, options_.speed_percent));
  GripperTarget gripper;
  gripper.opening = command.position[kJoints];
  gripper.effort = command.gripper_effort;
  return SendAllowed(Encode(gripper), Consent::kMotion);
}

absl::Status PiperArm::QuickStop() {
  stopped_ = true;
  return SendAllowed(EncodeStop(Stop::kQuick), Consent::kMotion);
}

}  // namespace robostress::piper
