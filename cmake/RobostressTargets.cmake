# Every target is made by one of these functions; robostress_finish_targets() gives them precompiled headers and unity units.

# robostress_library(NAME sources... DEPS libraries...)
function(robostress_library name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_library(${name} STATIC ${ARG_UNPARSED_ARGUMENTS})
  target_include_directories(${name} PUBLIC $<BUILD_INTERFACE:${CMAKE_SOURCE_DIR}>)
  target_link_libraries(${name} PUBLIC ${ARG_DEPS} PRIVATE $<BUILD_INTERFACE:robostress_options>)
  set_property(GLOBAL APPEND PROPERTY robostress_targets ${name})
endfunction()

# robostress_program(NAME sources... DEPS libraries...): an executable in bin/.
function(robostress_program name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  target_link_libraries(${name} PRIVATE ${ARG_DEPS} rs_run_main robostress_options)
  set_property(GLOBAL APPEND PROPERTY robostress_targets ${name})
endfunction()

# robostress_test_program(NAME sources... DEPS libraries...): a program of the tests, in test_bin/.
function(robostress_test_program name)
  robostress_program(${name} ${ARGN})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/test_bin)
  # A test's own code runs once: -Og compiles it in two thirds of -O2's time.
  target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:-Og>)
endfunction()

# robostress_test(NAME sources... DEPS libraries... [TIMEOUT s]): a GoogleTest program, one ctest entry.
function(robostress_test name)
  if(NOT ROBOSTRESS_TESTS)
    return()
  endif()
  cmake_parse_arguments(ARG "" "TIMEOUT" "DEPS" ${ARGN})
  robostress_test_program(${name} ${ARG_UNPARSED_ARGUMENTS} DEPS ${ARG_DEPS} GTest::gmock GTest::gtest_main)
  set_target_properties(${name} PROPERTIES ROBOSTRESS_HEADERS test_headers)
  add_test(NAME ${name} COMMAND ${name} WORKING_DIRECTORY ${CMAKE_SOURCE_DIR})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  set_tests_properties(${name} PROPERTIES TIMEOUT ${ARG_TIMEOUT}
    ENVIRONMENT "OMP_NUM_THREADS=1;OPENBLAS_NUM_THREADS=1;LP_NUM_THREADS=0")
endfunction()

# robostress_benchmark(NAME sources... DEPS libraries...)
function(robostress_benchmark name)
  if(ROBOSTRESS_BENCHMARKS)
    cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
    robostress_program(${name} ${ARG_UNPARSED_ARGUMENTS} DEPS ${ARG_DEPS} benchmark::benchmark)
  endif()
endfunction()

# robostress_torch(target): links LibTorch. A test or benchmark that is not built is passed over.
function(robostress_torch target)
  if(TARGET ${target})
    target_link_libraries(${target} PUBLIC torch_headers)
    set_target_properties(${target} PROPERTIES ROBOSTRESS_HEADERS torch_headers)
  endif()
endfunction()

# robostress_headers(NAME headers... DEPS libraries...): a precompiled header.
function(robostress_headers name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  file(WRITE ${CMAKE_BINARY_DIR}/${name}.cc "")
  add_library(${name} STATIC ${CMAKE_BINARY_DIR}/${name}.cc)
  target_link_libraries(${name} PUBLIC ${ARG_DEPS} PRIVATE robostress_options)
  if(ROBOSTRESS_PCH)
    target_precompile_headers(${name} PRIVATE ${ARG_UNPARSED_ARGUMENTS})
  endif()
endfunction()

# What many units include and is dear to read. Units with LibTorch take 29 s without.
set(common_headers
  <algorithm> <array> <atomic> <chrono> <cmath> <cstdint> <filesystem> <fstream> <functional> <map> <memory> <optional> <set>
  <string> <thread> <utility> <vector> <absl/status/statusor.h> <absl/strings/match.h> <absl/strings/numbers.h>
  <absl/strings/str_cat.h> <absl/strings/str_format.h> <absl/strings/str_join.h> <absl/strings/str_split.h>
  <absl/synchronization/mutex.h> <Eigen/Core> <Eigen/Geometry> <nlohmann/json.hpp> <spdlog/spdlog.h>)
robostress_headers(common_headers ${common_headers})
if(ROBOSTRESS_TESTS)
  robostress_headers(test_headers ${common_headers} <gmock/gmock.h> <gtest/gtest.h> DEPS GTest::gmock)
endif()
if(ROBOSTRESS_TORCH)
  robostress_headers(torch_headers ${common_headers} <torch/types.h> <torch/autograd.h> DEPS ${TORCH_LIBRARIES})
  target_include_directories(torch_headers SYSTEM PUBLIC ${TORCH_INCLUDE_DIRS})
endif()

# unity_groups(target): compiles the target's sources in groups of at most ROBOSTRESS_UNITY files whose names do not meet.
function(unity_groups target)
  get_target_property(sources ${target} SOURCES)
  get_target_property(folder ${target} SOURCE_DIR)
  list(LENGTH sources count)
  if(count LESS 2)
    return()
  endif()
  execute_process(COMMAND ${AWK_PROGRAM} -v most=${ROBOSTRESS_UNITY} -f ${PROJECT_SOURCE_DIR}/cmake/unity_groups.awk ${sources}
    WORKING_DIRECTORY ${folder} OUTPUT_VARIABLE groups RESULT_VARIABLE failed)
  if(failed)
    message(FATAL_ERROR "unity groups of ${target}: ${AWK_PROGRAM} failed; -D ROBOSTRESS_UNITY=0 does without")
  endif()
  string(REGEX MATCHALL "[^\n]+" groups "${groups}")
  foreach(line ${groups})
    string(REGEX MATCH "^([0-9]+) (.*)$" matched "${line}")
    set_source_files_properties(${folder}/${CMAKE_MATCH_2} TARGET_DIRECTORY ${target} PROPERTIES UNITY_GROUP ${CMAKE_MATCH_1})
  endforeach()
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
endfunction()

# Called once, when all targets are known.
function(robostress_finish_targets)
  if(ROBOSTRESS_UNITY)
    find_program(AWK_PROGRAM NAMES mawk gawk awk REQUIRED)
  endif()
  get_property(targets GLOBAL PROPERTY robostress_targets)
  foreach(target ${targets})
    if(ROBOSTRESS_PCH)
      get_target_property(headers ${target} ROBOSTRESS_HEADERS)
      if(NOT headers)
        set(headers common_headers)
      endif()
      target_precompile_headers(${target} REUSE_FROM ${headers})
    endif()
    if(ROBOSTRESS_UNITY)
      unity_groups(${target})
    endif()
  endforeach()
endfunction()
