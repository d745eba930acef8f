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

// The mangled names: ROBOSTRESS_ABSL is 4absl and the inline namespace of the installed version.
#define JOIN_EXPANDED(a, b, c) a##b##c
#define JOIN(a, b, c) JOIN_EXPANDED(a, b, c)
#define REAL(name) JOIN(__real__ZN, ROBOSTRESS_ABSL, name)
#define WRAP(name) JOIN(__wrap__ZN, ROBOSTRESS_ABSL, name)
#define REAL_CONST(name) JOIN(__real__ZNK, ROBOSTRESS_ABSL, name)
#define WRAP_CONST(name) JOIN(__wrap__ZNK, ROBOSTRESS_ABSL, name)

// Acquires after the call.
#define ACQUIRE_AFTER(real, wrap) \
  void real(void* self);          \
  void wrap(void* self) {         \
    real(self);                   \
    __tsan_acquire(self);         \
  }
// Releases before the call.
#define RELEASE_BEFORE(real, wrap) \
  void real(void* self);           \
  void wrap(void* self) {          \
    __tsan_release(self);          \
    real(self);                    \
  }

ACQUIRE_AFTER(REAL(5Mutex4LockEv), WRAP(5Mutex4LockEv))
RELEASE_BEFORE(REAL(5Mutex6UnlockEv), WRAP(5Mutex6UnlockEv))
// A condition runs inside absl with the lock held, and begins with AssertHeld.
ACQUIRE_AFTER(REAL_CONST(5Mutex10AssertHeldEv), WRAP_CONST(5Mutex10AssertHeldEv))
RELEASE_BEFORE(REAL(12Notification6NotifyEv), WRAP(12Notification6NotifyEv))
ACQUIRE_AFTER(REAL_CONST(12Notification19WaitForNotificationEv),
              WRAP_CONST(12Notification19WaitForNotificationEv))
ACQUIRE_AFTER(REAL(15BlockingCounter4WaitEv), WRAP(15BlockingCounter4WaitEv))

bool REAL(15BlockingCounter14DecrementCountEv)(void* self);
bool WRAP(15BlockingCounter14DecrementCountEv)(void* self) {
  __tsan_release(self);
  return REAL(15BlockingCounter14DecrementCountEv)(self);
}

// Await: two functions of their own in 2022's absl, inline calls of AwaitCommon in 2024's. The weak
// one that a version lacks is never called.
#define AWAIT(name, argument)                                                         \
  __attribute__((weak)) bool REAL(name)(void* self, const void* condition, argument); \
  bool WRAP(name)(void* self, const void* condition, argument value) {                \
    __tsan_release(self);                                                             \
    const bool result = REAL(name)(self, condition, value);                           \
    __tsan_acquire(self);                                                             \
    return result;                                                                    \
  }
AWAIT(5Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE, DurationRegisters)
// KernelTimeout is one register.
AWAIT(5Mutex11AwaitCommonERKNS0_9ConditionENS0_24synchronization_internal13KernelTimeoutE, uint64_t)

__attribute__((weak)) void REAL(5Mutex5AwaitERKNS0_9ConditionE)(void* self, const void* condition);
void WRAP(5Mutex5AwaitERKNS0_9ConditionE)(void* self, const void* condition) {
  __tsan_release(self);
  REAL(5Mutex5AwaitERKNS0_9ConditionE)(self, condition);
  __tsan_acquire(self);
}

bool REAL_CONST(12Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(
    void* self, DurationRegisters timeout);
bool WRAP_CONST(12Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(
    void* self, DurationRegisters timeout) {
  const bool result =
      REAL_CONST(12Notification30WaitForNotificationWithTimeoutENS0_8DurationE)(self, timeout);
  if (result) __tsan_acquire(self);
  return result;
}

}  // extern "C"
