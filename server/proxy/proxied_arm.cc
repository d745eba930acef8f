#include "server/proxy/proxied_arm.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/policy_endpoint.h"
#include "server/proxy/action_block.h"

namespace robostress {
namespace {

constexpr size_t kMostRows = 4096;  // that nobody took

template <class Names>
const char* NameIn(const Names& names, size_t index) {
  return index < std::size(names) ? names[index] : "";
}

constexpr double kSameJoints = 1e-6;  // of their norm

constexpr double kSameTick = 1e-6;  // steps

// Room for a control loop's jitter: of the time that the steps take.
constexpr double kEarliest = 0.8;

}  // namespace

const char* ProxyModeName(ProxyMode mode) {
  static constexpr const char* kNames[] = {"on", "shadow", "off"};
  return NameIn(kNames, static_cast<size_t>(mode));
}
const char* DoubtName(Doubt doubt) {
  static constexpr const char* kNames[kDoubts] = {"unreadable", "state",      "executed", "early",
                                                  "pause",      "jump",       "overlap",  "server",
                                                  "actions",    "correction", "hunting",  "fault"};
  return NameIn(kNames, static_cast<size_t>(doubt));
}
const char* AnswerOutcomeName(AnswerOutcome outcome) {
  static constexpr const char* kNames[kAnswerOutcomes] = {"corrected", "zero",  "shadow",
                                                          "off",       "doubt", "other"};
  return NameIn(kNames, static_cast<size_t>(outcome));
}

ProxiedArm::ProxiedArm(const ArmProfile& profile, const MethodOptions& method)
    : profile_(profile),
      method_(method),
      columns_(profile.columns()),
      scale_(profile.scale()),
      correction_(profile, method),
      motion_(profile),
      limiter_(profile),
      hunting_(profile.correction_limit()) {}

void ProxiedArm::NewEpisode() {
  correction_.StartEpisode();
  motion_.StartEpisode();
  limiter_.Reset();
  hunting_.Reset();
  given_.reset();
  before_.reset();
  residual_.resize(0);
  ++episode_;
  ++stretch_;
}

void ProxiedArm::Distrust(Doubt doubt, const std::string& words) {
  NewEpisode();
  trusted_ = false;
  if (doubt_) return;
  doubt_ = doubt;
  words_ = words;
}

void ProxiedArm::Failed(const std::string& words) {
  Distrust(Doubt::kFault, words);
  seen_.reset();
  report_ = {.outcome = AnswerOutcome::kDoubt, .doubt = doubt_, .words = words_};
}

bool ProxiedArm::BeginsEpisode(const OpenpiValue& observation) {
  const OpenpiDialect& keys = profile_.keys;
  bool begins = !keys.episode.empty() && observation.Find(keys.episode) != nullptr;
  if (!keys.reset.empty()) {
    const OpenpiValue* reset = observation.Find(keys.reset);
    const bool* flag = reset == nullptr ? nullptr : std::get_if<bool>(&reset->value);
    const auto* text = reset == nullptr ? nullptr : std::get_if<std::string_view>(&reset->value);
    begins = begins || (flag != nullptr && *flag) ||
             (text != nullptr && !keys.reset_text.empty() && *text == keys.reset_text);
  }
  if (const OpenpiValue* prompt = observation.Find(keys.prompt)) {
    const auto* text = std::get_if<std::string_view>(&prompt->value);
    if (text != nullptr) {
      begins = begins || (prompt_ && *prompt_ != *text);
      prompt_ = std::string(*text);
    }
  }
  return begins;
}

void ProxiedArm::Observed(std::string_view message, bool text, double now_s, ProxyMode mode) {
  ++outstanding_;
  seen_.reset();
  doubt_.reset();
  if (mode == ProxyMode::kOff) {
    off_ = true;
    return;
  }
  if (std::exchange(off_, false)) {  // what happened since is not known: begin again
    correction_ = ArmCorrection(profile_, method_);
    hunted_.clear();
    NewEpisode();
  }
  trusted_ = true;
  if (outstanding_ > 1)
    return Distrust(Doubt::kOverlap, "a message came before the last one was answered");
  if (text) return Distrust(Doubt::kUnreadable, "a text frame");
  if (!hunted_.empty()) return Distrust(Doubt::kHunting, hunted_);
  const absl::StatusOr<OpenpiValue> observation = DecodeOpenpi(message);
  if (!observation.ok())
    return Distrust(Doubt::kUnreadable, std::string(observation.status().message()));
  if (BeginsEpisode(*observation)) NewEpisode();
  const OpenpiValue* executed = observation->Find("executed");
  if (executed != nullptr) LearnMeasured(*executed);
  absl::StatusOr<RobotState> state = ReadArmState(*observation, profile_);
  if (!state.ok()) {
    // A message that only begins an episode, or only reports, has none.
    const bool speaks = executed != nullptr || (!profile_.keys.reset_text.empty() &&
                                                observation->Find(profile_.keys.reset) != nullptr);
    if (!speaks) Distrust(Doubt::kState, std::string(state.status().message()));
    trusted_ = false;
    return;
  }
  if (executed == nullptr && given_)
    profile_.asynchronous ? LearnAsynchronously(*state, now_s) : Learn(*state, now_s);
  seen_ = *std::move(state);
  seen_s_ = now_s;
}

void ProxiedArm::Learn(const RobotState& after, double now_s) {
  const double elapsed = now_s - given_->time_s;
  const double due = profile_.execute_steps / profile_.rate_hz;
  const double first_due = (profile_.execute_steps - 1) / profile_.rate_hz;
  if (profile_.real_time && elapsed < kEarliest * first_due) {
    return Distrust(Doubt::kEarly,
                    absl::StrCat("the next observation came after ", elapsed, " s; execute_steps ",
                                 profile_.execute_steps, " take ", due, " s at rate_hz ",
                                 profile_.rate_hz, ": correct either in the profile"));
  }
  if (profile_.real_time && elapsed > due + profile_.limits.pause_s) {
    return Distrust(Doubt::kPause, absl::StrCat("the next observation came after ", elapsed, " s"));
  }
  const int first = profile_.first_step, steps = profile_.execute_steps;
  const Given given = *given_;
  const ArmMotion motion = motion_.Between(given.before, after, given.own.middleRows(first, steps),
                                           given.sent.middleRows(first, steps));
  Take(motion, first + steps - 1, profile_.real_time ? elapsed : due);
  if (!profile_.joint_space() || steps != 1 || !given_) return;
  // Every step's state is seen.
  if (profile_.real_time && std::abs(elapsed - due) > 0.5 * due) ++stretch_;
  rows_.push_back({stretch_, given.before.q, given.sent.row(first).transpose()});
}

int ProxiedArm::RowDue(double since_observation_s) const {
  const double row = std::ceil(since_observation_s * profile_.rate_hz - kSameTick);
  return static_cast<int>(std::clamp(row, 0.0, static_cast<double>(WireLimits::kHorizon)));
}

// Step i since the observation of a chunk executes its row i from the row on that was due when it
// came; before that the chunk before it goes on.
void ProxiedArm::LearnAsynchronously(const RobotState& after, double now_s) {
  const double elapsed = now_s - given_->asked_s;
  const auto rows = static_cast<double>(given_->own.rows());
  const double due = std::round(elapsed * profile_.rate_hz);
  if (due < 1) {
    return Distrust(Doubt::kEarly, absl::StrCat("the next observation came after ", elapsed,
                                                " s, before a step of ", 1 / profile_.rate_hz,
                                                " s: correct rate_hz in the profile"));
  }
  if (due > rows)
    return Distrust(Doubt::kPause, absl::StrCat("the next observation came after ", elapsed, " s"));
  given_->played = static_cast<int>(due);
  const Given given = *given_;
  const int old = std::min(given.enters, given.played);
  if (old == 0 || (before_ && before_->played + old <= before_->own.rows())) {
    Eigen::MatrixXd own = given.own.topRows(given.played), sent = given.sent.topRows(given.played);
    if (old > 0) {
      own.topRows(old) = before_->own.middleRows(before_->played, old);
      sent.topRows(old) = before_->sent.middleRows(before_->played, old);
    }
    Take(motion_.Between(given.before, after, own, sent), given.played - 1, elapsed);
  }
  before_ = std::exchange(given_, std::nullopt);
}

std::string ProxiedArm::Misfit(const OpenpiValue& value, const OpenpiExecuted& executed) const {
  const auto lacks = [&value](const char* key) { return value.Find(key) == nullptr; };
  // Where they are not said they read as an arm that stands still.
  if (!profile_.joint_space() && lacks("p_base_tool"))
    return "executed has no p_base_tool, and the actions are the tool's";
  if (!profile_.action.rotation.empty() && lacks("q_base_tool"))
    return "executed has no q_base_tool, and the actions turn the tool";
  const uint64_t given = given_->prediction_id;
  if (given != 0 && executed.prediction_id != 0 && executed.prediction_id != given) {
    return absl::StrCat("executed is of prediction ", executed.prediction_id,
                        ", the chunk that was given last is ", given);
  }
  const auto end = executed.first_step + static_cast<Eigen::Index>(executed.states.size()) - 1;
  if (end > given_->own.rows())
    return absl::StrCat("executed ends at step ", end, " of ", given_->own.rows());
  const Eigen::Index joints = executed.states[0].q.size();
  if (profile_.joint_space() && joints != static_cast<Eigen::Index>(columns_.size()))
    return absl::StrCat("executed/q has ", joints, " joints, the profile ", columns_.size());
  return "";
}

void ProxiedArm::LearnMeasured(const OpenpiValue& value) {
  if (!given_) return;
  PolicySpec policy;
  policy.action_dim = profile_.action.size;
  policy.horizon = static_cast<int>(given_->own.rows());
  const absl::StatusOr<OpenpiExecuted> executed =
      ReadOpenpiExecuted(value, policy, 1 / profile_.rate_hz);
  if (!executed.ok()) return Distrust(Doubt::kExecuted, std::string(executed.status().message()));
  // One that is in already is said again after a lost reply.
  if (executed->sequence != 0 && executed->sequence <= sequence_) return;
  sequence_ = executed->sequence;
  if (const std::string words = Misfit(value, *executed); !words.empty())
    return Distrust(Doubt::kExecuted, words);
  const auto steps = static_cast<int>(executed->states.size()) - 1;
  const int first = executed->first_step;
  Eigen::MatrixXd sent = given_->sent.middleRows(first, steps);
  if (executed->sent_commands.rows() > 0) sent = OwnColumns(executed->sent_commands.cast<double>());
  const ArmMotion motion =
      motion_.Measured(executed->states, given_->own.middleRows(first, steps), sent);
  const bool last = executed->last_of_episode;
  Take(motion, first + steps - 1, steps / profile_.rate_hz);
  if (!doubt_ && profile_.joint_space()) {
    // Reports that do not follow each other are not one motion.
    const Eigen::VectorXd& begin = executed->states[0].q;
    if (last_q_.size() == begin.size() && !last_q_.isApprox(begin, kSameJoints)) ++stretch_;
    last_q_ = executed->states.back().q;
    for (int i = 0; i < steps; ++i)
      rows_.push_back({stretch_, executed->states[static_cast<size_t>(i)].q, sent.row(i)});
  }
  given_.reset();
  if (last && !doubt_) NewEpisode();
}

void ProxiedArm::Take(const ArmMotion& motion, Eigen::Index last_row, double dt_s) {
  if (rows_.size() > kMostRows) rows_.clear();
  if (motion.jump) {
    return Distrust(Doubt::kJump,
                    absl::StrCat("the arm is ", motion.surprise.norm(),
                                 " beyond what its commands explain; another episode, or another "
                                 "robot than the profile's"));
  }
  if (const absl::Status learned = correction_.Observe(motion, dt_s); !learned.ok())
    return Distrust(Doubt::kState, std::string(learned.message()));
  limiter_.Executed(given_->correction.row(last_row).transpose());
  const double steps = profile_.joint_space() ? 1 : static_cast<double>(motion.chunk.steps.size());
  residual_ = (motion.surprise / steps).cwiseQuotient(scale_);
}

Eigen::MatrixXd ProxiedArm::OwnColumns(const Eigen::MatrixXd& actions) const {
  Eigen::MatrixXd own(actions.rows(), static_cast<Eigen::Index>(columns_.size()));
  for (Eigen::Index j = 0; j < own.cols(); ++j)
    own.col(j) = scale_[j] * actions.col(columns_[static_cast<size_t>(j)]);
  return own;
}

std::optional<std::string> ProxiedArm::Answered(std::string_view message, bool text, double now_s,
                                                ProxyMode mode) {
  report_ = {.outcome = AnswerOutcome::kOther};
  if (outstanding_ == 0) return std::nullopt;  // the greeting, or what nobody asked for
  --outstanding_;
  std::optional<std::string> answer;
  if (mode == ProxyMode::kOff || off_) {
    off_ = true;
    report_.outcome = AnswerOutcome::kOff;
    return answer;
  }
  if (text) {
    Distrust(Doubt::kServer, "a text frame");
  } else if (seen_ && outstanding_ == 0) {
    answer = Correct(message, now_s, mode);
  }
  if (doubt_) {
    report_.outcome = AnswerOutcome::kDoubt;
    report_.doubt = doubt_;
    report_.words = words_;
  }
  report_.episode = episode_;
  report_.chunk = chunk_;
  report_.residual = std::exchange(residual_, Eigen::VectorXd());
  seen_.reset();
  return answer;
}

std::optional<std::string> ProxiedArm::Correct(std::string_view message, double now_s,
                                               ProxyMode mode) {
  const absl::StatusOr<ActionBlock> block = FindActions(message);
  const auto refuse = [this](const std::string& words) {
    Distrust(Doubt::kActions, words);
    return std::nullopt;
  };
  if (!block.ok()) return refuse(std::string(block.status().message()));
  const int enters = profile_.asynchronous ? RowDue(now_s - seen_s_) : profile_.first_step;
  const int end = enters + (profile_.asynchronous ? 1 : profile_.execute_steps);
  if (block->cols != profile_.action.size || block->rows < end) {
    return refuse(absl::StrCat(
        "actions are [", block->rows, ", ", block->cols,
        "], the profile's robot executes steps up to ", end, " of ", profile_.action.size,
        " numbers", profile_.asynchronous ? "; earlier ones had passed when it came" : ""));
  }
  const Eigen::MatrixXd actions = ReadActions(message, *block);
  if (!actions.allFinite()) return refuse("an action is not finite");
  ++chunk_;
  Given given;
  given.own = given.sent = OwnColumns(actions);
  given.before = *seen_;
  given.asked_s = seen_s_;
  given.time_s = now_s;
  given.enters = enters;
  given.prediction_id = block->prediction_id;
  given.correction = Eigen::MatrixXd::Zero(given.own.rows(), given.own.cols());
  std::optional<std::string> answer;
  if (trusted_) {
    Eigen::MatrixXd wanted = (method_.gain - 1) * given.own;
    wanted.rowwise() += correction_.Value().transpose();
    if (!wanted.allFinite()) {
      correction_ = ArmCorrection(profile_, method_);
      Distrust(Doubt::kCorrection, "the correction is not finite");
      return std::nullopt;
    }
    const bool shadow = mode == ProxyMode::kShadow;
    bool changed = false;
    std::string bytes(message);
    Eigen::VectorXd now = limiter_.applied();
    if (before_) {  // which goes on until this one is entered
      const Eigen::Index last =
          std::min<Eigen::Index>(before_->played + enters, before_->correction.rows());
      now = before_->correction.row(last - 1).transpose();
    }
    for (int row = 0; row < block->rows; ++row) {
      // Steps before the first are not executed.
      if (row >= enters) now = limiter_.Next(now, wanted.row(row).transpose());
      for (size_t j = 0; j < columns_.size(); ++j) {
        const auto at = static_cast<Eigen::Index>(j);
        const int col = columns_[j];
        const double own = actions(row, col);
        double value = own + now[at] / scale_[at];
        if (!profile_.action.low.empty()) {
          const auto k = static_cast<size_t>(col);
          value = std::clamp(value, std::min(profile_.action.low[k], own),
                             std::max(profile_.action.high[k], own));
        }
        const double written = value == own ? own : WriteAction(bytes, *block, row, col, value);
        changed = changed || written != own;
        now[at] = given.correction(row, at) = scale_[at] * (written - own);
        if (!shadow) given.sent(row, at) = scale_[at] * written;
      }
    }
    const auto hunts = hunting_.Add(given.correction.row(end - 1).transpose());
    if (hunts && !shadow) {
      hunted_ = absl::StrCat(
          "the correction of ", profile_.axes()[static_cast<size_t>(*hunts)],
          " swings to and fro; correct `nominal` or execute_steps in the profile, look at an arm "
          "that is well with --shadow, then `robostress proxy on`");
      Distrust(Doubt::kHunting, hunted_);
      return std::nullopt;
    }
    report_.outcome = shadow    ? AnswerOutcome::kShadow
                      : changed ? AnswerOutcome::kCorrected
                                : AnswerOutcome::kZero;
    report_.correction = given.correction.row(end - 1).transpose().cwiseQuotient(scale_);
    if (changed && !shadow) answer = std::move(bytes);
  }
  given_ = std::move(given);
  return answer;
}

}  // namespace robostress
