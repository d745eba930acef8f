#include "robot_client/emulator/piper_emulator.h"

#include <algorithm>
#include <cmath>

#include "common/status_macros.h"

namespace robostress::piper {
namespace {

constexpr int64_t kStep_ns = static_cast<int64_t>(1e9 * PiperPlant::kStep_s);
constexpr uint64_t kForeignSteps = 25;  // 40 Hz
// Commands that one step takes in; more wait, as on a real bus of 1 Mbit/s, which carries 8 per ms.
constexpr int kCommandsPerStep = 64;

}  // namespace

absl::StatusOr<std::unique_ptr<PiperEmulator>> PiperEmulator::Create(const EmulatorOptions& options,
                                                                     std::unique_ptr<CanBus> bus,
                                                                     const Clock& clock) {
  std::unique_ptr<PiperEmulator> emulator(new PiperEmulator);
  RS_ASSIGN_OR_RETURN(emulator->profile_, MakeWearProfile(options.profile));
  emulator->profile_.motor_encoders |= options.motor_encoders;
  RS_ASSIGN_OR_RETURN(emulator->plant_,
                      PiperPlant::Create(ComposePiperScene(options.scene), emulator->profile_));
  emulator->plant_->Reset(options.start, options.opening);
  FirmwareOptions firmware;
  firmware.version = options.version;
  firmware.command_lag_s =
      options.command_lag_s < 0 ? emulator->profile_.command_lag_s : options.command_lag_s;
  firmware.gripper_range = options.gripper_range;
  firmware.gravity_feedforward = emulator->profile_.gravity_feedforward;
  emulator->firmware_ = std::make_unique<ArmFirmware>(firmware);
  emulator->faults_ = FaultSchedule(options.faults);
  emulator->teach_ = options.teach;
  emulator->hand_ = options.hand;
  if (options.leader) emulator->firmware_->SetLeader();
  emulator->bus_ = std::move(bus);
  RS_RETURN_IF_ERROR(emulator->bus_->Open());
  emulator->next_step_ns_ = clock.now_ns() + kStep_ns;
  return emulator;
}

void PiperEmulator::RunUntil(int64_t now_ns) {
  if (now_ns - next_step_ns_ > kMaxGap_ns) {
    const int64_t skipped = (now_ns - next_step_ns_) / kStep_ns;
    skipped_steps_ += static_cast<uint64_t>(skipped);
    next_step_ns_ += skipped * kStep_ns;
  }
  for (; next_step_ns_ <= now_ns; next_step_ns_ += kStep_ns) Step();
}

void PiperEmulator::Step() {
  StampedFrame received;
  for (int i = 0; i < kCommandsPerStep && bus_->Receive(received); ++i)
    firmware_->Take(received.frame);
  const double now_s = PiperPlant::kStep_s * static_cast<double>(steps_);
  faults_.Apply(now_s, *firmware_);
  Guide(now_s);
  const ArmFirmware::Torques torques = firmware_->Step(plant_->reading());
  for (int j = 0; j < kJoints; ++j) parked_ = parked_ && !firmware_->enabled(j);
  plant_->SetParked(parked_);
  plant_->Step(torques.motor, torques.finger_force);
  ++steps_;
  SendReports();
}

// What a person does: the arm's button, and the hand on a limp arm.
void PiperEmulator::Guide(double now_s) {
  if (teach_.from_s >= 0) {
    firmware_->SetTeaching(now_s >= teach_.from_s &&
                           (teach_.for_s == 0 || now_s < teach_.from_s + teach_.for_s));
  }
  if (hand_.empty()) return;
  const GuidingHand::Push push =
      firmware_->limp() ? hand_.PushAt(now_s, plant_->reading()) : GuidingHand::Push{};
  plant_->Push(push.torque, push.finger_force);
}

void PiperEmulator::SendReports() {
  firmware_->TakeReports(plant_->reading(), reports_);
  if (faults_.foreign_sender() && steps_ % kForeignSteps == 0)
    reports_.push_back(EncodeJointTargets({0, 0, 0}));
  const auto late = static_cast<uint64_t>(std::lround(faults_.late_s() / PiperPlant::kStep_s));
  for (CanFrame& frame : reports_) {
    if (faults_.Passes(frame)) on_the_way_.emplace_back(steps_ + late, frame);
  }
  while (!on_the_way_.empty() && on_the_way_.front().first <= steps_) {
    const CanFrame frame = on_the_way_.front().second;
    on_the_way_.pop_front();
    if (bus_->Send(frame).ok()) {
      ++frames_sent_;
    } else {
      ++send_failures_;
    }
  }
}

void EmulatedTime::SleepUntil(int64_t deadline_ns) {
  for (int64_t now = now_ns(); now < deadline_ns; now = now_ns()) {
    Advance(std::min(kStep_ns, deadline_ns - now));
    for (PiperEmulator* emulator : emulators_) emulator->RunUntil(now_ns());
  }
}

}  // namespace robostress::piper
