#include "server/inference/prefix_store.h"

#include <torch/types.h>

#include <utility>

#include "common/status_macros.h"

namespace robostress {
namespace {

int64_t ContextBytes(const PolicyContext& context) {
  int64_t bytes = static_cast<int64_t>(context.prefix_mask.nbytes() + context.state.nbytes());
  for (const auto* side : {&context.keys, &context.values}) {
    for (const torch::Tensor& tensor : *side) bytes += static_cast<int64_t>(tensor.nbytes());
  }
  return bytes;
}

int64_t ObservationBytes(const Observation& observation) {
  size_t bytes = observation.instruction.size() +
                 static_cast<size_t>(observation.proprioception.size()) * sizeof(float);
  for (const CameraView& view : observation.views) bytes += view.image.data.size();
  return static_cast<int64_t>(bytes);
}

}  // namespace

std::shared_ptr<const PrefixStore::Prefix> PrefixStore::Add(
    std::shared_ptr<const FlowPolicy> policy, std::shared_ptr<const Observation> observation,
    PolicyContext context) {
  absl::MutexLock lock(&mu_);
  const uint64_t id = ++last_id_;
  Entry& entry = entries_[id];
  entry.policy = std::move(policy);
  entry.observation = std::move(observation);
  if (entry.observation != nullptr)
    counters_.observation_bytes += ObservationBytes(*entry.observation);
  Hold(id, entry, std::move(context));
  EvictToBudget();
  return std::make_shared<const Prefix>(this, id);
}

std::shared_ptr<const PrefixStore::Prefix> PrefixStore::AddDropped(
    std::shared_ptr<const FlowPolicy> policy, std::shared_ptr<const Observation> observation) {
  absl::MutexLock lock(&mu_);
  const uint64_t id = ++last_id_;
  Entry& entry = entries_[id];
  entry.policy = std::move(policy);
  entry.observation = std::move(observation);
  counters_.observation_bytes += ObservationBytes(*entry.observation);
  return std::make_shared<const Prefix>(this, id);
}

absl::StatusOr<PolicyContext> PrefixStore::Get(const Prefix& prefix) {
  std::shared_ptr<const FlowPolicy> policy;
  std::shared_ptr<const Observation> observation;
  {
    absl::MutexLock lock(&mu_);
    const Entry& entry = entries_.at(prefix.id_);
    if (entry.held) {
      if (entry.observation != nullptr) recent_.splice(recent_.end(), recent_, entry.place);
      return entry.context;
    }
    policy = entry.policy;
    observation = entry.observation;
    ++counters_.rebuilds;
  }
  RS_ASSIGN_OR_RETURN(PolicyContext context, policy->Encode(*observation));
  absl::MutexLock lock(&mu_);
  Entry& entry = entries_.at(prefix.id_);
  if (!entry.held) Hold(prefix.id_, entry, context);  // another thread may have been quicker
  EvictToBudget();
  return context;
}

PrefixStore::Counters PrefixStore::counters() const {
  absl::MutexLock lock(&mu_);
  return counters_;
}

void PrefixStore::Remove(uint64_t id) {
  absl::MutexLock lock(&mu_);
  Entry& entry = entries_.at(id);
  if (entry.held) Drop(entry);
  if (entry.observation != nullptr)
    counters_.observation_bytes -= ObservationBytes(*entry.observation);
  entries_.erase(id);
}

void PrefixStore::Hold(uint64_t id, Entry& entry, PolicyContext context) {
  entry.bytes = ContextBytes(context);
  entry.context = std::move(context);
  entry.held = true;
  counters_.bytes += entry.bytes;
  if (entry.observation == nullptr) {
    counters_.pinned_bytes += entry.bytes;
  } else {
    entry.place = recent_.insert(recent_.end(), id);
  }
}

void PrefixStore::Drop(Entry& entry) {
  counters_.bytes -= entry.bytes;
  if (entry.observation == nullptr) {
    counters_.pinned_bytes -= entry.bytes;
  } else {
    recent_.erase(entry.place);
  }
  entry.context = {};
  entry.held = false;
}

void PrefixStore::EvictToBudget() {
  while (counters_.bytes > budget_bytes_ && !recent_.empty()) {
    Drop(entries_.at(recent_.front()));
    ++counters_.evictions;
  }
}

}  // namespace robostress
