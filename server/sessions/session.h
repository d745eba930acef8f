#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "adapter/command_correction.h"
#include "adapter/feedback_buffer.h"
#include "adapter/lora_adapter.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "adapter/update_schedule.h"
#include "common/random.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "server/inference/adaptation.h"
#include "server/inference/batcher.h"
#include "server/inference/prefix_store.h"
#include "server/policies/policy.h"
#include "server/sessions/prediction.h"
#include "server/sessions/state_rules.h"

namespace robostress {

namespace v1 {
class StatePrediction;
class StateRecord;
}  // namespace v1
class SessionJournal;
struct AdaptationState;
struct SessionSnapshot;

// What sessions share. Must outlive them.
struct SessionResources {
  std::shared_ptr<const FlowPolicy> policy;
  AdaptationLoop* adaptation = nullptr;
  Batcher* inference = nullptr;
  absl::Duration lockstep_timeout =
      absl::Seconds(120);  // for feedback that was announced and does not come
  std::shared_ptr<PrefixStore> prefixes = std::make_shared<PrefixStore>();
  // Of sessions with a journal: a snapshot is due after so much.
  uint64_t snapshot_bytes = uint64_t{64} << 20;
  uint64_t snapshot_records = 1024;
  // Predictions are on the disk before they are answered, so that a loss of power costs none. Off:
  // they survive the server's end, not the machine's.
  bool sync_predictions = false;
  AdaptationLoop* lockstep_adaptation = nullptr;  // of lockstep sessions; null: `adaptation`
  int max_view_side = 0;                          // [px] of any view; 0: the policy's own limit
};

// How one prediction is served; decides no result.
struct PredictOptions {
  Priority priority = Priority::kUnspecified;          // ROBOT in async, SIMULATION in lockstep
  absl::Duration deadline = absl::InfiniteDuration();  // from now on; async only
  std::function<bool()> cancelled;                     // PredictionJob
};

struct FeedbackResult {
  uint64_t sequence = 0;  // every chunk up to this one is in
  uint64_t updates_applied = 0;
  bool durable = false;    // and on disk
  bool duplicate = false;  // it was in already
};

// Where a client that comes back goes on.
struct SessionPosition {
  uint64_t feedback_sequence = 0;   // watermark
  uint64_t last_prediction_id = 0;  // 0: none yet
  uint64_t updates_applied = 0;
  std::optional<std::pair<int, int>> episode;  // (task, episode) of the last StartEpisode
  int next_chunk = 0;                          // after the last that was predicted in it
};

struct SessionCounters {
  SessionStats stats;
  int buffered_chunks = 0;
  uint64_t predictions = 0;
  PrefixStore::Counters prefixes;  // of all sessions that share the store
  uint64_t updates_refused = 0;    // loss or gradient was not finite
  uint64_t updates_guarded = 0;    // refused by the guard
  uint64_t predictions_dropped =
      0;  // kept for feedback that had not come when kMaxOutstanding others had been made
  uint64_t duplicates = 0;  // feedback that was in already
  uint64_t resumes = 0;     // since this server started
  uint64_t rollbacks = 0;
  uint64_t steps_masked = 0;        // by the client
  uint64_t steps_impossible = 0;    // by the server (adapter/plausible_motion.h)
  uint64_t journal_bytes = 0;       // since the last snapshot
  uint64_t snapshots_failed = 0;    // e.g. the disk was full; the journal goes on
  uint64_t predictions_unkept = 0;  // not written, the disk was full; answered nevertheless
};

// One robot with one adapter. All functions may be called from any thread.
//
// An update is a function of the feedback sequence: feedback is taken in order of its sequence
// numbers, an update is triggered by its 32nd, 40th, 48th ... chunk since the last clear and
// samples from the buffer as it was then; where the update runs and when it is published only
// decides which prediction sees it first. Lockstep removes that freedom too.
//
// With a journal, whatever changes that sequence (feedback, episodes, import, rollback, pins) is on
// disk before it is applied and answered, so the state in memory is never ahead of the disk, and a
// session made from the disk by replaying the sequence has the same bits.
class Session : public std::enable_shared_from_this<Session> {
 public:
  static constexpr size_t kMaxOutstanding =
      64;  // predictions kept for their feedback; the oldest are dropped
  static constexpr int kMaxPendingUpdates = 8;  // then Feedback waits

  // In memory only. Refuses method options that make no sense together. `owner` is unique among the
  // sessions of an AdaptationLoop.
  static absl::StatusOr<std::shared_ptr<Session>> Create(SessionSpec spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner,
                                                         const GuardOptions& guard = {});
  ~Session();

  // Before the first call of another function: takes what the folder holds, if anything, and writes
  // there from now on (server/sessions/journal/). FAILED_PRECONDITION: another base model or format;
  // DATA_LOSS: damaged, a state that breaks StateRules, or one whose replay fails.
  absl::Status Recover(const std::string& folder);
  // The same with a journal that is new.
  void SetJournal(std::unique_ptr<SessionJournal> journal);

  const PolicySpec& policy_spec() const { return policy_spec_; }
  const SessionSpec& spec() const { return spec_; }
  bool durable() const { return journal_ != nullptr; }

  // A task other than the last one is a boundary: the buffer is cleared after feedback
  // `last_sequence`. May be repeated.
  absl::Status StartEpisode(int task, int episode, uint64_t last_sequence)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int task, int episode,
                                         int chunk, uint64_t last_sequence,
                                         const PredictOptions& options = {})
      ABSL_LOCKS_EXCLUDED(mu_);
  // A sequence number that is in already is acknowledged and counted, and has no effect; a gap is
  // refused. RESOURCE_EXHAUSTED: the disk is full, nothing was taken.
  absl::StatusOr<FeedbackResult> Feedback(const ExecutedChunk& executed)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);

  // A prediction whose feedback may still come, with all that was answered; `prediction_id` 0: the
  // newest. FAILED_PRECONDITION says which ones are kept.
  absl::StatusOr<Prediction> Recall(uint64_t prediction_id) ABSL_LOCKS_EXCLUDED(mu_);
  // Counts feedback that is in already and acknowledges it; nullopt: it is not in.
  std::optional<FeedbackResult> Repeated(uint64_t sequence) ABSL_LOCKS_EXCLUDED(mu_);

  SessionPosition Position() ABSL_LOCKS_EXCLUDED(mu_);
  void CountResume() ABSL_LOCKS_EXCLUDED(mu_);
  // Why the session computes no further; OK while it does.
  absl::Status failure() ABSL_LOCKS_EXCLUDED(mu_);
  // Lockstep: with every update due.
  absl::StatusOr<SessionCounters> Counters() ABSL_LOCKS_EXCLUDED(mu_);
  // As they are now, for operators; does not wait.
  SessionCounters CountersNow() ABSL_LOCKS_EXCLUDED(mu_);

  // The adaptation with every update due as a safetensors file (adapter/README.md).
  absl::StatusOr<AdapterState> Export() ABSL_LOCKS_EXCLUDED(mu_);
  // Replaces the adaptation; feedback goes on after its sequence number. INVALID_ARGUMENT if it is
  // damaged or belongs to another policy or method.
  absl::StatusOr<FeedbackResult> Import(const std::string& safetensors)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  // With every update due.
  absl::Status Rollback(uint64_t version) ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  absl::Status Pin(uint64_t version, bool pinned) ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  // Held versions, oldest first; the last one is published. FAILED_PRECONDITION: the method does
  // not adapt.
  absl::StatusOr<std::vector<PublishedVersion>> Versions() const;
  // What a rollback to a held version would leave, as a safetensors file that can be imported: its
  // LoRA, a new optimiser, an empty buffer.
  absl::StatusOr<std::string> ExportVersion(uint64_t version) ABSL_LOCKS_EXCLUDED(mu_);

  // Writes a snapshot with every update due, so that recovery has nothing to replay.
  absl::Status Flush() ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  // Ends every wait with CANCELLED, now and later.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // What feedback changes, ready to be applied.
  struct TakenChunk {
    uint64_t prediction_id = 0;
    std::optional<BufferedChunk> training;        // where the method adapts
    NominalArm arm;                               // after it
    std::optional<CommandCorrection> correction;  // after it, where its episode is still open
    uint64_t impossible = 0;                      // steps that no robot can have measured
  };

  Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner,
          const GuardOptions& guard);

  // session.cc
  // Waits until feedback `sequence` is in and nothing is pending.
  absl::Status AwaitLearned(uint64_t sequence) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ClearBuffer() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status CheckBoundary(uint64_t last_sequence) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ApplyEpisode(int task, int episode, uint64_t last_sequence)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Remember(Prediction prediction) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status RequireAdapter(const char* purpose) const;

  // session_feedback.cc
  // The prediction that a chunk which is next in order reports on.
  absl::StatusOr<Prediction*> PredictionOf(const ExecutedChunk& executed)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Eq. 1 and 2: the training chunk of an executed chunk.
  absl::StatusOr<BufferedChunk> MakeTrainingChunk(const ExecutedChunk& executed,
                                                  const Prediction& prediction, NominalArm& arm)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::StatusOr<TakenChunk> Prepare(const ExecutedChunk& executed, const Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::StatusOr<FeedbackResult> TakeFeedback(const ExecutedChunk& executed)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  void Apply(const ExecutedChunk& executed, TakenChunk taken) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // With the keys and values, rebuilt where the store dropped them.
  absl::StatusOr<std::vector<std::shared_ptr<const TrainingChunk>>> WithPrefixes(
      const std::vector<BufferedChunk>& chunks) const;
  void TriggerUpdate() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void RunUpdate(uint64_t index, const std::vector<BufferedChunk>& batch,
                 const std::vector<BufferedChunk>& held_out, uint64_t sequence)
      ABSL_LOCKS_EXCLUDED(mu_);

  // session_adaptation.cc
  absl::StatusOr<AdapterState> ExportAll() ABSL_LOCKS_EXCLUDED(mu_);
  AdaptationState CurrentAdaptation() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);  // without the buffer
  absl::Status ApplyAdaptation(const AdaptationState& state) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Read, and held to all but the rules that need the buffer's size.
  absl::StatusOr<AdaptationState> ReadAdaptation(const std::string& name,
                                                 const std::string& safetensors) const;

  // session_durability.cc
  // Appends to the journal, if there is one, and returns when it is on the disk.
  absl::Status Journal(const v1::StateRecord& record) ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status JournalFeedback(const ExecutedChunk& executed, Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status SyncJournal() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  // Serialised; empty without a journal.
  std::string PredictionRecord(const Prediction& prediction) const;
  void JournalPrediction(const std::string& record, Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // What a snapshot holds of a folder that is recovered, applied to a new session.
  absl::Status Restore(const SessionSnapshot& snapshot) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Replay(const v1::StateRecord& record) ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  absl::Status ReplayEpisode(int64_t task, int64_t episode, uint64_t last_sequence)
      ABSL_LOCKS_EXCLUDED(mu_);
  // One record of a snapshot; what it holds is checked by itself, the whole in Restore.
  absl::Status ReadSnapshotRecord(const v1::StateRecord& record, SessionSnapshot& snapshot) const;
  absl::StatusOr<Prediction> ReadPrediction(const v1::StatePrediction& record) const;
  absl::Status RecoverUnguarded(const std::string& folder);
  void SnapshotIfDue() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status TakeSnapshot() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  SessionSnapshot Capture() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::shared_ptr<const PrefixStore::Prefix> PrefixOf(
      const std::shared_ptr<const Observation>& observation) const;

  uint64_t updates_applied() const {
    return adapter_ == nullptr ? 0 : adapter_->snapshot()->version;
  }

  const SessionSpec spec_;
  const SessionResources resources_;
  const PolicySpec policy_spec_;
  const uint64_t owner_;
  const GuardOptions guard_;
  const StreamKey key_;
  const ResidualOptions residual_options_;
  const StateRules rules_;
  std::unique_ptr<LoraAdapter> adapter_;     // null where the method does not adapt
  std::unique_ptr<SessionJournal> journal_;  // null: in memory only; set before the first call

  // Held by whatever changes the sequence, from its place in the journal to its effect.
  absl::Mutex order_mu_ ABSL_ACQUIRED_BEFORE(mu_);
  absl::Mutex mu_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mu_);  // an update threw: the session computes no further
  std::optional<std::pair<int, int>> episode_ ABSL_GUARDED_BY(mu_);  // (task, episode) now
  int next_chunk_ ABSL_GUARDED_BY(mu_) = 0;  // after the last that was predicted in it
  std::set<uint64_t> boundaries_
      ABSL_GUARDED_BY(mu_);  // clear the buffer after these feedback numbers
  uint64_t feedback_sequence_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t feedback_chunks_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t next_prediction_ ABSL_GUARDED_BY(mu_) = 1;
  uint64_t predictions_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t predictions_dropped_ ABSL_GUARDED_BY(mu_) = 0;
  std::map<uint64_t, Prediction> outstanding_ ABSL_GUARDED_BY(mu_);
  CommandCorrection correction_ ABSL_GUARDED_BY(mu_);
  FeedbackBuffer<BufferedChunk> buffer_ ABSL_GUARDED_BY(mu_);
  UpdateSchedule schedule_ ABSL_GUARDED_BY(mu_);
  uint64_t triggers_ ABSL_GUARDED_BY(mu_) = 0;
  int pending_updates_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t updates_refused_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t updates_guarded_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t duplicates_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t resumes_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t rollbacks_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t steps_masked_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t steps_impossible_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t snapshots_failed_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t predictions_unkept_ ABSL_GUARDED_BY(mu_) = 0;
  double last_loss_ ABSL_GUARDED_BY(mu_) = 0;
  NominalArm arm_ ABSL_GUARDED_BY(mu_);
  std::pair<int, int> arm_episode_ ABSL_GUARDED_BY(mu_) = {-1, -1};
};

}  // namespace robostress
