#include "server/operations/reloader.h"

#include <pthread.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/monotonic_wait.h"
#include "common/status_macros.h"

namespace robostress {

Reloader::Watched Reloader::Watch(const char* what, Metrics* metrics) {
  return {what,
          metrics->AddCounter("robostress_reloads_total",
                              "Changed certificates or tokens that were taken into use.",
                              {{"what", what}}),
          metrics->AddCounter("robostress_reload_failures_total",
                              "Attempts to read certificates or tokens that could not be used.",
                              {{"what", what}}),
          absl::OkStatus()};
}

Reloader::Reloader(const ReloaderOptions& options, std::shared_ptr<TlsStore> tls,
                   std::shared_ptr<TokenStore> tokens, Metrics* metrics)
    : options_(options),
      tls_(std::move(tls)),
      tokens_(std::move(tokens)),
      not_after_(tls_ == nullptr
                     ? nullptr
                     : metrics->AddGauge("robostress_certificate_expiry_timestamp_seconds",
                                         "Unix time at which the server's own "
                                         "certificate expires.")),
      tls_watched_(Watch("tls", metrics)),
      tokens_watched_(Watch("tokens", metrics)) {
  if (tls_ != nullptr)
    not_after_->Set(absl::ToDoubleSeconds(tls_->Get()->not_after - absl::UnixEpoch()));
}

absl::StatusOr<std::unique_ptr<Reloader>> Reloader::Start(const ReloaderOptions& options,
                                                          std::shared_ptr<TlsStore> tls,
                                                          std::shared_ptr<TokenStore> tokens,
                                                          Metrics* metrics) {
  const absl::Duration period = options.period;
  if (period != absl::ZeroDuration() && (period < absl::Seconds(1) || period > absl::Hours(24))) {
    return absl::InvalidArgumentError(absl::StrCat("--reload-seconds is ",
                                                   absl::ToDoubleSeconds(period),
                                                   ", must be 1..86400, or 0: at SIGHUP alone"));
  }
  auto reloader =
      std::unique_ptr<Reloader>(new Reloader(options, std::move(tls), std::move(tokens), metrics));
  reloader->thread_ = std::thread([raw = reloader.get()] { raw->Run(); });
  return reloader;
}

Reloader::~Reloader() {
  {
    absl::MutexLock lock(&mu_);
    stopped_ = true;
  }
  if (thread_.joinable()) thread_.join();
}

void Reloader::ReloadNow() {
  absl::MutexLock lock(&mu_);
  asked_ = true;
}

void Reloader::Run() {
  pthread_setname_np(pthread_self(), "reloader");
  const absl::Duration period =
      options_.period == absl::ZeroDuration() ? absl::InfiniteDuration() : options_.period;
  while (true) {
    bool asked = false;
    {
      absl::MutexLock lock(&mu_);
      const auto due = [this] {
        mu_.AssertHeld();
        return asked_ || stopped_;
      };
      AwaitFor(mu_, due, period);
      if (stopped_) return;
      asked = std::exchange(asked_, false);
    }
    if (tls_ != nullptr) Tell(ReloadTls(), asked, tls_watched_);
    if (!options_.tokens_file.empty()) Tell(ReloadTokens(), asked, tokens_watched_);
  }
}

absl::StatusOr<bool> Reloader::ReloadTls() {
  RS_ASSIGN_OR_RETURN(TlsSnapshot now, ReadTlsFiles(options_.tls_files));
  if (now.contents == tls_->Get()->contents) return false;
  const absl::Time not_after = now.not_after;
  tls_->Set(std::move(now));
  not_after_->Set(absl::ToDoubleSeconds(not_after - absl::UnixEpoch()));
  spdlog::info("reloaded {}: valid until {}", options_.tls_files.certificate,
               absl::FormatTime(not_after, absl::UTCTimeZone()));
  return true;
}

absl::StatusOr<bool> Reloader::ReloadTokens() {
  RS_ASSIGN_OR_RETURN(AccessTokens now, AccessTokens::Load(options_.tokens_file));
  if (now == *tokens_->Get()) return false;
  const std::string names = absl::StrJoin(now.names(), ", ");
  tokens_->Set(std::move(now));
  spdlog::info("reloaded {}: {}", options_.tokens_file, names);
  return true;
}

void Reloader::Tell(const absl::StatusOr<bool>& changed, bool asked, Watched& watched) {
  if (changed.ok()) {
    if (*changed) watched.reloads->Increment();
    if (asked && !*changed) spdlog::info("{}: unchanged", watched.what);
  } else {
    watched.failures->Increment();
    if (asked || changed.status() != watched.last) {
      spdlog::error("{} not reloaded, the old stay in use: {}", watched.what,
                    std::string(changed.status().message()));
    }
  }
  watched.last = changed.status();
}

}  // namespace robostress
