// Tells the thread sanitizer what absl's locks do. Debian's absl is not instrumented, so without
// this every access under an absl::Mutex looks like a race. Linked into every program of the tsan
// preset, with -Wl,--wrap for each function below (cmake/RobostressCompiler.cmake).

#include <cstdint>

extern "C" {

void __tsan_acquire(void* address);
void __tsan_release(void* address);

// absl::Duration is passed as its two registers.
struct DurationRegisters {
  int64_t high;
  uint32_t low;
};

#define REAL(symbol) __real_##symbol
#define WRAP(symbol) __wrap_##symbol

// Acquires after the call.
#define WRAP_ACQUIRE(symbol)      \
  void REAL(symbol)(void* self);  \
  void WRAP(symbol)(void* self) { \
    REAL(symbol)(self);           \
    __tsan_acquire(self);         \
  }
// Releases before the call.
#define WRAP_RELEASE(symbol)      \
  void REAL(symbol)(void* self);  \
  void WRAP(symbol)(void* self) { \
    __tsan_release(self);         \
    REAL(symbol)(self);           \
  }

WRAP_ACQUIRE(_ZN4absl7debian35Mutex4LockEv)
WRAP_RELEASE(_ZN4absl7debian35Mutex6UnlockEv)
// A condition runs inside absl with the lock held, and begins with AssertHeld.
WRAP_ACQUIRE(_ZNK4absl7debian35Mutex10AssertHeldEv)
WRAP_RELEASE(_ZN4absl7debian312Notification6NotifyEv)
WRAP_ACQUIRE(_ZNK4absl7debian312Notification19WaitForNotificationEv)
WRAP_ACQUIRE(_ZN4absl7debian315BlockingCounter4WaitEv)

bool REAL(_ZN4absl7debian315BlockingCounter14DecrementCountEv)(void* self);
bool WRAP(_ZN4absl7debian315BlockingCounter14DecrementCountEv)(void* self) {
  __tsan_release(self);
  return REAL(_ZN4absl7debian315BlockingCounter14DecrementCountEv)(self);
}

void REAL(_ZN4absl7debian35Mutex5AwaitERKNS0_9ConditionE)(void* self, const void* condition);
void WRAP(_ZN4absl7debian35Mutex5AwaitERKNS0_9ConditionE)(void* self, const void* condition) {
  __tsan_release(self);
  REAL(_ZN4absl7debian35Mutex5AwaitERKNS0_9ConditionE)(self, condition);
  __tsan_acquire(self);
}

bool REAL(_ZN4absl7debian35Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE)(
    void* self, const void* condition, DurationRegisters timeout);
bool WRAP(_ZN4absl7debian35Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE)(
    void* self, const void* condition, DurationRegisters timeout) {
  __tsan_release(self);
  const bool result =
      REAL(_ZN4absl7debian35Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE)(
          self, condition, timeout);
  __tsan_acquire(self);
  return result;
}

bool REAL(_ZNK4absl7debian312Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(
    void* self, DurationRegisters timeout);
bool WRAP(_ZNK4absl7debian312Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(
    void* self, DurationRegisters timeout) {
  const bool result =
      REAL(_ZNK4absl7debian312Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(self,
                                                                                           timeout);
  if (result) __tsan_acquire(self);
  return result;
}

}  // extern "C"
