#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"
#include "server/operations/metrics.h"
#include "server/proxy/arm_profile.h"
#include "server/proxy/proxied_arm.h"
#include "server/proxy/proxy_record.h"
#include "server/proxy/relay.h"

namespace robostress {

// One client, for a page.
struct ProxyClientView {
  std::string peer;
  bool open = true;
  double age_s = 0, idle_s = 0;
  std::array<uint64_t, kAnswerOutcomes> outcomes{};
  std::array<uint64_t, kDoubts> doubts{};
  std::string last_doubt;  // with its words
  // The newest answers, oldest first; either may be empty.
  std::vector<Eigen::VectorXd> residuals, corrections;
};

// What one proxy does and did: the switch, figures for Prometheus, views for the page, the record.
// Any thread.
class ProxyBoard {
 public:
  static constexpr size_t kHistory = 240;    // answers of every client; then the oldest go
  static constexpr size_t kGoneClients = 8;  // that are still shown

  // `record` may be null. Both outlive it.
  ProxyBoard(const ArmProfile& profile, const MethodOptions& method, bool shadow, Metrics* metrics,
             ProxyRecord* record);

  ProxyMode mode() const { return mode_; }
  // Off, or back to what it was started as.
  void Switch(bool on);

  // What looks at a client of the relay.
  std::unique_ptr<RelayTap> Tap(const std::string& peer) ABSL_LOCKS_EXCLUDED(mu_);

  std::vector<ProxyClientView> Views() const ABSL_LOCKS_EXCLUDED(mu_);
  const ArmProfile& profile() const { return profile_; }
  const MethodOptions& method() const { return method_; }
  const Histogram& held() const { return *held_; }
  // Why the record ended; empty: it did not.
  std::string record_failure() const { return record_ == nullptr ? "" : record_->failure(); }

 private:
  class Client;
  using Clock = std::chrono::steady_clock;
  struct Record {
    ProxyClientView view;
    std::deque<Eigen::VectorXd> residuals, corrections;
    Clock::time_point begin, used;
  };

  void Report(uint64_t client, const AnswerReport& report, double held_s, double answer_s)
      ABSL_LOCKS_EXCLUDED(mu_);
  void Ended(uint64_t client) ABSL_LOCKS_EXCLUDED(mu_);

  const ArmProfile profile_;
  const MethodOptions method_;
  const ProxyMode started_as_;
  ProxyRecord* const record_;
  std::atomic<ProxyMode> mode_;
  const std::shared_ptr<Gauge> on_;
  const std::shared_ptr<Histogram> held_, answers_s_;
  std::array<std::shared_ptr<Counter>, kAnswerOutcomes> outcomes_;
  std::array<std::shared_ptr<Counter>, kDoubts> doubts_;

  mutable absl::Mutex mu_;
  uint64_t next_ ABSL_GUARDED_BY(mu_) = 0;
  bool said_many_ ABSL_GUARDED_BY(mu_) = false;
  std::map<uint64_t, Record> clients_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
