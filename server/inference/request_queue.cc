#include "server/inference/request_queue.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/rollout/refusal.h"

namespace robostress {
bool RequestQueue::Before(const QueuedRequest& a, const QueuedRequest& b, MonotonicTime now) const {
  const auto first_class = [&](const QueuedRequest& r) {
    return r.priority == Priority::kRobot ||
           absl::FromChrono(now - r.arrival) >= options_.starvation_limit;
  };
  const bool a_first = first_class(a), b_first = first_class(b);
  if (a_first != b_first) return a_first;
  return a.deadline < b.deadline;  // equal: the list is in the order of arrival
}

RequestQueue::Refused RequestQueue::Push(Request request, absl::Duration retry_after) {
  Refused refused;
  if (request->replaceable) {
    for (auto at = waiting_.begin(); at != waiting_.end();) {
      if ((*at)->session == request->session && (*at)->replaceable) {
        refused.emplace_back(*at,
                             Refusal(absl::AbortedError("a newer observation of the session came "
                                                        "before this one was computed")));
        at = waiting_.erase(at);
      } else {
        ++at;
      }
    }
  }
  if (size() < options_.capacity) {
    waiting_.push_back(std::move(request));
    return refused;
  }
  const auto full = [&](const char* who) {
    return OverloadedError(absl::StrCat(size(), " predictions wait, which is the limit, and ", who),
                           retry_after);
  };
  if (request->priority == Priority::kRobot) {
    const auto last = std::find_if(waiting_.rbegin(), waiting_.rend(), [](const Request& r) {
      return r->priority == Priority::kSimulation;
    });
    if (last != waiting_.rend()) {
      refused.emplace_back(*last, full("a real arm took this simulation's place"));
      waiting_.erase(std::next(last).base());
      waiting_.push_back(std::move(request));
      return refused;
    }
  }
  absl::Status status = full("none of them gives way");
  refused.emplace_back(std::move(request), std::move(status));
  return refused;
}

std::vector<RequestQueue::Request> RequestQueue::PopBatch(MonotonicTime now, int most,
                                                          absl::Duration compute_time,
                                                          Refused& expired) {
  const auto hopeless = [&](const Request& request) {
    return request->deadline - now < absl::ToChronoNanoseconds(compute_time);
  };
  // Only a prediction mends an estimate that is wrong: where it refuses everything, the request
  // with the most time left is computed all the same.
  const QueuedRequest* spared = nullptr;
  if (std::all_of(waiting_.begin(), waiting_.end(), hopeless)) {
    for (const Request& request : waiting_) {
      if (request->deadline > now && (spared == nullptr || request->deadline > spared->deadline))
        spared = request.get();
    }
  }
  for (auto at = waiting_.begin(); at != waiting_.end();) {
    const QueuedRequest& request = **at;
    if (hopeless(*at) && &request != spared) {
      const auto since_arrival = [&](MonotonicTime t) {
        return absl::FormatDuration(
            absl::Floor(absl::FromChrono(t - request.arrival), absl::Microseconds(1)));
      };
      expired.emplace_back(
          *at, Refusal(absl::DeadlineExceededError(absl::StrCat(
                   "the observation has waited ", since_arrival(now), " and a prediction takes ",
                   absl::FormatDuration(absl::Floor(compute_time, absl::Microseconds(1))),
                   ": its deadline of ", since_arrival(request.deadline), " cannot be kept"))));
      at = waiting_.erase(at);
    } else {
      ++at;
    }
  }
  std::vector<std::list<Request>::iterator> order;
  for (auto at = waiting_.begin(); at != waiting_.end(); ++at) order.push_back(at);
  std::stable_sort(order.begin(), order.end(),
                   [&](auto a, auto b) { return Before(**a, **b, now); });
  std::vector<Request> batch;
  for (const auto at : order) {
    if (static_cast<int>(batch.size()) >= most) break;
    if (!batch.empty() && ((*at)->group != batch[0]->group || (*at)->alone || batch[0]->alone)) {
      continue;
    }
    batch.push_back(std::move(*at));
    waiting_.erase(at);
  }
  return batch;
}

bool RequestQueue::Remove(const QueuedRequest* request) {
  const auto found = std::find_if(waiting_.begin(), waiting_.end(),
                                  [&](const Request& r) { return r.get() == request; });
  if (found == waiting_.end()) return false;
  waiting_.erase(found);
  return true;
}

std::vector<RequestQueue::Request> RequestQueue::RemoveSession(uint64_t session) {
  std::vector<Request> removed;
  for (auto at = waiting_.begin(); at != waiting_.end();) {
    if (session == 0 || (*at)->session == session) {
      removed.push_back(*at);
      at = waiting_.erase(at);
    } else {
      ++at;
    }
  }
  return removed;
}

MonotonicTime RequestQueue::oldest_arrival() const {
  return waiting_.empty() ? MonotonicTime::max() : waiting_.front()->arrival;
}

}  // namespace robostress
