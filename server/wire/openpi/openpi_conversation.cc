#include "server/wire/openpi/openpi_conversation.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/rollout/message_limits.h"
#include "common/status_macros.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "server/operations/access_table.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;

double Milliseconds(Clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// `status` with the client's key that it is about.
absl::Status Named(const char* key, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat(key, ": ", status.message()));
}

}  // namespace

OpenpiConversation::OpenpiConversation(const OpenpiOptions& options, SessionHost* host,
                                       Metrics* metrics, Caller caller)
    : options_(options),
      host_(host),
      caller_(std::move(caller)),
      infer_seconds_(metrics->AddHistogram("robostress_websocket_infer_seconds",
                                           "From a decoded observation to its actions.",
                                           LatencyBounds())),
      messages_(metrics->AddCounter("robostress_websocket_messages_total",
                                    "Messages of openpi clients.")),
      bytes_in_(metrics->AddCounter("robostress_websocket_received_bytes_total",
                                    "Bytes of openpi clients' messages.")),
      bytes_out_(metrics->AddCounter("robostress_websocket_sent_bytes_total",
                                     "Bytes of their replies.")) {}

OpenpiConversation::~OpenpiConversation() {
  if (session_id_.empty()) return;
  host_->Detach(session_id_);
  if (keep_) return;
  // A server that is being stopped, or expiry, may have been first.
  host_->Close(caller_, session_id_).IgnoreError();
}

uint64_t OpenpiConversation::LargestMessage() const {
  const auto largest = [this](const PolicySpec& policy, bool asked) {
    return LargestObservationBytes(policy, LargestViewSide(policy, options_.input, asked)) +
           LargestExecutedBytes(policy);
  };
  if (!session_id_.empty()) return largest(policy_, resize_);
  uint64_t bytes = 0;
  for (const PolicySpec& policy : host_->policies()) bytes = std::max(bytes, largest(policy, true));
  return bytes;
}

std::string OpenpiConversation::Greeting() {
  const std::vector<PolicySpec> policies = host_->policies();
  OpenpiWriter writer;
  writer.Map(3).Text("server").Text("robostress").Text("extensions").List(5);
  for (const char* key : {"session", "episode", "reset", "executed", "running"}) writer.Text(key);
  writer.Text("policies").List(static_cast<uint32_t>(policies.size()));
  for (const PolicySpec& policy : policies) {
    writer.Map(12).Text("name").Text(policy.name);
    writer.Text("model_hash").Text(policy.model_hash);
    writer.Text("cameras").List(static_cast<uint32_t>(policy.cameras.size()));
    for (const std::string& camera : policy.cameras) writer.Text(camera);
    writer.Text("state_dim").Integer(policy.state_dim);
    writer.Text("action_dim").Integer(policy.action_dim);
    writer.Text("action_horizon").Integer(policy.horizon);
    writer.Text("execute_steps").Integer(policy.execute_steps);
    writer.Text("inpaints").Boolean(policy.inpaints);
    writer.Text("image_width").Integer(policy.image_width);
    writer.Text("image_height").Integer(policy.image_height);
    // Whether views of other sizes are taken from a client that does not ask for it.
    writer.Text("resizes_images").Boolean(policy.resizes_images || options_.input.resize);
    writer.Text("max_view_side").Integer(LargestViewSide(policy, options_.input, true));
  }
  return writer.Take();
}

absl::StatusOr<SessionHost::Opened> OpenpiConversation::Open(const OpenpiValue* session) {
  SessionSpec spec = options_.session;
  const std::vector<PolicySpec> policies = host_->policies();
  if (spec.policy.empty() && !policies.empty()) spec.policy = policies.front().name;
  if (session != nullptr) {
    RS_ASSIGN_OR_RETURN(spec, ReadOpenpiSession(*session, spec));
  }
  absl::StatusOr<SessionHost::Opened> opened = host_->Open(caller_, spec);
  if (!opened.ok()) return session == nullptr ? opened.status() : Named("session", opened.status());
  keep_ = session != nullptr && !opened->resume_token.empty();
  spdlog::info("{}: opened over WebSocket by {}, method {}", opened->id, caller_.name,
               spec.method->method);
  return opened;
}

absl::Status OpenpiConversation::Begin(const OpenpiValue* session) {
  resize_ = false;
  if (session != nullptr) {
    RS_ASSIGN_OR_RETURN(resize_, ReadOpenpiResize(*session, false));
  }
  absl::StatusOr<SessionHost::Opened> opened;
  if (session != nullptr && session->Find("resume") != nullptr) {
    RS_ASSIGN_OR_RETURN(const OpenpiResume resume, ReadOpenpiResume(*session));
    opened = host_->Resume(caller_, resume.id, resume.token);
    if (opened.ok()) opened->resume_token = resume.token;
    keep_ = true;
  } else {
    opened = Open(session);
  }
  RS_RETURN_IF_ERROR(opened.status());
  session_id_ = opened->id;
  host_->Attach(session_id_);
  resume_token_ = opened->resume_token;
  durable_ = opened->durable;
  policy_ = opened->policy;
  control_period_s_ = opened->control_period_s;
  feedback_sequence_ = opened->at.feedback_sequence;
  episode_ = opened->at.episode;
  chunk_ = opened->at.next_chunk;
  return absl::OkStatus();
}

absl::Status OpenpiConversation::EnterEpisode(SessionUse& session, const OpenpiValue& message) {
  EpisodeKey key = episode_.value_or(EpisodeKey{0, 0});
  // An imported adapter knows its task and is in none of its episodes.
  bool enter = !episode_ || episode_->episode < 0;
  key.episode = std::max(key.episode, 0);
  bool again = false;
  if (const OpenpiValue* reset = message.Find("reset")) {
    const bool* flag = std::get_if<bool>(&reset->value);
    if (flag == nullptr) return absl::InvalidArgumentError("reset: must be true or false");
    again = *flag;
  }
  if (const OpenpiValue* episode = message.Find("episode")) {
    const OpenpiValue *task = episode->Find("task"), *index = episode->Find("episode");
    if (task == nullptr || index == nullptr)
      return absl::InvalidArgumentError("episode: must be a map with task and episode");
    RS_ASSIGN_OR_RETURN(const int64_t t,
                        OpenpiInteger("episode/task", *task, 0, WireLimits::kIndex));
    RS_ASSIGN_OR_RETURN(const int64_t e,
                        OpenpiInteger("episode/episode", *index, 0, WireLimits::kIndex));
    key = {static_cast<int>(t), static_cast<int>(e)};
    enter = enter || again || key != *episode_;
  } else if (again && !enter) {
    ++key.episode;
    enter = true;
  }
  if (!enter) return absl::OkStatus();
  RS_RETURN_IF_ERROR(session.StartEpisode(key, feedback_sequence_));
  episode_ = key;
  chunk_ = 0;
  return absl::OkStatus();
}

absl::StatusOr<FeedbackResult> OpenpiConversation::Report(SessionUse& session,
                                                          const OpenpiValue& value) {
  RS_RETURN_IF_ERROR(Allow(caller_, AccessRule::Wire::kWebSocket, "executed"));
  RS_ASSIGN_OR_RETURN(const OpenpiExecuted executed,
                      ReadOpenpiExecuted(value, policy_, control_period_s_));
  if (executed.sequence != 0) {
    if (std::optional<FeedbackResult> repeated = session.Repeated(executed.sequence)) {
      feedback_sequence_ = repeated->sequence;
      return *std::move(repeated);
    }
  }
  const absl::StatusOr<SessionUse::Recalled> reply = session.Recall(executed.prediction_id);
  if (!reply.ok()) return Named("executed/prediction_id", reply.status());
  const uint64_t sequence = executed.sequence == 0 ? feedback_sequence_ + 1 : executed.sequence;
  const PredictedChunk& prediction = reply->prediction;
  const auto steps = static_cast<int>(executed.states.size()) - 1;
  if (executed.first_step + steps > prediction.actions.rows()) {
    return absl::InvalidArgumentError(
        absl::StrCat("executed: steps ", executed.first_step, "..", executed.first_step + steps - 1,
                     " exceed the chunk's ", prediction.actions.rows(), " rows"));
  }
  ExecutedChunk chunk;
  chunk.sequence = sequence;
  chunk.task = reply->key.episode.task;
  chunk.episode = reply->key.episode.episode;
  chunk.chunk = reply->key.chunk;
  chunk.prediction_id = prediction.prediction_id;
  chunk.first_step = executed.first_step;
  chunk.last_of_episode = executed.last_of_episode;
  for (int i = 0; i < steps; ++i) {
    const int row = executed.first_step + i;
    ExecutedStep step;
    step.before = executed.states[static_cast<size_t>(i)];
    step.policy_command = prediction.policy_actions.row(row);
    if (prediction.base_actions.rows() > 0) step.base_command = prediction.base_actions.row(row);
    step.sent_command = executed.sent_commands.rows() > 0
                            ? Eigen::VectorXf(executed.sent_commands.row(i))
                            : Eigen::VectorXf(prediction.actions.row(row));
    chunk.steps.push_back(std::move(step));
  }
  chunk.final_state = executed.states.back();
  absl::StatusOr<FeedbackResult> acknowledged = session.Feedback(chunk);
  if (!acknowledged.ok()) return Named("executed", acknowledged.status());
  feedback_sequence_ = acknowledged->sequence;
  return acknowledged;
}

absl::StatusOr<std::string> OpenpiConversation::Answer(std::string_view message) {
  const Clock::time_point begin = Clock::now();
  messages_->Increment();
  bytes_in_->Increment(static_cast<double>(message.size()));
  RS_ASSIGN_OR_RETURN(const OpenpiValue request, DecodeOpenpi(message));
  if (session_id_.empty()) {
    RS_RETURN_IF_ERROR(Begin(request.Find("session")));
  } else if (request.Find("session") != nullptr) {
    return absl::FailedPreconditionError(
        "session: only a connection's first message may name it; open another connection");
  }
  RS_ASSIGN_OR_RETURN(const auto session, host_->Use(caller_, session_id_));
  std::optional<FeedbackResult> acknowledged;
  const OpenpiValue* executed = request.Find("executed");
  if (executed != nullptr) {
    RS_ASSIGN_OR_RETURN(acknowledged, Report(*session, *executed));
  }
  const bool predicts = executed == nullptr || request.Find("prompt") != nullptr;

  OpenpiWriter writer;
  writer.Map((predicts ? 2u : 0u) + (acknowledged ? 1u : 0u) + 2u);
  Clock::time_point inferred = begin;
  double infer_ms = 0;
  int64_t version = acknowledged ? static_cast<int64_t>(acknowledged->updates_applied) : 0;
  int64_t prediction_id = 0;
  if (predicts) {
    RS_ASSIGN_OR_RETURN(Observation observation,
                        ReadOpenpiObservation(request, policy_, options_.input, resize_));
    RS_RETURN_IF_ERROR(EnterEpisode(*session, request));
    PredictOptions how;
    if (const OpenpiValue* running = request.Find("running")) {
      RS_ASSIGN_OR_RETURN(how.running, ReadOpenpiRunning(*running, policy_));
    }
    const Clock::time_point start = Clock::now();
    RS_ASSIGN_OR_RETURN(
        const PredictedChunk prediction,
        session->Predict(std::make_shared<const Observation>(std::move(observation)),
                         {*episode_, chunk_}, feedback_sequence_, std::move(how), start));
    inferred = Clock::now();
    infer_ms = Milliseconds(inferred - start);
    infer_seconds_->Observe(infer_ms / 1e3);
    version = static_cast<int64_t>(prediction.adapter_version);
    prediction_id = static_cast<int64_t>(prediction.prediction_id);
    writer.Text("actions").Array(prediction.actions);
    writer.Text("policy_timing").Map(1).Text("infer_ms").Real(infer_ms);
    ++chunk_;
  }
  if (acknowledged) {
    writer.Text("feedback").Map(4);
    writer.Text("sequence").Integer(static_cast<int64_t>(acknowledged->sequence));
    writer.Text("updates_applied").Integer(static_cast<int64_t>(acknowledged->updates_applied));
    writer.Text("durable").Boolean(acknowledged->durable);
    writer.Text("duplicate").Boolean(acknowledged->duplicate);
  }
  const bool tells_token = keep_ && !announced_;
  announced_ = true;
  writer.Text("adapter").Map(tells_token ? 5 : 3);
  writer.Text("session").Text(session_id_);
  writer.Text("version").Integer(version);
  writer.Text("prediction_id").Integer(prediction_id);
  if (tells_token) {
    writer.Text("resume_token").Text(resume_token_);
    writer.Text("durable").Boolean(durable_);
  }
  writer.Text("server_timing").Map(previous_total_ms_ < 0 ? 1 : 2);
  writer.Text("infer_ms").Real(predicts ? Milliseconds(inferred - begin) : 0);
  if (previous_total_ms_ >= 0) writer.Text("prev_total_ms").Real(previous_total_ms_);
  previous_total_ms_ = Milliseconds(Clock::now() - begin);
  bytes_out_->Increment(static_cast<double>(writer.bytes().size()));
  return writer.Take();
}

}  // namespace robostress
