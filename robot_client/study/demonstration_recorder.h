#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/control/command_limiter.h"
#include "robot_client/study/study_bench.h"
#include "robot_client/study/table_expert.h"

namespace robostress::piper {

struct RecorderOptions {
  int episodes = 30;           // successful ones
  int stride = 4;              // control steps between frames
  double most_s = 20;          // of an episode [s]
  double after_s = 0.8;        // recorded after success [s]
  double tremble = 0.025;      // largest displacement of the tips by a tremor [m]
  double tremble_rate = 0.35;  // tremors per second; each lasts kTremor_s
};

struct RecordedFrames {
  std::vector<uint8_t> images;   // [frames, 2, size, size, 3]
  std::vector<float> state;      // [frames, 7] measured joints [rad], opening [m]
  std::vector<float> actions;    // [frames, 50, 7] absolute targets of this and the next steps
  std::vector<float> aux;        // [frames, 8] object 3, destination 3, holding, progress
  std::vector<int64_t> episode;  // [frames]
};

// Records the expert as a teleoperator would be: the absolute joint targets that were commanded, at
// 30 Hz, as actions (paper, sec:supp_real), pictures and joints every `stride` steps. Now and then
// the hand trembles: what is executed is displaced, what is recorded as the action is not, so that
// the data shows ways back (after DART, Laskey et al. 2017).
class DemonstrationRecorder {
 public:
  // Enables the arm.
  static absl::StatusOr<std::unique_ptr<DemonstrationRecorder>> Create(
      const RecorderOptions& options, const StudyBenchOptions& bench);

  // options.episodes successful episodes into `path`, a shard that `robostress train` reads
  // (server/training/demonstrations.h), with the expert's success rate as metadata. Episodes that
  // fail teach nothing and are replaced by the next initial state, up to as many again.
  absl::Status Record(const std::string& path);
  int attempts() const { return attempts_; }
  int successes() const { return successes_; }

 private:
  DemonstrationRecorder(const RecorderOptions& options, const StudyBenchOptions& bench)
      : options_(options), bench_options_(bench) {}
  absl::Status GoHome();
  absl::Status Tick(const ArmVector& target);
  // Whether it succeeded; its frames are appended if so.
  absl::StatusOr<bool> RunEpisode(int state, RecordedFrames& frames);

  const RecorderOptions options_;
  const StudyBenchOptions bench_options_;
  std::unique_ptr<StudyBench> bench_;
  CommandLimiter limiter_;
  int64_t next_ns_ = 0;
  int attempts_ = 0, successes_ = 0;
};

}  // namespace robostress::piper
