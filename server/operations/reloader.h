#pragma once

#include <memory>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "server/operations/access_tokens.h"
#include "server/operations/metrics.h"
#include "server/operations/tls_files.h"

namespace robostress {

struct ReloaderOptions {
  TlsFiles tls_files;                         // empty: no TLS
  std::string tokens_file;                    // empty: nobody is asked
  absl::Duration period = absl::Seconds(10);  // 1 s .. 1 day; zero: only ReloadNow
};

// Reads the files of certificates and tokens again and again, and publishes what has changed to all
// ports at once. Contents are compared, not times, so that a file may be written, moved or reached
// through another symlink. What cannot be used is refused as a whole: the old stays, the log says
// file and reason once, and every attempt is counted (robostress_reload_failures_total{what}).
class Reloader {
 public:
  // `tls` null: no TLS. The stores hold what the files held a moment ago. `metrics` outlives it.
  // INVALID_ARGUMENT: the period.
  static absl::StatusOr<std::unique_ptr<Reloader>> Start(const ReloaderOptions& options,
                                                         std::shared_ptr<TlsStore> tls,
                                                         std::shared_ptr<TokenStore> tokens,
                                                         Metrics* metrics);
  ~Reloader();

  // Any thread; returns at once. What cannot be used is logged again.
  void ReloadNow() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // One kind of file.
  struct Watched {
    const char* what;
    std::shared_ptr<Counter> reloads, failures;
    absl::Status last;  // of the last attempt
  };

  Reloader(const ReloaderOptions& options, std::shared_ptr<TlsStore> tls,
           std::shared_ptr<TokenStore> tokens, Metrics* metrics);
  static Watched Watch(const char* what, Metrics* metrics);
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // True: something new was published.
  absl::StatusOr<bool> ReloadTls();
  absl::StatusOr<bool> ReloadTokens();
  // Counts and logs.
  static void Tell(const absl::StatusOr<bool>& changed, bool asked, Watched& watched);

  const ReloaderOptions options_;
  const std::shared_ptr<TlsStore> tls_;
  const std::shared_ptr<TokenStore> tokens_;
  const std::shared_ptr<Gauge> not_after_;
  // Of the thread.
  Watched tls_watched_, tokens_watched_;

  absl::Mutex mu_;
  bool asked_ ABSL_GUARDED_BY(mu_) = false, stopped_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace robostress
