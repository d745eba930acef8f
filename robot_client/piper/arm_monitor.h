#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.h"
#include "robot_client/can/can_bus.h"
#include "robot_client/piper/arm_report.h"
#include "robot_client/piper/joint_assembler.h"

namespace robostress::piper {

struct ArmMonitorOptions {
  bool silent = false;              // sends nothing at all
  int64_t reply_ns = 200'000'000;   // waits this long for an answer
  int attempts = 3;                 // of a question until others have their turn
  int64_t repeat_ns = 500'000'000;  // between questions once every one has been asked
  // While another program's command is at most this old nothing is asked. No arm was seen to mind
  // questions, but none was tried that moves for somebody else.
  int64_t others_ns = 1'000'000'000;
};

// Looks at an arm and takes no part: it never commands and never writes. What it sends are
// questions, one at a time: 0x4AF, 0x472, and 0x477 for the collision levels and the gripper's
// range. A robot_client on the same bus does not count them as commands of another sender. It works
// on any arm, also on one that PiperArm refuses. No thread, and nothing here waits.
class ArmMonitor {
 public:
  // `clock` outlives the monitor and is the bus's.
  ArmMonitor(std::unique_ptr<CanBus> bus, const Clock& clock, ArmMonitorOptions options = {});

  // The bus's error, which names the remedy.
  absl::Status Open();
  // Takes in what has arrived and asks what is due. As often as wanted; a bus keeps about a second.
  void Poll();
  // Whether every question has been answered, or asked for `attempts` times, or must not be asked.
  bool asked_all() const;
  uint64_t frames() const { return frames_; }  // of an arm
  bool heard() const { return frames_ + other_frames_ > 0; }
  // What is known now. Rates and ages are of the time since the last report.
  ArmReport TakeReport();

 private:
  static constexpr int kQuestions = 2 * kJoints + 3;
  struct Question {
    CanFrame frame;
    int attempts = 0;
    bool answered = false;
  };
  struct Driver {
    DriverStatus status;
    int64_t stamp_ns;
  };
  struct Count {
    uint64_t total = 0, window = 0;
    int64_t last_ns = 0;
  };

  void Take(const StampedFrame& received);
  void TakeOther(const StampedFrame& received);
  void TakeStatus(const StampedFrame& received);
  bool TakeAnswer(const StampedFrame& received);
  void Answered(int question, int64_t stamp_ns);
  void Ask();
  int NextQuestion() const;
  bool OthersCommand(int64_t now_ns) const;
  FrameCount Counted(uint16_t id, double expected, int64_t now_ns, double window_s) const;
  void ReportJoints(ArmReport& report, int64_t now_ns) const;
  void ReportCounts(ArmReport& report, int64_t now_ns) const;
  QuestionReport ReportQuestions(int64_t now_ns) const;

  const std::unique_ptr<CanBus> bus_;
  const Clock& clock_;
  const ArmMonitorOptions options_;
  int64_t begin_ns_ = 0, window_ns_ = 0;

  std::array<Question, kQuestions> questions_;
  int asked_ = -1;  // the question that waits for its answer; -1: none does
  int next_ = 0;    // where the search for the next one begins
  int64_t asked_ns_ = 0;
  uint64_t asked_frames_ = 0, answers_ = 0;
  double answers_s_ = 0, worst_answer_s_ = 0;

  std::array<Count, kMaxCanId + 1> counts_;
  uint64_t parameter_writes_ = 0, frames_ = 0, other_frames_ = 0;
  uint64_t samples_ = 0, window_samples_ = 0;
  int64_t last_other_ns_ = 0;
  JointAssembler assembler_;
  std::optional<JointVector> angles_;
  AgeStatistics age_;
  double worst_age_s_ = 0;
  std::array<std::optional<JointSpeed>, kJoints> speeds_;
  std::array<std::optional<double>, kJoints> targets_;
  std::array<std::optional<Driver>, kJoints> drivers_;
  std::array<std::optional<JointLimit>, kJoints> limits_;
  std::array<std::optional<JointAcceleration>, kJoints> accelerations_;
  std::optional<ArmStatus> status_;
  std::optional<std::array<uint8_t, 2>> unknown_status_;
  int64_t status_stamp_ns_ = 0;
  std::optional<GripperStatus> gripper_;
  std::optional<double> gripper_range_;
  std::optional<std::array<int, kJoints>> collision_levels_;
  std::string firmware_text_;  // of the answer that is coming in
  std::optional<Firmware> firmware_;
};

}  // namespace robostress::piper
