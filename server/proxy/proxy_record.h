#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "server/proxy/arm_profile.h"
#include "server/proxy/proxied_arm.h"
#include "server/proxy/row_file.h"

namespace robostress {

// What a proxy writes to a folder:
//
//   residuals.csv         a row for every answer: t_s (since the proxy's start), client, episode,
//                         chunk, outcome, doubt, and residual_AXIS, correction_AXIS in the action's
//                         own units; empty where there is none
//   joints-CLIENT-N.csv   of a robot in joint space whose every step is seen (execute_steps 1, or a
//                         client that sends `executed`): t [s], q_JOINT, q_cmd_JOINT [rad], a row
//                         each control step. One file is one stretch without a gap: a log of
//                         `robostress calibrate`, input position_target
//
// Where the disk takes no more, or a file cannot be opened, the record ends with whole rows, and
// clients are served on.
//
// A thread of its own waits for the disk. Any thread.
class ProxyRecord {
 public:
  static constexpr size_t kQueue = 4096;   // what waits; more is dropped and counted
  static constexpr size_t kFiles = 10000;  // of joints, in one run of the proxy

  // Makes the folder. ALREADY_EXISTS where it holds a record.
  static absl::StatusOr<std::unique_ptr<ProxyRecord>> Create(const std::string& folder,
                                                             const ArmProfile& profile);
  ~ProxyRecord();  // what waits is written

  void Answer(uint64_t client, const AnswerReport& report) ABSL_LOCKS_EXCLUDED(mu_);
  void Joints(uint64_t client, std::vector<JointRow> rows) ABSL_LOCKS_EXCLUDED(mu_);
  // The client is gone.
  void Ended(uint64_t client) ABSL_LOCKS_EXCLUDED(mu_);
  uint64_t dropped() const { return dropped_; }
  // Empty: all was written so far.
  std::string failure() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Answered {
    double t_s;
    AnswerReport report;
  };
  struct Entry {
    uint64_t client = 0;
    std::variant<std::monostate, Answered, std::vector<JointRow>> what;  // nothing: the end
  };
  // One client's open file of joints.
  struct Stretch {
    int number = -1;
    uint64_t rows = 0;
    std::unique_ptr<RowFile> file;  // null: it could not be opened
  };

  ProxyRecord(std::string folder, const ArmProfile& profile);
  void Push(Entry entry) ABSL_LOCKS_EXCLUDED(mu_);
  void Work() ABSL_LOCKS_EXCLUDED(mu_);
  void Write(const Entry& entry) ABSL_LOCKS_EXCLUDED(mu_);
  void WriteJoints(uint64_t client, const std::vector<JointRow>& rows) ABSL_LOCKS_EXCLUDED(mu_);
  // The next stretch of a client, with its header.
  std::unique_ptr<RowFile> OpenStretch(uint64_t client, int number) ABSL_LOCKS_EXCLUDED(mu_);
  void Flush(RowFile* file) ABSL_LOCKS_EXCLUDED(mu_);
  void Fail(const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);

  const std::string folder_;
  const std::vector<std::string> axes_;
  const double rate_hz_;
  const double start_s_;
  // Of the thread.
  std::unique_ptr<RowFile> residuals_;
  std::map<uint64_t, Stretch> stretches_;
  size_t files_ = 0;

  std::atomic<uint64_t> dropped_{0};
  mutable absl::Mutex mu_;
  std::deque<Entry> queue_ ABSL_GUARDED_BY(mu_);
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  std::string failure_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace robostress
