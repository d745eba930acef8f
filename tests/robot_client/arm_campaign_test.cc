// Random faults, policies and orders against the client on an arm in software, judged by what the
// bus carried. ROBOSTRESS_ARM_EPISODES says how many (short here), ROBOSTRESS_ARM_FIRST with which
// number to begin: an episode is a function of its number.

#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/random.h"
#include "tests/robot_client/arm_world.h"

namespace robostress {
namespace {

constexpr double kPeriod = ArmWorld::kPeriod_s;
constexpr int kTicks = 210;  // 7 s

int Environment(const char* name, int otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::atoi(text);
}

// ------------------------------------------------------------------------------- what may happen

const char* const kFaults[] = {"collision",     "stall",         "motor-hot",      "over-current",
                               "under-voltage", "driver-error",  "brake",          "emergency-stop",
                               "power-off",     "joint-silent",  "silent",         "tear",
                               "foreign",       "status-silent", "status-unknown", "standby",
                               "teach",         "late"};

std::string RandomFault(RandomStream& random) {
  const std::string kind = kFaults[random.UniformInt(std::size(kFaults))];
  const bool of_joint = kind == "collision" || kind == "stall" || kind == "motor-hot" ||
                        kind == "over-current" || kind == "under-voltage" ||
                        kind == "driver-error" || kind == "power-off" || kind == "joint-silent";
  return absl::StrFormat("%s%s@%.2f+%.2f", kind,
                         of_joint ? absl::StrCat(":J", 1 + random.UniformInt(6)) : "",
                         random.Uniform(1.5, 7), random.Uniform(0.05, 1.5));
}

enum class Policy { kSway, kIntoTable, kReach, kJumps, kNonsense, kStops, kFast, kPolicies };
const char* const kPolicyNames[] = {"sway",     "into_table", "reach", "jumps",
                                    "nonsense", "stops",      "fast"};

// ---------------------------------------------------------------------------------- what must hold

// Reads the bus and the truth after every tick.
class Judge {
 public:
  Judge(ArmWorld& world, const ControlOptions& options) : world_(world), options_(options) {}

  void Tick(const TickRecord& record, bool enabling) {
    int targets = 0;
    ArmVector command{};
    for (StampedFrame received; world_.third->Receive(received);) {
      if (const auto pair = piper::DecodeJointTargets(received.frame)) {
        // The foreigner of the fault plan sends zeros to J1 and J2.
        if (pair->pair == 0 && pair->first == 0 && pair->second == 0) continue;
        command[2 * pair->pair] = pair->first;
        command[2 * pair->pair + 1] = pair->second;
        ++targets;
      }
    }
    const bool sent = (record.flags & kTickSent) != 0;
    const bool silent_state =
        record.state == ClientState::kIdle || record.state == ClientState::kFault;
    if (enabling) {
      if (record.state == ClientState::kEnabled) First(record);
      Reset();
      last_state_ = record.state;
      return;
    }
    if (silent_state && last_state_ == record.state && (targets > 0 || sent))
      Violate("a command in IDLE or FAULT");
    if (record.state == ClientState::kFault && last_state_ != record.state && sent) {
      for (int j = 0; j < piper::kJoints; ++j) {
        if (std::abs(record.sent[j] - record.position[j]) > 0.13)
          Violate("the last command of a fault is not where the arm stands");
      }
    }
    // A command that presses becomes where the arm stands, at once.
    const bool lets_go = record.state == ClientState::kHold && last_state_ != record.state &&
                         (record.flags & kTickRelaxed) != 0;
    if (lets_go) {
      Reset();
      for (int j = 0; j < piper::kJoints; ++j) {
        if (std::abs(record.sent[j] - record.position[j]) > 0.13)
          Violate("a command that lets go is not where the arm stands");
      }
    }
    if (!silent_state && sent) {
      Motion(record);
      Freshness(record);
      Space(record);
    } else {
      Reset();
    }
    Torque(record);
    Stillness(record);
    last_state_ = record.state;
  }
  const std::vector<std::string>& violations() const { return violations_; }
  double hardest_s() const { return hardest_s_; }

 private:
  void Violate(const std::string& what) {
    if (violations_.size() < 3)
      violations_.push_back(
          absl::StrFormat("%.2f s: %s", 1e-9 * static_cast<double>(world_.time.now_ns()), what));
  }
  void Reset() { known_ = 0; }

  // The first command of an enable: where the arm is, or the nearest place that it may be.
  void First(const TickRecord& record) {
    const piper::JointVector truth = world_.emulator->plant().link_angles();
    for (int j = 0; j < piper::kJoints; ++j) {
      if (std::abs(record.sent[j] - truth[j]) > 0.13)
        Violate(absl::StrCat("enabled J", j + 1, " off its place"));
    }
  }
  void Motion(const TickRecord& record) {
    constexpr double kV = 0.002, kA = 0.1, kJ = 6;  // of the wire's 0.001 degrees
    const LimiterOptions& limits = options_.limits;
    for (int j = 0; j < piper::kJoints; ++j) {
      const double q = piper::RoundToWire(record.sent[j]);
      const double v = (q - q_[j]) / kPeriod, a = (v - v_[j]) / kPeriod,
                   jerk = (a - a_[j]) / kPeriod;
      if (known_ >= 1 && std::abs(v) > limits.joint_velocity + kV)
        Violate(absl::StrFormat("J%d commanded at %.3f rad/s", j + 1, v));
      if (known_ >= 2 && std::abs(a) > limits.joint_acceleration + kA)
        Violate(absl::StrFormat("J%d commanded with %.2f rad/s^2", j + 1, a));
      if (known_ >= 3 && std::abs(jerk) > limits.joint_jerk + kJ)
        Violate(absl::StrFormat("J%d commanded with %.1f rad/s^3", j + 1, jerk));
      q_[j] = q;
      v_[j] = v;
      a_[j] = a;
    }
    ++known_;
  }
  void Freshness(const TickRecord& record) {
    if (record.state != ClientState::kRun && record.state != ClientState::kMove) return;
    const double age = 1e-9 * static_cast<double>(record.start_ns - record.stamp_ns);
    if (age > options_.watchdogs.arm_hold_s || age < 0)
      Violate(absl::StrFormat("driven on a sample %.0f ms old", 1000 * age));
  }
  void Space(const TickRecord& record) {
    const ArmModel::Clearance now = world_.model->ClearanceAt(record.sent);
    if (known_ >= 2) {
      const ArmModel::Bound bound = CrossedBound(clearance_, now);
      if (bound != ArmModel::kBounds && now[bound] < -1e-4)
        Violate(absl::StrCat("a command into ", BoundName(bound)));
    }
    clearance_ = now;
  }
  // Joints with power do not press for long, whatever happened.
  void Torque(const TickRecord& record) {
    const auto& reading = world_.emulator->plant().reading();
    ArmVector q{}, dq{};
    std::copy_n(reading.q.begin(), piper::kJoints, q.begin());
    std::copy_n(reading.dq.begin(), piper::kJoints, dq.begin());
    q[piper::kJoints] = reading.opening;
    const ArmVector needed = world_.model->Torque(q, dq, {}, 0);
    bool presses = false;
    const ArmLimits limits = world_.arm->limits();
    for (int j = 0; j < piper::kJoints; ++j) {
      // Pushed beyond its limit, where no command may lead, a joint can only be led back.
      const bool beyond = q[j] < limits.lower[j] || q[j] > limits.upper[j];
      presses = presses ||
                (!beyond && std::abs(reading.torque[j] - needed[j]) > 2 * options_.press.excess[j]);
    }
    const bool streams = record.state != ClientState::kIdle && record.state != ClientState::kFault;
    pressed_s_ = presses && streams && record.sequence != last_sequence_ ? pressed_s_ + kPeriod : 0;
    last_sequence_ = record.sequence;
    hardest_s_ = std::max(hardest_s_, pressed_s_);
    if (pressed_s_ > 1.0) Violate("pressed for more than a second");
  }
  // What stands, stands.
  void Stillness(const TickRecord& record) {
    const bool all = world_.arm->Latest().enabled;
    const bool standing = record.state == ClientState::kEnabled && all && record.faults == 0;
    stood_ticks_ = standing && last_state_ == record.state ? stood_ticks_ + 1 : 0;
    const piper::JointVector truth = world_.emulator->plant().link_angles();
    if (stood_ticks_ == 45) stood_at_ = truth;
    if (stood_ticks_ <= 45) return;
    for (int j = 0; j < piper::kJoints; ++j) {
      if (std::abs(truth[j] - stood_at_[j]) > 0.12)
        Violate(absl::StrCat("J", j + 1, " moves though nobody asked"));
    }
  }

  ArmWorld& world_;
  const ControlOptions options_;
  std::vector<std::string> violations_;
  ClientState last_state_ = ClientState::kIdle;
  int known_ = 0;  // commands in a row
  ArmVector q_{}, v_{}, a_{};
  ArmModel::Clearance clearance_{};
  double pressed_s_ = 0, hardest_s_ = 0;
  uint64_t last_sequence_ = 0;
  int stood_ticks_ = 0;
  piper::JointVector stood_at_{};
};

struct Outcome {
  std::string story;  // policy, faults
  std::vector<std::string> violations;
  std::map<std::string, int> causes;  // states entered
  double pressed_s = 0;
};

Outcome RunEpisode(int number) {
  RandomStream random(StreamKey("arm campaign").With(int64_t{number}));
  ArmWorld::Options options;
  options.profile = random.UniformInt(2) == 0 ? "new" : "used_one_year";
  options.control.limits.joint_velocity = random.Uniform(0.2, 1.5);
  for (int i = random.UniformInt(4); i > 0; --i) options.faults.push_back(RandomFault(random));
  options.start = {random.Uniform(-1, 1),     random.Uniform(0.9, 1.4), random.Uniform(-1.3, -0.8),
                   random.Uniform(-0.3, 0.3), random.Uniform(0.2, 0.7), random.Uniform(-0.5, 0.5)};
  const bool wall = random.UniformInt(3) == 0;  // something that nobody told the client of
  if (wall) {
    options.world_xml =
        absl::StrFormat(R"(<geom name="wall" type="box" size="0.02 0.5 0.5" pos="%.3f 0 0.5"/>)",
                        random.Uniform(0.35, 0.55));
  }
  const auto kind = static_cast<Policy>(random.UniformInt(static_cast<int>(Policy::kPolicies)));
  const int strange_chunk = random.UniformInt(8);
  const ArmVector toward{random.Uniform(-1, 1),
                         random.Uniform(-1, 1),
                         random.Uniform(-1, 1),
                         random.Uniform(-1, 1),
                         random.Uniform(-1, 1),
                         random.Uniform(-1, 1),
                         0};
  Outcome outcome;
  outcome.story =
      absl::StrCat(kPolicyNames[static_cast<int>(kind)], ", ", options.profile,
                   wall ? ", a wall" : "", ", faults [", absl::StrJoin(options.faults, " "), "]");
  ArmWorld world(options);
  if (!world.connected.ok()) {
    outcome.causes["not connected"] = 1;
    return outcome;
  }
  RandomStream noise(StreamKey("arm campaign policy").With(int64_t{number}));
  ArmVector jump{};
  world.policy = [&](int row, const PredictionRequest& request) {
    ArmVector target = request.position;
    const double t = (10 * request.chunk + row + 1) * kPeriod;
    const double ahead = (row + 1) * kPeriod;
    for (int j = 0; j < piper::kJoints; ++j) {
      switch (kind) {
        case Policy::kIntoTable:
          target[j] += (j == 1 ? 0.6 : j == 2 ? 0.25 : 0) * ahead;
          break;
        case Policy::kReach:
          target[j] += 0.8 * toward[j] * ahead;
          break;
        case Policy::kFast:
          target[j] += 6 * toward[j] * ahead;
          break;
        case Policy::kJumps:
          if (row == 0) jump[j] = noise.Uniform(-0.6, 0.6);
          target[j] += jump[j];
          break;
        default:
          target[j] += 0.05 * std::sin(2 * M_PI * (0.4 + 0.1 * j) * t);
      }
    }
    if (kind == Policy::kNonsense && request.chunk == strange_chunk)
      target[row % piper::kAxes] = row % 2 == 0 ? std::nan("") : 1e300;
    return target;
  };
  const auto serve = world.policy;
  Judge judge(world, options.control);
  ClientState last = ClientState::kIdle;
  for (int tick = 0; tick < kTicks; ++tick) {
    if (kind == Policy::kStops && tick == 60 + 10 * strange_chunk) world.policy = nullptr;
    const ClientState state = world.loop->state();
    uint32_t requests = 0;
    const bool eager = random.UniformInt(12) == 0;  // a person types whatever comes to mind
    if (state == ClientState::kIdle && (tick > 5 || eager)) requests |= kRequestEnable;
    if (state == ClientState::kEnabled && random.UniformInt(8) == 0) requests |= kRequestStart;
    if (state == ClientState::kHold && random.UniformInt(20) == 0)
      requests |= random.UniformInt(2) == 0 ? kRequestResume : kRequestEnd;
    if (state == ClientState::kFault && random.UniformInt(10) == 0) requests |= kRequestClear;
    if (random.UniformInt(120) == 0) requests |= kRequestHold;
    if (eager) requests |= 1u << (1 + random.UniformInt(6));
    if (random.UniformInt(1500) == 0) requests |= kRequestQuickStop;
    if (state == ClientState::kEnabled && random.UniformInt(30) == 0) {
      ArmVector to = world.loop->seen().position;
      to[random.UniformInt(piper::kJoints)] += random.Uniform(-0.4, 0.4);
      world.Move(to, random.UniformInt(2) == 0).IgnoreError();
    }
    const int64_t before = world.time.now_ns();
    const TickRecord record = world.Tick(requests);
    const bool enabling = world.time.now_ns() - before > static_cast<int64_t>(1.5e9 * kPeriod);
    judge.Tick(record, enabling);
    if (std::getenv("ROBOSTRESS_ARM_TRACE") != nullptr) {
      const auto& reading = world.emulator->plant().reading();
      std::printf(
          "%7.3f %-7s %-14s excess %5.1f %5.1f %5.1f %4.1f %4.1f %4.1f  off %6.3f %6.3f %6.3f  "
          "torque "
          "%5.1f %5.1f %5.1f  flags %x requests %x\n",
          1e-9 * static_cast<double>(record.start_ns), StateName(record.state),
          CauseName(record.cause), record.excess[0], record.excess[1], record.excess[2],
          record.excess[3], record.excess[4], record.excess[5], record.sent[0] - record.position[0],
          record.sent[1] - record.position[1], record.sent[2] - record.position[2],
          reading.torque[0], reading.torque[1], reading.torque[2], record.flags, requests);
    }
    if (record.state != last)
      ++outcome.causes[absl::StrCat(StateName(record.state), " (", CauseName(record.cause), ")")];
    last = record.state;
  }
  outcome.violations = judge.violations();
  outcome.pressed_s = judge.hardest_s();
  return outcome;
}

TEST(ArmCampaign, WhateverHappensTheBusCarriesNothingThatItMustNot) {
  const int episodes = Environment("ROBOSTRESS_ARM_EPISODES", 40);
  const int first = Environment("ROBOSTRESS_ARM_FIRST", 0);
  std::map<std::string, int> causes;
  int bad = 0;
  double pressed_s = 0;
  for (int number = first; number < first + episodes; ++number) {
    const Outcome outcome = RunEpisode(number);
    for (const auto& [cause, times] : outcome.causes) causes[cause] += times;
    pressed_s = std::max(pressed_s, outcome.pressed_s);
    if (outcome.violations.empty()) continue;
    ++bad;
    ADD_FAILURE() << "episode " << number << ": " << outcome.story << "\n  "
                  << absl::StrJoin(outcome.violations, "\n  ");
    if (bad == 20) break;
  }
  std::printf("episodes %d to %d, %d with a violation; longest press %.2f s\n", first,
              first + episodes - 1, bad, pressed_s);
  for (const auto& [cause, times] : causes) std::printf("  %-28s %6d\n", cause.c_str(), times);
}

}  // namespace
}  // namespace robostress
