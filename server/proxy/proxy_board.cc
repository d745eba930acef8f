#include "server/proxy/proxy_board.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

using SteadyClock = std::chrono::steady_clock;

double Seconds(SteadyClock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

// What a message is held for: microseconds, mostly.
std::vector<double> HeldBounds() {
  return {5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.1, 1};
}

void Keep(std::deque<Eigen::VectorXd>& history, const Eigen::VectorXd& value) {
  history.push_back(value);
  if (history.size() > ProxyBoard::kHistory) history.pop_front();
}

}  // namespace

// A client as the relay hands it over.
class ProxyBoard::Client : public RelayTap {
 public:
  Client(ProxyBoard& board, uint64_t id, std::string peer)
      : board_(board),
        id_(id),
        peer_(std::move(peer)),
        arm_(board.profile_, board.method_),
        began_(SteadyClock::now()) {}
  ~Client() override { board_.Ended(id_); }

  void FromClient(std::string_view message, bool text) override {
    const auto begin = SteadyClock::now();
    asked_ = begin;
    arm_.Observed(message, text, Now(begin), board_.mode());
    held_s_ = Seconds(SteadyClock::now() - begin);
    if (board_.record_ != nullptr) board_.record_->Joints(id_, arm_.TakeRows());
  }
  std::optional<std::string> FromServer(std::string_view message, bool text) override {
    const auto begin = SteadyClock::now();
    std::optional<std::string> answer = arm_.Answered(message, text, Now(begin), board_.mode());
    held_s_ += Seconds(SteadyClock::now() - begin);
    Say();
    return answer;
  }
  void Threw(const std::string& words) override {
    arm_.Failed(words);
    Say();
  }

 private:
  double Now(SteadyClock::time_point now) const { return Seconds(now - began_); }
  void Say() {
    const AnswerReport& report = arm_.report();
    if (report.outcome == AnswerOutcome::kOther && !report.doubt) return;
    board_.Report(id_, report, std::exchange(held_s_, 0), Seconds(SteadyClock::now() - asked_));
    if (!report.doubt) return;
    bool& said = said_[static_cast<size_t>(*report.doubt)];
    if (std::exchange(said, true)) return;
    spdlog::warn(
        "proxy: {}: the answer passes untouched ({}): {}; further ones of this client are "
        "counted",
        peer_, DoubtName(*report.doubt), report.words);
  }

  ProxyBoard& board_;
  const uint64_t id_;
  const std::string peer_;
  ProxiedArm arm_;
  const SteadyClock::time_point began_;
  SteadyClock::time_point asked_;
  double held_s_ = 0;
  std::array<bool, kDoubts> said_{};
};

ProxyBoard::ProxyBoard(const ArmProfile& profile, const MethodOptions& method, bool shadow,
                       Metrics* metrics, ProxyRecord* record)
    : profile_(profile),
      method_(method),
      started_as_(shadow ? ProxyMode::kShadow : ProxyMode::kOn),
      record_(record),
      mode_(started_as_),
      on_(metrics->AddGauge("robostress_proxy_corrects", "1: corrects; 0: shadow or off.")),
      held_(metrics->AddHistogram("robostress_proxy_held_seconds",
                                  "What the proxy's own work adds to one answer.", HeldBounds())),
      answers_s_(metrics->AddHistogram("robostress_proxy_answer_seconds",
                                       "From a client's message to its answer.", LatencyBounds())) {
  for (size_t i = 0; i < kAnswerOutcomes; ++i) {
    outcomes_[i] =
        metrics->AddCounter("robostress_proxy_answers_total", "Answers by what became of them.",
                            {{"outcome", AnswerOutcomeName(static_cast<AnswerOutcome>(i))}});
  }
  for (size_t i = 0; i < kDoubts; ++i) {
    doubts_[i] =
        metrics->AddCounter("robostress_proxy_doubts_total", "Answers left untouched, by reason.",
                            {{"reason", DoubtName(static_cast<Doubt>(i))}});
  }
  on_->Set(started_as_ == ProxyMode::kOn ? 1 : 0);
}

void ProxyBoard::Switch(bool on) {
  const ProxyMode mode = on ? started_as_ : ProxyMode::kOff;
  if (mode_.exchange(mode) == mode) return;
  on_->Set(mode == ProxyMode::kOn ? 1 : 0);
  spdlog::warn("proxy: switched {}", on ? ProxyModeName(mode) : "off: every answer passes");
}

std::unique_ptr<RelayTap> ProxyBoard::Tap(const std::string& peer) {
  absl::MutexLock lock(&mu_);
  const uint64_t id = ++next_;
  const bool others = std::any_of(clients_.begin(), clients_.end(),
                                  [](const auto& client) { return client.second.view.open; });
  if (others && !std::exchange(said_many_, true)) {
    spdlog::warn(
        "proxy: {} is a second client at once: each is taken for a robot of its own; where there "
        "is one arm, --max-clients 1 lets one in",
        peer);
  }
  Record& record = clients_[id];
  record.view.peer = peer;
  record.begin = record.used = Clock::now();
  return std::make_unique<Client>(*this, id, peer);
}

void ProxyBoard::Report(uint64_t client, const AnswerReport& report, double held_s,
                        double answer_s) {
  outcomes_[static_cast<size_t>(report.outcome)]->Increment();
  if (report.doubt) doubts_[static_cast<size_t>(*report.doubt)]->Increment();
  held_->Observe(held_s);
  answers_s_->Observe(answer_s);
  if (record_ != nullptr && report.outcome != AnswerOutcome::kOff) record_->Answer(client, report);
  absl::MutexLock lock(&mu_);
  const auto found = clients_.find(client);
  if (found == clients_.end()) return;
  Record& record = found->second;
  record.used = Clock::now();
  ++record.view.outcomes[static_cast<size_t>(report.outcome)];
  if (report.doubt) {
    ++record.view.doubts[static_cast<size_t>(*report.doubt)];
    record.view.last_doubt = absl::StrCat(DoubtName(*report.doubt), ": ", report.words);
  }
  if (report.residual.size() > 0) Keep(record.residuals, report.residual);
  if (report.correction.size() > 0) Keep(record.corrections, report.correction);
}

void ProxyBoard::Ended(uint64_t client) {
  if (record_ != nullptr) record_->Ended(client);
  absl::MutexLock lock(&mu_);
  if (const auto found = clients_.find(client); found != clients_.end())
    found->second.view.open = false;
  size_t gone = 0;
  for (const auto& [id, record] : clients_) gone += !record.view.open;
  for (auto at = clients_.begin(); at != clients_.end() && gone > kGoneClients;) {
    const bool drop = !at->second.view.open;
    at = drop ? clients_.erase(at) : std::next(at);
    gone -= drop;
  }
}

std::vector<ProxyClientView> ProxyBoard::Views() const {
  absl::MutexLock lock(&mu_);
  std::vector<ProxyClientView> views;
  const Clock::time_point now = Clock::now();
  for (const auto& [id, record] : clients_) {
    ProxyClientView view = record.view;
    view.age_s = Seconds(now - record.begin);
    view.idle_s = Seconds(now - record.used);
    view.residuals.assign(record.residuals.begin(), record.residuals.end());
    view.corrections.assign(record.corrections.begin(), record.corrections.end());
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace robostress
