#include "robot_client/study/demonstration_recorder.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

constexpr double kPeriod_s = 1.0 / 30;
constexpr int kHorizon = 50;
constexpr double kTremor_s = 0.8;
constexpr double kStartSpread = 0.04;  // of the joints at an episode's start [rad]

// Displacements that come and go as raised cosines.
class Tremor {
 public:
  Tremor(const RecorderOptions& options, const StreamKey& key) : options_(options), random_(key) {}
  Eigen::Vector3d Next() {
    left_s_ -= kPeriod_s;
    if (left_s_ <= 0) {
      left_s_ = 0;
      if (random_.Uniform() < options_.tremble_rate * kPeriod_s) {
        left_s_ = kTremor_s;
        for (int i = 0; i < 3; ++i) peak_[i] = random_.Uniform(-options_.tremble, options_.tremble);
      }
    }
    return peak_ * 0.5 * (1 - std::cos(2 * M_PI * left_s_ / kTremor_s));
  }

 private:
  const RecorderOptions& options_;
  RandomStream random_;
  double left_s_ = 0;
  Eigen::Vector3d peak_ = Eigen::Vector3d::Zero();
};

struct OpenFrame {
  size_t step;
  std::vector<uint8_t> images;
  ArmVector state;
  std::array<float, 8> aux;
};

std::array<float, 8> AuxOf(const ExpertDecision& decision) {
  std::array<float, 8> aux{};
  for (int i = 0; i < 3; ++i) {
    aux[i] = static_cast<float>(decision.object[i]);
    aux[3 + i] = static_cast<float>(decision.destination[i]);
  }
  aux[6] = decision.holding ? 1 : 0;
  aux[7] = static_cast<float>(decision.progress);
  return aux;
}

void Append(const ArmVector& values, std::vector<float>& to) {
  for (int axis = 0; axis < kAxes; ++axis) to.push_back(static_cast<float>(values[axis]));
}

}  // namespace

absl::StatusOr<std::unique_ptr<DemonstrationRecorder>> DemonstrationRecorder::Create(
    const RecorderOptions& options, const StudyBenchOptions& bench) {
  std::unique_ptr<DemonstrationRecorder> recorder(new DemonstrationRecorder(options, bench));
  RS_ASSIGN_OR_RETURN(recorder->bench_, StudyBench::Create(bench));
  PiperArm& arm = recorder->bench_->arm();
  RS_RETURN_IF_ERROR(arm.Enable());
  LimiterOptions limits;
  limits.joint_jerk = std::numeric_limits<double>::infinity();  // as the committed study was made
  RS_RETURN_IF_ERROR(recorder->limiter_.Configure(limits, arm.limits(), kPeriod_s));
  recorder->limiter_.Reset(arm.Latest().position);
  return recorder;
}

absl::Status DemonstrationRecorder::Tick(const ArmVector& target) {
  RS_RETURN_IF_ERROR(bench_->arm().Send({limiter_.Limit(target)}));
  EmulatedTime& time = bench_->time();
  next_ns_ = std::max(next_ns_, time.now_ns()) + static_cast<int64_t>(kPeriod_s * 1e9);
  time.SleepUntil(next_ns_);
  bench_->arm().Poll();
  return absl::OkStatus();
}

absl::Status DemonstrationRecorder::GoHome() {
  RS_ASSIGN_OR_RETURN(ArmVector home, TableExpert::Home());
  RandomStream random(
      StreamKey("piper start").With(bench_options_.arm).With(bench_options_.task).With(attempts_));
  for (int j = 0; j < kJoints; ++j) home[j] += random.Uniform(-kStartSpread, kStartSpread);
  constexpr int kMost = 30 * 8;
  for (int tick = 0; tick < kMost; ++tick) {
    RS_RETURN_IF_ERROR(Tick(home));
    if (tick > 30 && limiter_.at_rest()) break;
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> DemonstrationRecorder::RunEpisode(int state, RecordedFrames& frames) {
  TableExpert expert(&bench_->scene());
  expert.Start(bench_->arm().Latest().position);
  Tremor tremor(
      options_,
      StreamKey("piper tremor").With(bench_options_.arm).With(bench_options_.task).With(state));
  std::vector<ArmVector> commanded;
  std::vector<OpenFrame> open;
  int left = -1;  // steps that are still recorded, once it is done
  for (size_t step = 0; static_cast<double>(step) * kPeriod_s < options_.most_s && left != 0;
       ++step) {
    if (left > 0) {
      --left;
    } else if (bench_->scene().Done(bench_->scene().Look())) {
      left = static_cast<int>(options_.after_s / kPeriod_s);
    }
    RS_ASSIGN_OR_RETURN(const ExpertDecision decision, expert.Next(kPeriod_s));
    if (step % static_cast<size_t>(options_.stride) == 0) {
      OpenFrame frame{step, {}, bench_->arm().Latest().position, AuxOf(decision)};
      for (FrameSource* camera : bench_->cameras()) {
        const auto picture = camera->Latest();
        RS_RETURN_IF_ERROR(camera->status());
        frame.images.insert(frame.images.end(), picture->image.data.begin(),
                            picture->image.data.end());
      }
      open.push_back(std::move(frame));
    }
    commanded.push_back(decision.target);
    const absl::StatusOr<ArmVector> displaced = expert.Displaced(decision, tremor.Next());
    RS_RETURN_IF_ERROR(Tick(displaced.ok() ? *displaced : decision.target));
  }
  if (left < 0) return false;
  for (const OpenFrame& frame : open) {
    frames.images.insert(frames.images.end(), frame.images.begin(), frame.images.end());
    Append(frame.state, frames.state);
    for (size_t row = 0; row < kHorizon; ++row)
      Append(commanded[std::min(frame.step + row, commanded.size() - 1)], frames.actions);
    frames.aux.insert(frames.aux.end(), frame.aux.begin(), frame.aux.end());
    frames.episode.push_back(state);
  }
  return true;
}

absl::Status DemonstrationRecorder::Record(const std::string& path) {
  RecordedFrames frames;
  for (; successes_ < options_.episodes && attempts_ < 2 * options_.episodes; ++attempts_) {
    const int state = TableScene::kFirstTrainingState + attempts_;
    RS_RETURN_IF_ERROR(GoHome());
    bench_->scene().Place(state);
    for (int i = 0; i < 6; ++i) RS_RETURN_IF_ERROR(Tick(limiter_.position()));  // objects settle
    RS_ASSIGN_OR_RETURN(const bool success, RunEpisode(state, frames));
    successes_ += success;
  }
  const TableTask& task = bench_->scene().task();
  if (successes_ < options_.episodes) {
    return absl::FailedPreconditionError(
        absl::StrCat("the expert did ", task.name, " ", successes_, " times of ", attempts_,
                     " on arm ", bench_options_.arm, ", wanted ", options_.episodes));
  }
  const auto n = static_cast<int64_t>(frames.episode.size());
  const int64_t size = bench_options_.image_size;
  SafetensorsWriter writer;
  writer.SetMetadata("suite", absl::StrCat("piper_", bench_options_.arm));
  writer.SetMetadata("task", task.name);
  writer.SetMetadata("instruction", task.instruction);
  writer.SetMetadata("version", "1");
  writer.SetMetadata("expert", absl::StrCat(successes_, "/", attempts_));
  writer.Add("images", DType::kU8, {n, 2, size, size, 3}, frames.images.data(),
             frames.images.size());
  writer.AddFloats("state", {n, kAxes}, frames.state);
  writer.AddFloats("actions", {n, kHorizon, kAxes}, frames.actions);
  writer.AddFloats("aux", {n, 8}, frames.aux);
  writer.AddInts("episode", {n}, frames.episode);
  return writer.Write(path);
}

}  // namespace robostress::piper
