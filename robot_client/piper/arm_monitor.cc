#include "robot_client/piper/arm_monitor.h"

#include <algorithm>
#include <utility>

#include "common/check.h"
#include "common/status_macros.h"
#include "robot_client/piper/command_guard.h"
#include "robot_client/piper/status_words.h"

namespace robostress::piper {
namespace {

constexpr int64_t kMaxSkew_ns = 3'000'000;  // between the frames of a sample, as PiperArm has it
constexpr size_t kFirmwareText = 256;       // kept at most
// Questions by index: limits of J1 to J6, accelerations of J1 to J6, then these.
constexpr int kAskAcceleration = kJoints, kAskCollision = 2 * kJoints,
              kAskGripper = kAskCollision + 1, kAskFirmware = kAskGripper + 1;

double Seconds(int64_t ns) { return 1e-9 * static_cast<double>(ns); }

// No command, and nothing that an arm says.
bool IsQuestion(const CanFrame& frame) {
  return DecodeLimitQuery(frame) || DecodeParameterQuery(frame) || IsFirmwareQuery(frame);
}

// What somebody sends to an arm that is no question. Besides what a client counts as commands:
// 0x477 with more than a query restores or switches settings.
bool IsOrder(const CanFrame& frame) {
  return IsCommand(frame) || (frame.id == kParameterQuery && !IsQuestion(frame));
}

}  // namespace

ArmMonitor::ArmMonitor(std::unique_ptr<CanBus> bus, const Clock& clock, ArmMonitorOptions options)
    : bus_(std::move(bus)), clock_(clock), options_(options), assembler_(kMaxSkew_ns) {
  for (int j = 0; j < kJoints; ++j) {
    questions_[j].frame = Encode(LimitQuery{j + 1, false});
    questions_[kAskAcceleration + j].frame = Encode(LimitQuery{j + 1, true});
  }
  questions_[kAskCollision].frame = EncodeParameterQuery(kCollisionLevelQuery);
  questions_[kAskGripper].frame = EncodeParameterQuery(kGripperRangeQuery);
  questions_[kAskFirmware].frame = EncodeFirmwareQuery();
  // Its last digit may come in a frame of its own, which has arrived when the others are answered.
  next_ = kAskFirmware;
  // The one thing that must never go wrong here.
  for (const Question& question : questions_) RS_CHECK(IsQuestion(question.frame));
}

absl::Status ArmMonitor::Open() {
  RS_RETURN_IF_ERROR(bus_->Open());
  begin_ns_ = window_ns_ = clock_.now_ns();
  return absl::OkStatus();
}

void ArmMonitor::Poll() {
  StampedFrame received;
  while (bus_->Receive(received)) Take(received);
  if (!options_.silent) Ask();
}

void ArmMonitor::Take(const StampedFrame& received) {
  const CanFrame& frame = received.frame;
  if (frame.id > kMaxCanId) return;
  Count& count = counts_[frame.id];
  ++count.total;
  ++count.window;
  count.last_ns = received.stamp_ns;
  if (IsOrder(frame)) return TakeOther(received);
  if (IsQuestion(frame)) return;
  ++frames_;
  if (const auto angles = DecodeJointAngles(frame)) {
    const auto sample = assembler_.Add(*angles, received.stamp_ns);
    if (!sample) return;
    angles_ = sample->q;
    ++samples_;
    ++window_samples_;
    age_.Add(sample->stamp_ns, received.stamp_ns);
  } else if (const auto speed = DecodeJointSpeed(frame)) {
    speeds_[speed->joint] = *speed;
  } else if (const auto driver = DecodeDriverStatus(frame)) {
    drivers_[driver->joint] = Driver{*driver, received.stamp_ns};
  } else if (frame.id == kArmStatus) {
    TakeStatus(received);
  } else if (const auto gripper = DecodeGripperStatus(frame)) {
    gripper_ = *gripper;
  } else {
    TakeAnswer(received);
  }
}

void ArmMonitor::TakeOther(const StampedFrame& received) {
  ++other_frames_;
  last_other_ns_ = received.stamp_ns;
  if (received.frame.id == kParameterQuery) ++parameter_writes_;
  if (const auto targets = DecodeJointTargets(received.frame)) {
    targets_[2 * targets->pair] = targets->first;
    targets_[2 * targets->pair + 1] = targets->second;
  }
}

void ArmMonitor::TakeStatus(const StampedFrame& received) {
  unknown_status_.reset();
  if (const auto status = DecodeArmStatus(received.frame)) {
    status_ = *status;
    status_stamp_ns_ = received.stamp_ns;
  } else {
    unknown_status_ = {received.frame.data[0], received.frame.data[1]};
  }
}

// Answers to questions of other programs are as good.
bool ArmMonitor::TakeAnswer(const StampedFrame& received) {
  const CanFrame& frame = received.frame;
  if (const auto limit = DecodeJointLimit(frame)) {
    limits_[limit->joint] = *limit;
    Answered(limit->joint, received.stamp_ns);
  } else if (const auto acceleration = DecodeJointAcceleration(frame)) {
    accelerations_[acceleration->joint] = *acceleration;
    Answered(kAskAcceleration + acceleration->joint, received.stamp_ns);
  } else if (const auto levels = DecodeCollisionLevels(frame)) {
    collision_levels_ = *levels;
    Answered(kAskCollision, received.stamp_ns);
  } else if (const auto range = DecodeGripperRange(frame)) {
    gripper_range_ = *range;
    Answered(kAskGripper, received.stamp_ns);
  } else if (const auto text = DecodeFirmwareText(frame)) {
    if (firmware_text_.size() + text->size() <= kFirmwareText) firmware_text_ += *text;
    const auto firmware = ParseFirmware(firmware_text_);
    if (!firmware) return true;
    firmware_ = firmware;
    Answered(kAskFirmware, received.stamp_ns);
  } else {
    return false;
  }
  return true;
}

void ArmMonitor::Answered(int question, int64_t stamp_ns) {
  questions_[question].answered = true;
  if (question != asked_) return;
  const double waited_s = std::max(0.0, Seconds(stamp_ns - asked_ns_));
  ++answers_;
  answers_s_ += waited_s;
  worst_answer_s_ = std::max(worst_answer_s_, waited_s);
  asked_ = -1;
}

bool ArmMonitor::OthersCommand(int64_t now_ns) const {
  return other_frames_ > 0 && now_ns - last_other_ns_ <= options_.others_ns;
}

bool ArmMonitor::asked_all() const {
  if (options_.silent || OthersCommand(clock_.now_ns())) return true;
  for (int i = 0; i < kQuestions; ++i) {
    const Question& question = questions_[i];
    const bool waits = i == asked_ && question.attempts <= options_.attempts;
    if (!question.answered && (question.attempts < options_.attempts || waits)) return false;
  }
  return true;
}

// What was never answered and still has attempts comes first, then each in turn.
int ArmMonitor::NextQuestion() const {
  for (int i = 0; i < kQuestions; ++i) {
    const int question = (next_ + i) % kQuestions;
    if (!questions_[question].answered && questions_[question].attempts < options_.attempts)
      return question;
  }
  return -1;
}

void ArmMonitor::Ask() {
  const int64_t now_ns = clock_.now_ns();
  if (asked_ >= 0) {
    if (now_ns - asked_ns_ < options_.reply_ns) return;
    asked_ = -1;
  }
  if (OthersCommand(now_ns)) return;
  int question = NextQuestion();
  if (question < 0) {
    if (now_ns - asked_ns_ < options_.repeat_ns) return;
    question = next_;
  }
  next_ = (question + 1) % kQuestions;
  if (question == kAskFirmware) firmware_text_.clear();
  asked_ns_ = now_ns;
  ++questions_[question].attempts;
  if (!bus_->Send(questions_[question].frame).ok()) return;  // health() says why
  asked_ = question;
  ++asked_frames_;
}

FrameCount ArmMonitor::Counted(uint16_t id, double expected, int64_t now_ns,
                               double window_s) const {
  const Count& count = counts_[id];
  return {id, count.total, window_s > 0 ? static_cast<double>(count.window) / window_s : 0,
          expected, count.total > 0 ? Seconds(now_ns - count.last_ns) : 0};
}

void ArmMonitor::ReportJoints(ArmReport& report, int64_t now_ns) const {
  for (int j = 0; j < kJoints; ++j) {
    JointReport& joint = report.joints[j];
    if (angles_) joint.angle = (*angles_)[j];
    joint.motion = speeds_[j];
    if (speeds_[j]) {
      joint.torque = speeds_[j]->current * TorquePerAmpere(j);
      if (report.firmware) joint.torque *= CurrentScale(*report.firmware, j);
    }
    joint.target = targets_[j];
    if (drivers_[j]) {
      joint.driver = drivers_[j]->status;
      joint.driver_age_s = Seconds(now_ns - drivers_[j]->stamp_ns);
    }
    joint.limit = limits_[j];
    joint.acceleration = accelerations_[j];
  }
}

void ArmMonitor::ReportCounts(ArmReport& report, int64_t now_ns) const {
  std::array<bool, kMaxCanId + 1> known{};
  for (const FrameCount& expected : ExpectedReports()) {
    known[expected.id] = true;
    report.reports.push_back(Counted(expected.id, expected.expected, now_ns, report.window_s));
  }
  for (uint16_t id = 0; id <= kMaxCanId; ++id) {
    if (counts_[id].total == 0 || known[id]) continue;
    FrameCount count = Counted(id, 0, now_ns, report.window_s);
    CanFrame frame;
    frame.id = id;
    if (id == kParameterQuery) count.total = parameter_writes_;
    if (IsCommand(frame) || (id == kParameterQuery && count.total > 0)) {
      report.other.commands.push_back(count);
      if (id == kJointTargets) report.other.targets_per_second = count.per_second;
    } else if (id != kLimitQuery && id != kParameterQuery && ReportWords(id).empty()) {
      report.unknown.push_back(count);
    }
  }
  report.other.frames = other_frames_;
  report.other.last_s = other_frames_ > 0 ? Seconds(now_ns - last_other_ns_) : 0;
  report.other.commands_now = OthersCommand(now_ns);
}

QuestionReport ArmMonitor::ReportQuestions(int64_t now_ns) const {
  QuestionReport report;
  report.questions = kQuestions;
  report.answered = static_cast<int>(std::count_if(questions_.begin(), questions_.end(),
                                                   [](const Question& q) { return q.answered; }));
  report.asked = asked_frames_;
  report.answers = answers_;
  report.mean_s = answers_ > 0 ? answers_s_ / static_cast<double>(answers_) : 0;
  report.worst_s = worst_answer_s_;
  report.silent = options_.silent;
  report.waits = !options_.silent && OthersCommand(now_ns);
  return report;
}

ArmReport ArmMonitor::TakeReport() {
  const int64_t now_ns = clock_.now_ns();
  age_.Until(now_ns);
  ArmReport report;
  report.bus = bus_->description();
  report.health = bus_->health();
  report.seconds = Seconds(now_ns - begin_ns_);
  report.window_s = Seconds(now_ns - window_ns_);
  report.frames = frames_;
  report.firmware = firmware_;
  ReportJoints(report, now_ns);
  report.status = status_;
  report.unknown_status = unknown_status_;
  report.status_age_s = status_ ? Seconds(now_ns - status_stamp_ns_) : 0;
  report.gripper = gripper_;
  report.gripper_range = gripper_range_;
  report.collision_levels = collision_levels_;
  ReportCounts(report, now_ns);
  report.samples = samples_;
  report.torn = assembler_.torn();
  report.samples_per_second =
      report.window_s > 0 ? static_cast<double>(window_samples_) / report.window_s : 0;
  report.age = age_.summary();
  report.sample_age_s = samples_ > 0 ? Seconds(now_ns - age_.newest_stamp_ns()) : 0;
  worst_age_s_ = std::max(worst_age_s_, report.age.worst_s);
  report.worst_age_s = worst_age_s_;
  report.questions = ReportQuestions(now_ns);
  age_.Reset();
  window_ns_ = now_ns;
  window_samples_ = 0;
  for (Count& count : counts_) count.window = 0;
  return report;
}

}  // namespace robostress::piper
