set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/bin)

if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
# -O2 without -march=native: the same binary gives the same bits on every x86-64 machine of a cluster.
set(CMAKE_CXX_FLAGS_RELEASE "-O2 -DNDEBUG")

find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM)
  set(CMAKE_CXX_COMPILER_LAUNCHER
      ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros,include_file_mtime,include_file_ctime
      ${CCACHE_PROGRAM})
endif()

add_library(robostress_warnings INTERFACE)
target_compile_options(robostress_warnings INTERFACE -Wall -Wextra -Wno-missing-field-initializers)
if(ROBOSTRESS_WERROR)
  target_compile_options(robostress_warnings INTERFACE -Werror)
endif()
if(CMAKE_CXX_COMPILER_ID MATCHES Clang)
  target_compile_options(robostress_warnings INTERFACE -Wthread-safety)
endif()

if(ROBOSTRESS_SANITIZE)
  add_compile_options(-fsanitize=${ROBOSTRESS_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${ROBOSTRESS_SANITIZE})
endif()
if(ROBOSTRESS_SANITIZE MATCHES thread)
  # Debian's absl is not instrumented: what its locks do is told by common/tsan_mutex.cc.
  set(wrapped
    _ZN4absl7debian35Mutex4LockEv
    _ZN4absl7debian35Mutex6UnlockEv
    _ZNK4absl7debian35Mutex10AssertHeldEv
    _ZN4absl7debian35Mutex5AwaitERKNS0_9ConditionE
    _ZN4absl7debian35Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE
    _ZN4absl7debian312Notification6NotifyEv
    _ZNK4absl7debian312Notification19WaitForNotificationEv
    _ZNK4absl7debian312Notification30WaitForNotificationWithTimeoutENS0_8DurationE
    _ZN4absl7debian315BlockingCounter14DecrementCountEv
    _ZN4absl7debian315BlockingCounter4WaitEv)
  list(TRANSFORM wrapped PREPEND "LINKER:--wrap=")
  add_link_options(${wrapped})
  add_library(robostress_tsan_mutex STATIC ${PROJECT_SOURCE_DIR}/common/tsan_mutex.cc)
  link_libraries(robostress_tsan_mutex)
endif()
