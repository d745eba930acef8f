#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/clock.h"
#include "common/lerobot/lerobot_dataset.h"
#include "common/std_mutex.h"
#include "robot_client/cameras/frame_source.h"
#include "robot_client/control/spsc_ring.h"
#include "robot_client/demonstration/demonstration.h"
#include "robot_client/demonstration/training_files.h"

namespace robostress {

struct DemonstrationOptions {
  std::string directory;  // gets lerobot/, shards/ and libero/
  std::string robot = "piper";
  ArmAxes axes;            // of the ticks
  double rate_hz = 30;     // of the ticks; a whole number
  bool shards = true;      // for `robostress train`; not without a camera
  ToolPoseOf libero_tool;  // with a forward kinematics, LIBERO's HDF5 too; needs two cameras
  bool keep_failures =
      false;  // in lerobot/, with next.success false; the others hold successes only
  // The action of a tick is the state of the next one, of the last its own: demonstrations without
  // a command. Add's actions are passed over.
  bool actions_are_next_states = false;
  double max_frame_age_s = 0.5;  // an older picture spoils the episode
  double most_s = 600;           // of an episode
  double most_gb = 2;            // of an episode in memory
  int small_side = 128;          // pictures in libero/ [px]
  int shard_side = 64, shard_stride = 4, shard_horizon = 50;
};

// What became of an episode.
struct DemonstrationSummary {
  bool saved = false;  // false: a failure that was not to be kept
  int64_t episode = 0;
  int64_t ticks = 0;
  double oldest_frame_ms = 0;  // among all pictures, when they were taken for their tick
  std::string text;            // a line for people
};

// Records demonstrations: whole episodes or nothing, so a killed process loses the one under way.
//
//   Begin("open the drawer")  console's thread
//   Add(tick), every tick     control thread: never waits, takes no lock, allocates nothing
//   End(true) or Discard()    console's thread; waits until the episode is on the disk
//
// Its own thread takes the cameras' newest pictures for each tick, at most 5 ms after it, and alone
// calls Latest: no policy link may run on the same cameras meanwhile.
class DemonstrationWriter {
 public:
  // Opens or makes the data set; the error names file, field and values. The cameras are started;
  // they and the clock outlive the writer. Without any the set holds states and actions alone.
  static absl::StatusOr<std::unique_ptr<DemonstrationWriter>> Create(
      DemonstrationOptions options, std::vector<FrameSource*> cameras, const Clock* clock);
  ~DemonstrationWriter();  // drops an episode under way

  // FAILED_PRECONDITION while an episode is under way or a camera gives nothing fresh.
  absl::Status Begin(const std::string& instruction);
  // False outside of episodes and where the writer is behind by 8 s, which spoils the episode.
  bool Add(const DemonstrationTick& tick);
  // An error says why nothing was saved: a camera that stopped, ticks that were lost or not finite,
  // a disk that is full. The episode is over then, and what was saved before is untouched.
  absl::StatusOr<DemonstrationSummary> End(bool success);
  absl::Status Discard();

  int64_t episodes() const { return saved_; }  // in the set

 private:
  struct Item {
    uint64_t episode = 0;
    DemonstrationTick tick;
  };
  DemonstrationWriter(DemonstrationOptions options, std::vector<FrameSource*> cameras,
                      const Clock* clock, LerobotDataset dataset);
  void Run();
  void Take(const Item& item);
  absl::Status TakePictures(const DemonstrationTick& tick);
  absl::StatusOr<DemonstrationSummary> Save(bool success);
  absl::Status WriteFiles(bool success);
  std::string TrainingFile(const char* folder, const char* ending) const;
  void RemoveUnfinished() const;
  void Clear(uint64_t episode, const std::string& instruction);

  const DemonstrationOptions options_;
  const std::vector<FrameSource*> cameras_;
  const Clock* const clock_;
  SpscRing<Item> ring_{1 << 8};
  std::atomic<uint64_t> open_{0};  // number of the episode that Add adds to; 0: none
  std::atomic<uint64_t> lost_{0};  // ticks of it
  std::atomic<int64_t> saved_{0};

  // The console's orders to the writer's thread.
  StdMutex mu_;
  std::condition_variable changed_;
  enum class Order { kNone, kBegin, kEnd, kDiscard, kQuit };
  Order order_ ABSL_GUARDED_BY(mu_) = Order::kNone;
  std::string instruction_ ABSL_GUARDED_BY(mu_);
  bool success_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t begun_ ABSL_GUARDED_BY(mu_) = 0;
  absl::StatusOr<DemonstrationSummary> answer_ ABSL_GUARDED_BY(mu_) = DemonstrationSummary{};
  absl::StatusOr<DemonstrationSummary> Ask(Order order);

  // The writer's thread.
  LerobotDataset dataset_;
  DemonstrationEpisode episode_;
  uint64_t current_ = 0;
  absl::Status spoiled_;
  double bytes_ = 0;
  int64_t oldest_frame_ns_ = 0;
  std::vector<std::shared_ptr<const Frame>> last_;  // per camera, encoded last
  std::thread thread_;
};

}  // namespace robostress
