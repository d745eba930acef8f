#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/wire/openpi_value.h"
#include "server/proxy/arm_correction.h"
#include "server/proxy/arm_motion.h"
#include "server/proxy/arm_profile.h"
#include "server/proxy/hunting.h"
#include "server/wire/openpi/openpi_extensions.h"

namespace robostress {

enum class ProxyMode {
  kOn,      // corrects
  kShadow,  // learns and reports what it would do; answers pass as they are
  kOff,     // looks at nothing
};
const char* ProxyModeName(ProxyMode mode);

// Why an answer passes untouched although the proxy is on.
enum class Doubt : uint8_t {
  kUnreadable,  // a message that is no msgpack map
  kState,       // the measured state is missing, or cannot be
  kExecuted,    // `executed` cannot be
  kEarly,       // the next observation came before the steps can have been executed
  kPause,       // it came long after
  kJump,        // the arm is where it cannot have got to
  kOverlap,     // a message came before the last one was answered
  kServer,      // the server answered with an error
  kActions,     // not the actions of this robot
  kCorrection,  // the correction is not finite
  kHunting,     // it swings to and fro; so it stays until the proxy is switched on again
  kFault,       // the proxy itself failed
};
inline constexpr size_t kDoubts = 12;
const char* DoubtName(Doubt doubt);

// What became of one answer.
enum class AnswerOutcome : uint8_t { kCorrected, kZero, kShadow, kOff, kDoubt, kOther };
inline constexpr size_t kAnswerOutcomes = 6;
const char* AnswerOutcomeName(AnswerOutcome outcome);

// One answer, for logs and pages; in the action's own units.
struct AnswerReport {
  AnswerOutcome outcome = AnswerOutcome::kOther;
  std::optional<Doubt> doubt;  // the first
  std::string words;           // what it was
  int episode = 0;
  uint64_t chunk = 0;
  // [columns], or empty: of the motion that the last observation ended, what a step of it did
  // beyond what was expected (joints: where they are beyond the last target).
  Eigen::VectorXd residual;
  // [columns] at the last row that will be executed: what was added, or in shadow would have been.
  Eigen::VectorXd correction;
};

// One control step of a joint-space arm: where it was and what was asked of it [rad].
struct JointRow {
  int stretch = 0;  // rows of one follow each other a control period apart
  Eigen::VectorXd q, q_cmd;
};

// One client's robot, as it shows in what passes: learns from observations, corrects answers. It
// never sees the network. Whatever it does not understand, or does not believe, it leaves as it is:
// the answer passes, what was being learned of the motion is forgotten, and the reason is reported.
// One thread.
class ProxiedArm {
 public:
  ProxiedArm(const ArmProfile& profile, const MethodOptions& method);

  // A message that the client sends. `now_s`: of a clock that only goes forward.
  void Observed(std::string_view message, bool text, double now_s, ProxyMode mode);
  // A message of the server; what the client gets instead, or nothing: the message itself.
  std::optional<std::string> Answered(std::string_view message, bool text, double now_s,
                                      ProxyMode mode);
  // Something failed: as after a doubt.
  void Failed(const std::string& words);

  // Of the last answer.
  const AnswerReport& report() const { return report_; }
  // What was measured since it was last asked.
  std::vector<JointRow> TakeRows() { return std::move(rows_); }

 private:
  // An answer that is being executed.
  struct Given {
    Eigen::MatrixXd own, sent, correction;  // [rows, columns], a method's numbers
    RobotState before;
    double asked_s = 0, time_s = 0;  // when `before` and when the answer came
    int enters = 0;                  // the row that is executed first
    int played = 0;                  // rows that were due when the next observation came
    uint64_t prediction_id = 0;
  };

  std::optional<std::string> Correct(std::string_view message, double now_s, ProxyMode mode);
  void Learn(const RobotState& after, double now_s);
  // Of a chunk, at the first control step after that time.
  int RowDue(double since_observation_s) const;
  void LearnAsynchronously(const RobotState& after, double now_s);
  void LearnMeasured(const OpenpiValue& executed);
  // Why a report cannot be what became of the chunk that was given last; empty: it can.
  std::string Misfit(const OpenpiValue& value, const OpenpiExecuted& executed) const;
  void Take(const ArmMotion& motion, Eigen::Index last_row, double dt_s);
  void NewEpisode();
  // Forgets the motion; the answer to come passes untouched.
  void Distrust(Doubt doubt, const std::string& words);
  bool BeginsEpisode(const OpenpiValue& observation);
  Eigen::MatrixXd OwnColumns(const Eigen::MatrixXd& actions) const;  // [rows, columns]

  const ArmProfile profile_;
  const MethodOptions method_;
  const std::vector<int> columns_;
  const Eigen::VectorXd scale_;
  ArmCorrection correction_;
  ArmMotionReader motion_;
  CorrectionLimiter limiter_;
  HuntingWatch hunting_;
  std::string hunted_;  // the words; empty: it does not hunt

  int outstanding_ = 0;  // messages of the client that have no answer
  bool off_ = false, trusted_ = false, met_ = false;
  std::optional<RobotState> seen_;  // in the observation that is being answered
  double seen_s_ = 0;
  std::optional<Given> given_,
      before_;             // the last answer, and the one before that where it matters
  uint64_t sequence_ = 0;  // of the last report
  std::optional<std::string> prompt_;
  Eigen::VectorXd residual_;  // of the motion that ended last
  int episode_ = 0, stretch_ = 0;
  uint64_t chunk_ = 0;
  std::optional<Doubt> doubt_;
  std::string words_;
  AnswerReport report_;
  std::vector<JointRow> rows_;
  Eigen::VectorXd last_q_;  // where the last measured row left the joints
};

}  // namespace robostress
