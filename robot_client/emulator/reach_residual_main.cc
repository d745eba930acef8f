// piper_residual: the joint-space residual of emulated Pipers, in simulated time: what the wear
// profiles amount to, beside the paper's 32.9 % (new arm) and 35.0 % (used for a year).

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "common/random.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/can/in_process_bus.h"
#include "robot_client/emulator/piper_emulator.h"
#include "robot_client/piper/piper_arm.h"
#include "robot_client/recorder.h"

namespace robostress::piper {
namespace {

constexpr int kRate = 30;         // [Hz]
constexpr int kExecuted = 10;     // steps per chunk
constexpr double kDwell_s = 0.4;  // at the end of a motion, as for a grasp

struct CommandLine {
  std::vector<std::string> profiles = {"new", "used_one_year"};
  std::vector<double> payloads_kg = {0};
  double command_lag_ms = -1;
  double motion_s = 3;
  bool motor_encoders = false, direct = false;
  int episodes = 25, motions = 8;
  std::string record;  // directory
};

// Residual and action of one episode:
//   residual_t = q_(t+1) - target_t,  action_t = target_t - q at the start of the chunk [rad].
struct Episode {
  double residual_squares = 0, action_squares = 0;
  int steps = 0;
  double ratio() const { return std::sqrt(residual_squares / action_squares); }
  double rms() const { return std::sqrt(residual_squares / steps / kJoints); }
};

// Reaches over a table: minimum-jerk motions of motion_s between poses drawn around a forearm that
// points down and forward.
class Motion {
 public:
  Motion(int episode, double motion_s) : random_(StreamKey("piper residual").With(episode)) {
    motion_s_ = motion_s;
    Draw(to_);
    Next();
  }
  void Next() {
    from_ = to_;
    Draw(to_);
  }
  JointVector At(double t) const {
    const double s = std::min(1.0, t / motion_s_);
    const double way = s * s * s * (10 + s * (6 * s - 15));
    JointVector q;
    for (int j = 0; j < kJoints; ++j) q[j] = from_[j] + way * (to_[j] - from_[j]);
    return q;
  }
  double duration() const { return motion_s_ + kDwell_s; }

 private:
  void Draw(JointVector& q) {
    constexpr JointVector kMiddle = {0, 1.3, -1.1, 0, 0.7, 0};
    constexpr JointVector kReach = {0.7, 0.4, 0.4, 0.3, 0.35, 0.7};
    for (int j = 0; j < kJoints; ++j) q[j] = kMiddle[j] + random_.Uniform(-kReach[j], kReach[j]);
  }
  RandomStream random_;
  double motion_s_ = 0;
  JointVector from_{}, to_{};
};

ArmCommand ToCommand(const JointVector& q) {
  ArmCommand command;
  for (int j = 0; j < kJoints; ++j) command.position[j] = q[j];
  return command;
}

class Bench {
 public:
  // Records every tick and sample to `directory`, if there is one.
  static absl::StatusOr<std::unique_ptr<Bench>> Create(const EmulatorOptions& options, bool direct,
                                                       const std::string& directory) {
    auto bench = std::make_unique<Bench>();
    RS_ASSIGN_OR_RETURN(bench->emulator_,
                        PiperEmulator::Create(options, bench->bus_.Attach(), bench->time_));
    bench->time_.Add(bench->emulator_.get());
    PiperArmOptions arm;
    if (direct) arm.follow = Follow::kDirect;
    bench->arm_ = std::make_unique<PiperArm>(bench->bus_.Attach(), bench->time_, arm);
    RS_RETURN_IF_ERROR(bench->arm_->Connect());
    RS_RETURN_IF_ERROR(bench->arm_->Enable());
    if (!directory.empty()) {
      RS_ASSIGN_OR_RETURN(bench->recorder_, Recorder::Create(directory));
      bench->arm_->AddSampleReader(&bench->recorder_->samples());
    }
    return bench;
  }
  absl::Status Finish() { return recorder_ == nullptr ? absl::OkStatus() : recorder_->Finish(); }

  absl::StatusOr<Episode> Run(int episode, const CommandLine& line) {
    Motion motion(episode, line.motion_s);
    record_.state = ClientState::kEnabled;
    record_.episode = episode;
    for (int tick = 0; tick < 4 * kRate; ++tick) RS_RETURN_IF_ERROR(Tick(motion.At(0)));
    record_.state = ClientState::kRun;
    Episode result;
    int step = 0;
    for (int i = 0; i < line.motions; ++i, motion.Next()) {
      for (int tick = 0; tick < static_cast<int>(kRate * motion.duration()); ++tick, ++step) {
        if (step % kExecuted == 0) chunk_start_ = arm_->Latest().position;
        const JointVector target = motion.At(static_cast<double>(tick + 1) / kRate);
        RS_RETURN_IF_ERROR(Tick(target));
        const ArmVector& q = arm_->Latest().position;
        for (int j = 0; j < kJoints; ++j) {
          result.residual_squares += std::pow(q[j] - target[j], 2);
          result.action_squares += std::pow(target[j] - chunk_start_[j], 2);
        }
        ++result.steps;
      }
    }
    return result;
  }

 private:
  absl::Status Tick(const JointVector& target) {
    const ArmCommand command = ToCommand(target);
    if (recorder_ != nullptr) RS_RETURN_IF_ERROR(Record(command.position));
    RS_RETURN_IF_ERROR(arm_->Send(command));
    next_ns_ = std::max(next_ns_, time_.now_ns()) + 1'000'000'000 / kRate;
    time_.SleepUntil(next_ns_);
    arm_->Poll();
    return absl::OkStatus();
  }

  absl::Status Record(const ArmVector& target) {
    const ArmSnapshot measured = arm_->Latest();
    record_.start_ns = record_.due_ns = record_.sent_ns = time_.now_ns();
    record_.flags = kTickPlayed | kTickSent;
    record_.policy = record_.requested = record_.blended = record_.corrected = record_.sent =
        target;
    record_.position = measured.position;
    record_.velocity = measured.velocity;
    record_.effort = measured.effort;
    record_.stamp_ns = measured.stamp_ns;
    record_.sequence = measured.sequence;
    recorder_->ring().Push(record_);
    ++record_.tick;
    return recorder_->Drain();
  }

  EmulatedTime time_;
  InProcessBus bus_{time_};
  std::unique_ptr<Recorder> recorder_;
  TickRecord record_;
  std::unique_ptr<PiperEmulator> emulator_;
  std::unique_ptr<PiperArm> arm_;
  ArmVector chunk_start_{};
  int64_t next_ns_ = 0;
};

absl::Status Run(const CommandLine& line) {
  std::printf(
      "| profile | payload [kg] | residual, mean of %d episodes | range | rms [mrad] |\n"
      "|---|---|---|---|---|\n",
      line.episodes);
  for (const std::string& profile : line.profiles) {
    for (const double payload_kg : line.payloads_kg) {
      EmulatorOptions options;
      options.profile = profile;
      options.scene.payload_kg = payload_kg;
      options.motor_encoders = line.motor_encoders;
      options.command_lag_s = line.command_lag_ms < 0 ? -1 : line.command_lag_ms / 1000;
      double sum = 0, rms = 0, lowest = HUGE_VAL, highest = 0;
      RS_ASSIGN_OR_RETURN(const auto bench, Bench::Create(options, line.direct, line.record));
      for (int episode = 0; episode < line.episodes; ++episode) {
        RS_ASSIGN_OR_RETURN(const Episode result, bench->Run(episode, line));
        sum += result.ratio();
        rms += result.rms();
        lowest = std::min(lowest, result.ratio());
        highest = std::max(highest, result.ratio());
      }
      RS_RETURN_IF_ERROR(bench->Finish());
      std::printf("| %s | %g | %.1f %% | %.1f to %.1f %% | %.1f |\n", profile.c_str(), payload_kg,
                  100 * sum / line.episodes, 100 * lowest, 100 * highest,
                  1000 * rms / line.episodes);
      std::fflush(stdout);
    }
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::piper

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Measures the joint-space residual of emulated Pipers, in simulated time.", "piper_residual");
  robostress::piper::CommandLine line;
  app.footer(
      "\nExamples\n"
      "  piper_residual\n"
      "  piper_residual --payload-kg 0,1 --command-lag-ms 30\n"
      "  piper_residual --profile worn.yaml --episodes 3 --record runs/worn\n\n"
      "The residual of an episode is |q(t+1) - target(t)| over |target(t) - q(start of chunk)|, "
      "both\n"
      "over all executed steps and the six joints, 30 Hz, 10 steps per chunk.\n");
  app.add_option("--profile", line.profiles, "Profiles")->delimiter(',')->capture_default_str();
  app.add_option("--payload-kg", line.payloads_kg, "Payloads")
      ->delimiter(',')
      ->check(robostress::cli::Range(0.0, 3.0))
      ->capture_default_str();
  app.add_option("--command-lag-ms", line.command_lag_ms, "Default: the profile's")
      ->check(robostress::cli::Range(0.0, 1000.0));
  app.add_flag("--motor-encoders", line.motor_encoders,
               "Encoders before backlash and compliance (default: at the joints)");
  app.add_flag("--direct", line.direct,
               "Targets go to the joints' impedance controllers: no planner, no integral part");
  app.add_option("--motion-s", line.motion_s, "Duration of a reach")
      ->check(robostress::cli::Range(0.2, 20.0))
      ->capture_default_str();
  app.add_option("--episodes", line.episodes, "Per row")
      ->check(robostress::cli::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--record", line.record,
                 "Directory for ticks.csv and samples.csv, as robot_client leaves them; with one "
                 "profile and one payload");
  return robostress::RunMain(
      app, argc, argv,
      [&]() -> absl::Status {
        if (!line.record.empty() && line.profiles.size() * line.payloads_kg.size() != 1)
          return absl::InvalidArgumentError("--record takes one profile and one payload");
        return robostress::piper::Run(line);
      },
      [](const absl::Status&) { return robostress::kWrongCommand; });
}
