#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <semaphore>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "common/clock.h"
#include "common/rollout/policy_endpoint.h"
#include "robot_client/cameras/frame_record.h"
#include "robot_client/cameras/frame_source.h"
#include "robot_client/control/control_loop.h"
#include "robot_client/feedback_assembler.h"
#include "robot_client/joint_residual.h"

namespace robostress {

struct PolicyLinkOptions {
  std::string instruction;
  double max_frame_age_s = 0.5;  // [s], older: no prediction is asked of the server
  FeedbackOptions feedback;
  int rtc_rows = 0;  // PlayerOptions::rtc_rows
};

struct PolicyLinkCounters {
  uint64_t predictions = 0, failed_predictions = 0, stale_frames = 0;
  uint64_t sessions = 0;         // opened; more than one: adaptation began anew
  uint64_t feedback_sent = 0;    // chunks
  uint64_t failed_feedback = 0;  // chunks that the server refused
  uint64_t feedback_of_lost_sessions = 0;
  uint64_t frame_records_lost = 0;  // the recorder was behind
  double longest_prediction_s = 0;
  uint64_t adapter_version = 0;  // of the last prediction
  FeedbackCounters feedback;
  JointResidual residual;  // of the episode that runs
};

// Everything between the control loop and the policy server, in a thread that may wait: answers the
// loop's requests with predictions on the newest pictures, and reports executed chunks on the
// feedback stream after the prediction that they would otherwise delay.
//
// One session is one task: the server's adapter, its optimiser and its buffer begin anew with the
// object and are kept over its episodes. A server that comes back without the session (it was
// restarted) is given a new one; its adaptation begins anew, and the counters say so.
class PolicyLink {
 public:
  // Opens a session; may take seconds. Called again after the session was lost.
  using Connect = std::function<absl::StatusOr<std::unique_ptr<PolicyEndpoint>>()>;

  // `loop`, `clock` and the cameras outlive the link. Adds itself as a
  // reader of the loop's records; so before the first tick.
  PolicyLink(const PolicyLinkOptions& options, ControlLoop* loop, Clock* clock,
             std::vector<FrameSource*> cameras, Connect connect,
             FeedbackAssembler::ForwardKinematics forward = {});

  // Before the first round: answers go to `deliver` instead of the loop, which hands them on later.
  void DeliverThrough(std::function<void(const ArmChunk&)> deliver) {
    deliver_ = std::move(deliver);
  }

  // Before the first round: what became of every camera's picture at every request goes to
  // `frames`, which outlives the link; with `pictures` what was shown comes along.
  void RecordFrames(SpscRing<FrameRecord>* frames, bool pictures = false) {
    frames_ = frames;
    keep_pictures_ = pictures;
  }

  // Opens the session and checks that the policy fits this arm and these cameras. Its thread, or
  // before it starts.
  absl::Status Open();
  // The key of the episode that kRequestStart will start; any thread, before the request.
  void StartEpisode(const EpisodeKey& key) ABSL_LOCKS_EXCLUDED(mu_);

  // One round: the requests there are, then feedback. True when there was a request.
  bool Serve();
  // Serve until `stop`; woken by requests and every 20 ms.
  void Run(const std::atomic<bool>& stop);
  void Wake() { wake_.release(); }  // any thread; does not wait

  PolicyLinkCounters counters() const ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status last_error() const ABSL_LOCKS_EXCLUDED(mu_);
  const PolicySpec& spec() const { return spec_; }  // after Open

 private:
  static constexpr uint64_t kSessionShift =
      48;  // prediction ids carry their session's number above

  absl::Status Answer(const PredictionRequest& request, ArmChunk& chunk);
  absl::StatusOr<Observation> Observe(const PredictionRequest& request);
  // What is left of the chunk that plays; nothing where the policy is not to go on from it.
  std::optional<RunningRows> RunningOf(const PredictionRequest& request) const;
  absl::Status Look(FrameSource& camera, FrameRecord& record, Observation& observation);
  void PushFrames(uint64_t prediction_id) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status PrepareSession(int episode);
  void SendFeedback();
  // The last error, counted.
  void Note(const absl::Status& error, uint64_t PolicyLinkCounters::*counter)
      ABSL_LOCKS_EXCLUDED(mu_);

  const PolicyLinkOptions options_;
  ControlLoop* const loop_;
  Clock* const clock_;
  const std::vector<FrameSource*> cameras_;
  const Connect connect_;
  std::function<void(const ArmChunk&)> deliver_;
  SpscRing<FrameRecord>* frames_ = nullptr;
  bool keep_pictures_ = false;
  SpscRing<TickRecord> records_{1 << 10};
  std::counting_semaphore<> wake_{0};

  // The link's thread.
  const ArmAxes axes_;  // of the arm: a policy's numbers, in this order
  std::unique_ptr<PolicyEndpoint> endpoint_;
  PolicySpec spec_;
  FeedbackAssembler assembler_;
  std::map<uint64_t, ArmVector> chunk_start_;  // joints at the start of a chunk, by prediction id
  int started_episode_ = -1;                   // of the loop, announced to the session
  int failures_ = 0;                           // predictions in a row
  uint64_t sequence_ = 0;                      // of the session's feedback
  ArmChunk answer_;
  // The newest answer's own rows, its episode and chunk; the policy may be asked to go on from it.
  Eigen::MatrixXf newest_;
  int newest_episode_ = -1, newest_chunk_ = -1;
  std::vector<FrameRecord> looked_;  // at for the prediction under way

  mutable absl::Mutex mu_;
  std::map<int, EpisodeKey> keys_ ABSL_GUARDED_BY(mu_);  // by the loop's episode
  PolicyLinkCounters counters_ ABSL_GUARDED_BY(mu_);
  absl::Status last_error_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
