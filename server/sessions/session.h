#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "adapter/command_correction.h"
#include "server/sessions/learner.h"
#include "server/sessions/outstanding_predictions.h"
#include "server/sessions/session_event.h"
#include "server/sessions/session_resources.h"
#include "server/sessions/session_types.h"
#include "server/sessions/state_rules.h"

namespace robostress {

class SessionJournal;
struct SessionSnapshot;

struct SessionCounters {
  SessionStats stats;
  int buffered_chunks = 0;
  uint64_t predictions = 0;
  PrefixStore::Counters prefixes;    // of all sessions that share the store
  uint64_t updates_refused = 0;      // loss or gradient was not finite
  uint64_t updates_guarded = 0;      // refused by the guard
  uint64_t predictions_dropped = 0;  // OutstandingPredictions::dropped
  uint64_t duplicates = 0;           // feedback that was in already
  uint64_t resumes = 0;              // since this server started
  uint64_t rollbacks = 0;
  uint64_t steps_masked = 0;        // by the client
  uint64_t steps_impossible = 0;    // by the server (adapter/plausible_motion.h)
  uint64_t journal_bytes = 0;       // since the last snapshot
  uint64_t snapshots_failed = 0;    // e.g. the disk was full; the journal goes on
  uint64_t predictions_unkept = 0;  // not written, the disk was full; answered nevertheless
};

// One robot with one adapter: the order of what happens to its predictions
// (OutstandingPredictions), its learning (Learner) and its disk (SessionJournal). All functions may
// be called from any thread.
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
  static constexpr int kMaxPendingUpdates = 8;  // then Feedback waits

  // In memory only. Refuses method options that make no sense together. `owner` is unique among the
  // sessions of an AdaptationLoop.
  static absl::StatusOr<std::shared_ptr<Session>> Create(SessionSpec spec,
                                                         const SessionResources& resources,
                                                         uint64_t owner,
                                                         const GuardOptions& guard = {});
  ~Session();

  // Before the first call of another function: takes what the folder holds, if anything, and writes
  // there from now on (server/sessions/journal/). FAILED_PRECONDITION: another base model or
  // format; DATA_LOSS: damaged, a state that breaks StateRules, or one whose replay fails.
  absl::Status Recover(const std::string& folder);
  // The same with a journal that is new.
  void SetJournal(std::unique_ptr<SessionJournal> journal);

  const PolicySpec& policy_spec() const { return policy_spec_; }
  const SessionSpec& spec() const { return spec_; }
  bool durable() const { return journal_ != nullptr; }

  // A task other than the last one is a boundary: the buffer is cleared after feedback
  // `last_sequence`. May be repeated.
  absl::Status StartEpisode(const EpisodeKey& key, uint64_t last_sequence)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  // Whoever needs the observation from now on shares it.
  absl::StatusOr<PredictedChunk> Predict(std::shared_ptr<const Observation> observation,
                                         const ChunkKey& key, uint64_t last_sequence,
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

  // The adaptation with every update due as a safetensors file (docs/adapter-files.md).
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
  Session(const SessionSpec& spec, const SessionResources& resources, uint64_t owner);

  // session.cc
  // Waits until feedback `sequence` is in and nothing is pending.
  absl::Status AwaitLearned(uint64_t sequence) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // OK while it may compute: neither cancelled nor failed.
  absl::Status CheckAlive() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ApplyEpisode(const EpisodeStarted& started) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  PredictionJob JobOf(std::shared_ptr<const Observation> observation,
                      const PredictOptions& options) const;
  void Remember(Prediction prediction) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  FeedbackResult Acknowledge(bool duplicate) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // session_feedback.cc
  absl::StatusOr<FeedbackResult> TakeFeedback(const ExecutedChunk& executed)
      ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  void Apply(const MeasuredChunk& measured, Learner::Lesson lesson,
             std::optional<CommandCorrection> correction) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Post(Learner::Update update) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void RunUpdate(const Learner::Update& update) ABSL_LOCKS_EXCLUDED(mu_);

  // session_adaptation.cc
  absl::StatusOr<AdapterState> ExportAll() ABSL_LOCKS_EXCLUDED(mu_);
  AdaptationState CurrentAdaptation() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);  // without the buffer
  absl::Status ApplyAdaptation(const AdaptationState& state) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // session_durability.cc
  // Appends an event, if there is a journal, and returns when it is on the disk.
  absl::Status Journal(const std::string& event) ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status AppendFeedback(const std::string& record, Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void AppendPrediction(const std::string& record, Prediction& prediction)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status SyncJournal() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  // How often the journal has grown by what is due since the last snapshot.
  uint64_t SnapshotsDue() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SnapshotIfDue() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  // The same on a learning thread, for predictions that no feedback follows; once at a time.
  void PostSnapshot() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Nothing where feedback is being taken or an update is pending: then the next one makes it.
  void SnapshotWhereQuiet() ABSL_LOCKS_EXCLUDED(order_mu_, mu_) ABSL_NO_THREAD_SAFETY_ANALYSIS;
  absl::Status TakeSnapshot() ABSL_EXCLUSIVE_LOCKS_REQUIRED(order_mu_) ABSL_LOCKS_EXCLUDED(mu_);
  SessionSnapshot Capture() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status RecoverUnguarded(const std::string& folder);
  // What a snapshot holds of a folder that is recovered, applied to a new session.
  absl::Status Restore(const SessionSnapshot& snapshot) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Replay(SessionEvent event) ABSL_LOCKS_EXCLUDED(order_mu_, mu_);
  absl::Status ReplayPrediction(Prediction prediction) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status ReplayEpisode(const EpisodeStarted& started) ABSL_LOCKS_EXCLUDED(mu_);

  const SessionSpec spec_;
  const SessionResources resources_;
  const PolicySpec policy_spec_;
  const uint64_t owner_;
  const ResidualOptions residual_options_;
  const StateRules rules_;
  std::unique_ptr<Learner> learner_;         // mu_ guards it but for what learner.h excepts
  std::unique_ptr<SessionJournal> journal_;  // null: in memory only; set before the first call

  // Held by whatever changes the sequence, from its place in the journal to its effect.
  absl::Mutex order_mu_ ABSL_ACQUIRED_BEFORE(mu_);
  mutable absl::Mutex mu_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mu_);  // an update threw: the session computes no further
  std::optional<EpisodeKey> episode_ ABSL_GUARDED_BY(mu_);  // now
  int next_chunk_ ABSL_GUARDED_BY(mu_) = 0;  // after the last that was predicted in it
  uint64_t feedback_sequence_ ABSL_GUARDED_BY(mu_) = 0;
  bool snapshot_posted_ ABSL_GUARDED_BY(mu_) = false;
  OutstandingPredictions outstanding_ ABSL_GUARDED_BY(mu_);
  CommandCorrection correction_ ABSL_GUARDED_BY(mu_);
  SessionCounters counted_ ABSL_GUARDED_BY(mu_);  // what no part counts by itself
};

}  // namespace robostress
