#include "common/monotonic_wait.h"

#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <map>
#include <thread>

#include "common/std_mutex.h"

namespace robostress {
namespace {

using Monotonic = std::chrono::steady_clock;

struct Alarm {
  absl::Mutex* mu;
  std::atomic<bool> rung{false};
};

// Rings alarms on a thread of its own, whose waits (std's) follow the monotonic clock. An alarm is
// rung with its mutex held, so that the one who waits on it asks its condition again. Locks are
// taken in the order alarms, mutex; a waiter who sets or stops its alarm holds the mutex already,
// so this thread only tries it.
class Alarms {
 public:
  static Alarms& Instance() {
    static auto& alarms = *new Alarms;  // outlives every waiter
    return alarms;
  }

  std::multimap<Monotonic::time_point, Alarm*>::iterator Set(Monotonic::time_point due,
                                                             Alarm* alarm) {
    const StdLock lock(mu_);
    const auto at = due_.emplace(due, alarm);
    if (at == due_.begin()) changed_.notify_one();
    return at;
  }
  void Stop(std::multimap<Monotonic::time_point, Alarm*>::iterator at, const Alarm& alarm) {
    const StdLock lock(mu_);
    if (!alarm.rung) due_.erase(at);
  }

 private:
  Alarms() {
    std::thread([this] { Run(); }).detach();
  }

  void Run() {
    pthread_setname_np(pthread_self(), "alarms");
    StdLock lock(mu_);
    while (true) {
      const Monotonic::time_point now = Monotonic::now();
      Monotonic::time_point next = Monotonic::time_point::max();
      for (auto at = due_.begin(); at != due_.end();) {
        if (at->first > now) {
          next = std::min(next, at->first);
          break;
        }
        if (Ring(*at->second)) {
          at = due_.erase(at);
        } else {
          next = now + std::chrono::milliseconds(1);
          ++at;
        }
      }
      if (next == Monotonic::time_point::max()) {
        changed_.wait(lock.waiting());
      } else {
        changed_.wait_until(lock.waiting(), next);
      }
    }
  }
  static bool Ring(Alarm& alarm) {
    if (!alarm.mu->TryLock()) return false;
    alarm.rung = true;
    alarm.mu->Unlock();
    return true;
  }

  StdMutex mu_;
  std::condition_variable changed_;
  std::multimap<Monotonic::time_point, Alarm*> due_ ABSL_GUARDED_BY(mu_);
};

}  // namespace

bool AwaitFor(absl::Mutex& mu, absl::FunctionRef<bool()> condition, absl::Duration timeout) {
  if (condition()) return true;
  if (timeout <= absl::ZeroDuration()) return false;
  Alarm alarm{&mu};
  const auto over = [&] {
    mu.AssertHeld();
    return alarm.rung || condition();
  };
  if (timeout == absl::InfiniteDuration()) {
    mu.Await(absl::Condition(&over));
    return true;
  }
  const absl::Duration bounded = std::min(timeout, absl::Hours(24 * 3650));  // no overflow
  const auto at =
      Alarms::Instance().Set(Monotonic::now() + absl::ToChronoNanoseconds(bounded), &alarm);
  mu.Await(absl::Condition(&over));
  Alarms::Instance().Stop(at, alarm);
  return condition();
}

}  // namespace robostress
