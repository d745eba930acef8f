#include "robot_client/policy_link.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/image.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kNsPerSecond = 1e9;
constexpr int kFailuresUntilNewSession = 3;
constexpr size_t kChunkStarts = 128;  // more than a server keeps predictions

// A session that a server no longer knows, or whose disk lost what it acknowledged.
bool SessionLost(const absl::Status& status) {
  return absl::IsNotFound(status) || absl::IsDataLoss(status);
}

ArmVector RowOf(const Eigen::MatrixXf& rows, int row, const ArmAxes& axes) {
  ArmVector v{};
  for (int i = 0; i < axes.count(); ++i) v[i] = static_cast<double>(rows(row, i));
  return v;
}

}  // namespace

PolicyLink::PolicyLink(const PolicyLinkOptions& options, ControlLoop* loop, Clock* clock,
                       std::vector<FrameSource*> cameras, Connect connect,
                       FeedbackAssembler::ForwardKinematics forward)
    : options_(options),
      loop_(loop),
      clock_(clock),
      cameras_(std::move(cameras)),
      connect_(std::move(connect)),
      axes_(loop->axes()),
      assembler_(options.feedback, loop->period_s(), std::move(forward), loop->axes()) {
  deliver_ = [loop](const ArmChunk& chunk) { loop->AnswerPrediction(chunk); };
  loop_->AddReader(&records_);
  loop_->OnPredictionRequested([this] { Wake(); });
}

absl::Status PolicyLink::Open() {
  RS_ASSIGN_OR_RETURN(endpoint_, connect_());
  spec_ = endpoint_->spec();
  started_episode_ = -1;
  sequence_ = 0;
  failures_ = 0;
  if (spec_.action_dim != axes_.count() || spec_.state_dim != axes_.count() ||
      spec_.control_space == ControlSpace::kEndEffector) {
    return absl::InvalidArgumentError(absl::StrCat(
        "policy '", spec_.name, "' is for another robot: it has ", spec_.state_dim, " states and ",
        spec_.action_dim, " actions",
        spec_.control_space == ControlSpace::kEndEffector ? " that move an end effector" : "",
        ", this arm ", axes_.count(), " of each (", axes_.joints, " joints [rad]",
        axes_.gripper ? " and the gripper [m]" : "",
        "). Serve a policy that was trained in joint "
        "space: `robostress serve --policy nano-piper` comes with the source"));
  }
  if (!axes_.gripper) {
    return absl::InvalidArgumentError(absl::StrCat(
        "this arm has ", axes_.text(),
        ", and the last of a policy's actions is a gripper's: its "
        "feedback could not be reckoned; describe the gripper in the robot file, or leave --server "
        "out"));
  }
  std::vector<std::string> names;
  for (const FrameSource* camera : cameras_) names.push_back(camera->name());
  if (names != spec_.cameras) {
    return absl::InvalidArgumentError(absl::StrCat(
        "policy '", spec_.name, "' wants the cameras [", absl::StrJoin(spec_.cameras, ", "),
        "] in this order, the client has [", absl::StrJoin(names, ", "), "]; type ",
        absl::StrJoin(spec_.cameras, " ",
                      [](std::string* out, const std::string& name) {
                        absl::StrAppend(out, "--camera ", name, "=SOURCE");
                      }),
        ", or the same under cameras: in the configuration (SOURCE as v4l2:/dev/v4l/by-id/..., "
        "or synthetic for a rehearsal)"));
  }
  if (options_.rtc_rows > 0 && !spec_.inpaints) {
    return absl::InvalidArgumentError(
        absl::StrCat("control.player.rtc_rows is ", options_.rtc_rows, ", and policy '", spec_.name,
                     "' cannot go on from a running chunk; set it to 0"));
  }
  if (spec_.horizon > ArmChunk::kMaxRows) {
    return absl::InvalidArgumentError(absl::StrCat("policy '", spec_.name, "' predicts ",
                                                   spec_.horizon, " steps, at most ",
                                                   ArmChunk::kMaxRows, " are taken"));
  }
  absl::MutexLock lock(&mu_);
  ++counters_.sessions;
  return absl::OkStatus();
}

void PolicyLink::StartEpisode(const EpisodeKey& key) {
  absl::MutexLock lock(&mu_);
  keys_[loop_->episode() + 1] = key;
}

PolicyLinkCounters PolicyLink::counters() const {
  absl::MutexLock lock(&mu_);
  return counters_;
}

absl::Status PolicyLink::last_error() const {
  absl::MutexLock lock(&mu_);
  return last_error_;
}

void PolicyLink::Note(const absl::Status& error, uint64_t PolicyLinkCounters::*counter) {
  absl::MutexLock lock(&mu_);
  last_error_ = error;
  ++(counters_.*counter);
}

absl::Status PolicyLink::Look(FrameSource& camera, FrameRecord& record, Observation& observation) {
  const std::shared_ptr<const Frame> frame = camera.Latest();
  record.observed_ns = clock_->now_ns();
  if (frame == nullptr) {
    return absl::UnavailableError(absl::StrCat(
        "camera '", camera.name(), "' has delivered nothing: ", camera.status().message()));
  }
  record.sequence = frame->sequence;
  record.stamp_ns = frame->stamp_ns;
  if (FromTheFuture(frame->stamp_ns, record.observed_ns)) {
    record.use = FrameUse::kFuture;
    return FutureStampError(camera.name(), frame->stamp_ns, record.observed_ns);
  }
  const double age = static_cast<double>(record.observed_ns - frame->stamp_ns) / kNsPerSecond;
  if (age > options_.max_frame_age_s) {
    record.use = FrameUse::kStale;
    return absl::UnavailableError(absl::StrCat(
        "camera '", camera.name(), "' is ", age,
        " s behind: ", camera.status().ok() ? "its pictures stopped" : camera.status().message()));
  }
  record.use = FrameUse::kShown;
  const Image& image = frame->image;
  const bool fits = spec_.resizes_images ||
                    (image.width == spec_.image_width && image.height == spec_.image_height);
  // As demonstration/training_files makes the pictures that such a policy is trained on.
  observation.views.push_back(
      {camera.name(), fits ? image : ResizeArea(image, spec_.image_width, spec_.image_height)});
  if (keep_pictures_) record.picture = std::make_shared<Image>(observation.views.back().image);
  return absl::OkStatus();
}

// Every camera is looked at, also after a stale one: the record says how old each was.
absl::StatusOr<Observation> PolicyLink::Observe(const PredictionRequest& request) {
  Observation observation;
  observation.instruction = options_.instruction;
  looked_.clear();
  absl::Status first;
  for (FrameSource* camera : cameras_) {
    FrameRecord record{request.id, 0, request.episode, request.chunk};
    camera->name().copy(record.camera.data(), record.camera.size() - 1);
    first.Update(Look(*camera, record, observation));
    looked_.push_back(record);
  }
  if (!first.ok()) {
    absl::MutexLock lock(&mu_);
    ++counters_.stale_frames;
    return first;
  }
  observation.proprioception.resize(axes_.count());
  for (int i = 0; i < axes_.count(); ++i)
    observation.proprioception[i] = static_cast<float>(request.position[i]);
  return observation;
}

std::optional<RunningRows> PolicyLink::RunningOf(const PredictionRequest& request) const {
  const Eigen::Index left = newest_.rows() - request.row;
  if (options_.rtc_rows == 0 || request.running < 0 || request.running != newest_chunk_ ||
      request.episode != newest_episode_ || left < 1)
    return std::nullopt;
  RunningRows running;
  running.actions = newest_.bottomRows(left);
  running.held = std::min(options_.rtc_rows, static_cast<int>(left));
  return running;
}

void PolicyLink::PushFrames(uint64_t prediction_id) {
  if (frames_ == nullptr) return;
  uint64_t lost = 0;
  for (FrameRecord& record : looked_) {
    record.prediction_id = prediction_id;
    lost += frames_->Push(record) ? 0 : 1;
  }
  looked_.clear();
  absl::MutexLock lock(&mu_);
  counters_.frame_records_lost += lost;
}

absl::Status PolicyLink::PrepareSession(int episode) {
  if (endpoint_ == nullptr) RS_RETURN_IF_ERROR(Open());
  if (started_episode_ == episode) return absl::OkStatus();
  EpisodeKey key;
  {
    absl::MutexLock lock(&mu_);
    const auto found = keys_.find(episode);
    key = found == keys_.end() ? EpisodeKey{0, episode} : found->second;
    counters_.residual = {};
  }
  RS_RETURN_IF_ERROR(endpoint_->StartEpisode(key));
  started_episode_ = episode;
  return absl::OkStatus();
}

absl::Status PolicyLink::Answer(const PredictionRequest& request, ArmChunk& chunk) {
  RS_ASSIGN_OR_RETURN(const Observation observation, Observe(request));
  RS_RETURN_IF_ERROR(PrepareSession(request.episode));
  const int64_t before = clock_->now_ns();
  const std::optional<RunningRows> running = RunningOf(request);
  RS_ASSIGN_OR_RETURN(const PredictedChunk prediction,
                      running ? endpoint_->PredictAfter(observation, request.chunk, *running)
                              : endpoint_->Predict(observation, request.chunk));
  const double took = static_cast<double>(clock_->now_ns() - before) / kNsPerSecond;
  const Eigen::MatrixXf& policy =
      prediction.policy_actions.size() > 0 ? prediction.policy_actions : prediction.actions;
  if (prediction.actions.cols() != axes_.count() || policy.cols() != axes_.count() ||
      policy.rows() != prediction.actions.rows() || prediction.actions.rows() > ArmChunk::kMaxRows)
    return absl::InternalError(absl::StrCat("policy '", spec_.name, "' predicted ",
                                            prediction.actions.rows(), " x ",
                                            prediction.actions.cols(), " actions"));
  newest_ = policy;
  newest_episode_ = request.episode;
  newest_chunk_ = request.chunk;
  absl::MutexLock lock(&mu_);
  ++counters_.predictions;
  counters_.longest_prediction_s = std::max(counters_.longest_prediction_s, took);
  counters_.adapter_version = prediction.adapter_version;
  chunk.failed = false;
  chunk.prediction_id = prediction.prediction_id | (counters_.sessions << kSessionShift);
  chunk.rows = static_cast<int32_t>(prediction.actions.rows());
  for (int i = 0; i < chunk.rows; ++i) {
    chunk.requested[i] = RowOf(prediction.actions, i, axes_);
    chunk.policy[i] = RowOf(policy, i, axes_);
  }
  chunk_start_[chunk.prediction_id] = request.position;
  while (chunk_start_.size() > kChunkStarts) chunk_start_.erase(chunk_start_.begin());
  return absl::OkStatus();
}

void PolicyLink::SendFeedback() {
  TickRecord record;
  while (records_.Pop(record)) {
    std::optional<ExecutedChunk> chunk = assembler_.Add(record);
    if (!chunk) continue;
    uint64_t session = 0;
    {
      absl::MutexLock lock(&mu_);
      session = counters_.sessions;
      const auto start = chunk_start_.find(chunk->prediction_id);
      if (start != chunk_start_.end()) counters_.residual.Add(*chunk, start->second);
      const auto key = keys_.find(chunk->episode);
      chunk->task = key == keys_.end() ? 0 : key->second.task;
      chunk->episode = key == keys_.end() ? chunk->episode : key->second.episode;
      if (endpoint_ == nullptr || (chunk->prediction_id >> kSessionShift) != session) {
        ++counters_.feedback_of_lost_sessions;
        continue;
      }
    }
    chunk->prediction_id &= (uint64_t{1} << kSessionShift) - 1;
    chunk->sequence = sequence_ + 1;
    const absl::Status status = endpoint_->SendFeedback(*std::move(chunk));
    if (absl::IsFailedPrecondition(status) || absl::IsInvalidArgument(status) ||
        SessionLost(status)) {
      Note(status, &PolicyLinkCounters::failed_feedback);
      if (SessionLost(status)) endpoint_.reset();
      continue;
    }
    // Taken: sent, or kept by the endpoint until the stream is back.
    ++sequence_;
    absl::MutexLock lock(&mu_);
    ++counters_.feedback_sent;
    if (!status.ok()) last_error_ = status;
  }
  absl::MutexLock lock(&mu_);
  counters_.feedback = assembler_.counters();
}

bool PolicyLink::Serve() {
  bool served = false;
  PredictionRequest request;
  while (loop_->prediction_requests().Pop(request)) {
    served = true;
    answer_.request = request.id;
    answer_.episode = request.episode;
    answer_.chunk = request.chunk;
    answer_.played = request.played;
    answer_.observed_ns = request.asked_ns;
    answer_.failed = true;
    answer_.rows = 0;
    const absl::Status status = Answer(request, answer_);
    answer_.invalid = absl::IsInvalidArgument(status) || absl::IsInternal(status);
    if (status.ok()) {
      failures_ = 0;
    } else {
      Note(status, &PolicyLinkCounters::failed_predictions);
      ++failures_;
      if (SessionLost(status) ||
          (failures_ >= kFailuresUntilNewSession && absl::IsFailedPrecondition(status)))
        endpoint_.reset();
    }
    deliver_(answer_);
    PushFrames(status.ok() ? answer_.prediction_id : 0);
  }
  SendFeedback();
  return served;
}

void PolicyLink::Run(const std::atomic<bool>& stop) {
  while (!stop.load(std::memory_order_acquire)) {
    Serve();
    // Every 20 ms for feedback; a request ends the wait at once.
    static_cast<void>(wake_.try_acquire_for(std::chrono::milliseconds(20)));
  }
}

}  // namespace robostress
