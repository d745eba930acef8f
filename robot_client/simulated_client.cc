#include "robot_client/simulated_client.h"

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<SimulatedClient>> SimulatedClient::Create(
    const SimulatedClientOptions& options, RobotArm* arm, Clock* clock,
    std::vector<FrameSource*> cameras, PolicyLink::Connect connect,
    FeedbackAssembler::ForwardKinematics forward) {
  auto client = std::unique_ptr<SimulatedClient>(new SimulatedClient(options, clock, cameras));
  RS_ASSIGN_OR_RETURN(client->loop_,
                      ControlLoop::Create(options.control, arm, clock, &client->stamps_));
  client->link_ =
      std::make_unique<PolicyLink>(options.link, client->loop_.get(), clock, std::move(cameras),
                                   std::move(connect), std::move(forward));
  SimulatedClient* const self = client.get();
  self->link_->DeliverThrough([self](const ArmChunk& chunk) {
    if (self->options_.latency_ticks == 0) {
      self->loop_->AnswerPrediction(chunk);
    } else {
      self->on_the_way_.emplace_back(
          self->ticks_ + static_cast<uint64_t>(self->options_.latency_ticks), chunk);
    }
  });
  self->loop_->OnPredictionRequested([self] { self->link_->Serve(); });
  RS_RETURN_IF_ERROR(self->link_->Open());
  self->start_ns_ = clock->now_ns();
  return client;
}

void SimulatedClient::Tick() {
  ++ticks_;
  while (!on_the_way_.empty() && on_the_way_.front().first <= ticks_) {
    loop_->AnswerPrediction(on_the_way_.front().second);
    on_the_way_.pop_front();
  }
  // From the start, so that rounding of the period does not add up.
  const int64_t due =
      start_ns_ + static_cast<int64_t>(static_cast<double>(ticks_) * loop_->period_s() * 1e9);
  clock_->SleepUntil(due);
  loop_->Tick(due);
  link_->Serve();  // feedback
}

absl::Status SimulatedClient::Enable() {
  loop_->Ask(kRequestEnable);
  Tick();
  RS_RETURN_IF_ERROR(loop_->enable_status());
  // Enabling waits on the clock: go on from there.
  start_ns_ = clock_->now_ns();
  ticks_ = 0;
  on_the_way_.clear();
  return absl::OkStatus();
}

void SimulatedClient::Wait(double seconds) {
  const int64_t until = clock_->now_ns() + static_cast<int64_t>(seconds * 1e9);
  while (clock_->now_ns() < until) Tick();
}

absl::StatusOr<SimulatedEpisode> SimulatedClient::RunEpisode(
    const EpisodeKey& key, double seconds,
    const std::function<bool(const TickRecord&)>& after_tick) {
  link_->StartEpisode(key);
  loop_->Ask(kRequestStart);
  Tick();
  if (loop_->state() != ClientState::kRun) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the client is ", StateName(loop_->state()), " (", CauseName(loop_->last_record().cause),
        "), no episode starts: enable the arm, and look at arm and cameras"));
  }
  SimulatedEpisode episode;
  const int64_t until = clock_->now_ns() + static_cast<int64_t>(seconds * 1e9);
  while (true) {
    ++episode.ticks;
    if (after_tick && after_tick(loop_->last_record())) {
      episode.ended_by_caller = true;
      break;
    }
    if (clock_->now_ns() >= until) break;
    Tick();
    if (loop_->state() != ClientState::kRun) break;
  }
  episode.state = loop_->state();
  episode.cause = loop_->last_record().cause;
  loop_->Ask(kRequestEnd);
  Tick();
  episode.link = link_->counters();
  return episode;
}

}  // namespace robostress
