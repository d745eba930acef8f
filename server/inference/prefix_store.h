#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <memory>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"
#include "server/policies/policy.h"

namespace robostress {

// The prefix keys and values that sessions keep for learning, all sessions of a server under one
// budget of bytes. Where they would exceed it, the least recently used are dropped; one that is
// asked for again is rebuilt from its observation by FlowPolicy::Encode, to the same bits, so the
// budget changes the time of an update and nothing else. Full-size pi0: 14.3 MiB a prefix in bf16,
// 459 MiB for a buffer of 32; its observation 0.4 MiB. Thread-safe; must outlive its handles.
class PrefixStore {
 public:
  static constexpr int64_t kDefaultBudgetBytes = int64_t{512} << 20;

  struct Counters {
    int64_t bytes = 0;              // keys and values held now
    int64_t observation_bytes = 0;  // of everything that may be asked for
    int64_t pinned_bytes = 0;       // of `bytes`: without an observation, never dropped
    uint64_t evictions = 0;
    uint64_t rebuilds = 0;
  };

  // One stored prefix; destruction forgets it.
  class Prefix {
   public:
    Prefix(PrefixStore* store, uint64_t id) : store_(store), id_(id) {}
    ~Prefix() { store_->Remove(id_); }
    Prefix(const Prefix&) = delete;
    Prefix& operator=(const Prefix&) = delete;

   private:
    friend class PrefixStore;
    PrefixStore* const store_;
    const uint64_t id_;
  };

  explicit PrefixStore(int64_t budget_bytes = kDefaultBudgetBytes) : budget_bytes_(budget_bytes) {}

  // `observation` is what `policy` encoded to `context`; null (an imported buffer): it is pinned.
  std::shared_ptr<const Prefix> Add(std::shared_ptr<const FlowPolicy> policy,
                                    std::shared_ptr<const Observation> observation,
                                    PolicyContext context) ABSL_LOCKS_EXCLUDED(mu_);
  // The same without its context, which the first Get makes: of a session that is read from disk.
  std::shared_ptr<const Prefix> AddDropped(std::shared_ptr<const FlowPolicy> policy,
                                           std::shared_ptr<const Observation> observation)
      ABSL_LOCKS_EXCLUDED(mu_);
  // The context, rebuilt on this thread if it was dropped.
  absl::StatusOr<PolicyContext> Get(const Prefix& prefix) ABSL_LOCKS_EXCLUDED(mu_);

  int64_t budget_bytes() const { return budget_bytes_; }
  Counters counters() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    std::shared_ptr<const FlowPolicy> policy;
    std::shared_ptr<const Observation> observation;
    PolicyContext context;  // empty while not held
    int64_t bytes = 0;      // of context
    bool held = false;
    std::list<uint64_t>::iterator place;  // in recent_, while held and not pinned
  };

  void Remove(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  void Hold(uint64_t id, Entry& entry, PolicyContext context) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Drop(Entry& entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void EvictToBudget() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const int64_t budget_bytes_;
  mutable absl::Mutex mu_;
  std::map<uint64_t, Entry> entries_ ABSL_GUARDED_BY(mu_);
  std::list<uint64_t> recent_ ABSL_GUARDED_BY(mu_);  // held ones that may be dropped, oldest first
  Counters counters_ ABSL_GUARDED_BY(mu_);
  uint64_t last_id_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace robostress
