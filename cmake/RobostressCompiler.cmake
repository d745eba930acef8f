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

option(ROBOSTRESS_CCACHE "Compile through ccache where it is installed" ON)
if(ROBOSTRESS_CCACHE)
  find_program(CCACHE_PROGRAM ccache)
endif()
if(CCACHE_PROGRAM)
  set(CMAKE_CXX_COMPILER_LAUNCHER
      ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros,include_file_mtime,include_file_ctime
      ${CCACHE_PROGRAM})
endif()

# What every unit is compiled with, so that units of different libraries share a precompiled header.
add_library(robostress_options INTERFACE)
target_compile_options(robostress_options INTERFACE -Wall -Wextra -Wno-missing-field-initializers -pthread
  # GCC collects garbage from 128 MB on; a tenth of its time, for 200 MB more.
  $<$<CXX_COMPILER_ID:GNU>:--param=ggc-min-heapsize=1500000>)
if(ROBOSTRESS_UNITY)
  # In a unity unit every source is an included file, where the compiler thinks of anonymous types as a header's.
  target_compile_options(robostress_options INTERFACE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>)
endif()
if(ROBOSTRESS_WERROR)
  target_compile_options(robostress_options INTERFACE -Werror)
endif()
if(CMAKE_CXX_COMPILER_ID MATCHES Clang)
  target_compile_options(robostress_options INTERFACE -Wthread-safety)
endif()

find_program(MOLD_PROGRAM mold)
if(MOLD_PROGRAM)
  include(CheckLinkerFlag)
  check_linker_flag(CXX -fuse-ld=mold LINKS_WITH_MOLD)  # GCC knows the name since 12
endif()
if(LINKS_WITH_MOLD)
  add_link_options(-fuse-ld=mold)  # a fifth of the time of GNU ld
endif()

# No program names the folder that it was built in: __FILE__ begins at the source's root.
add_compile_options(-fmacro-prefix-map=${CMAKE_BINARY_DIR}/= -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/=)

if(ROBOSTRESS_SANITIZE)
  add_compile_options(-fsanitize=${ROBOSTRESS_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all
    # Tests that count allocations replace operator new, by malloc, which is instrumented; GCC then takes the pair for a mistake.
    $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-mismatched-new-delete>)
  add_link_options(-fsanitize=${ROBOSTRESS_SANITIZE})
endif()
if(ROBOSTRESS_SANITIZE MATCHES thread)
  # It does not understand fences, which Boost.Asio and our two sequence locks have: judge a report there by hand.
  add_compile_options($<$<CXX_COMPILER_ID:GNU>:-Wno-tsan>)
  # Debian's absl is not instrumented: what its locks do is told by common/tsan_mutex.cc. Its symbols hold the name of an inline
  # namespace that each version of Debian chooses; @ stands for it.
  find_path(ABSL_INCLUDE_DIR absl/base/options.h REQUIRED)
  file(STRINGS ${ABSL_INCLUDE_DIR}/absl/base/options.h absl_namespace REGEX "^#define ABSL_OPTION_INLINE_NAMESPACE_NAME ")
  string(REGEX REPLACE ".* " "" absl_namespace "${absl_namespace}")
  string(LENGTH "${absl_namespace}" length)
  set(absl_namespace 4absl${length}${absl_namespace})
  set(wrapped
    N@5Mutex4LockEv
    N@5Mutex6UnlockEv
    NK@5Mutex10AssertHeldEv
    N@5Mutex5AwaitERKNS0_9ConditionE
    N@5Mutex16AwaitWithTimeoutERKNS0_9ConditionENS0_8DurationE
    N@5Mutex11AwaitCommonERKNS0_9ConditionENS0_24synchronization_internal13KernelTimeoutE
    N@12Notification6NotifyEv
    NK@12Notification19WaitForNotificationEv
    NK@12Notification30WaitForNotificationWithTimeoutENS0_8DurationE
    N@15BlockingCounter14DecrementCountEv
    N@15BlockingCounter4WaitEv)
  list(TRANSFORM wrapped REPLACE "@" ${absl_namespace})
  list(TRANSFORM wrapped PREPEND "LINKER:--wrap=_Z")
  add_link_options(${wrapped})
  add_library(robostress_tsan_mutex STATIC ${PROJECT_SOURCE_DIR}/common/tsan_mutex.cc)
  target_compile_definitions(robostress_tsan_mutex PRIVATE ROBOSTRESS_ABSL=${absl_namespace})
  link_libraries(robostress_tsan_mutex)
endif()
