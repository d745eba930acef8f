# robostress_library(NAME sources... DEPS libraries...)
function(robostress_library name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_library(${name} STATIC ${ARG_UNPARSED_ARGUMENTS})
  target_include_directories(${name} PUBLIC ${CMAKE_SOURCE_DIR})
  target_link_libraries(${name} PUBLIC ${ARG_DEPS} PRIVATE robostress_warnings)
endfunction()

# robostress_program(NAME sources... DEPS libraries...): an executable in bin/.
function(robostress_program name)
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  target_link_libraries(${name} PRIVATE ${ARG_DEPS} robostress_warnings)
endfunction()

# robostress_test(NAME sources... DEPS libraries...): a GoogleTest program, one ctest entry.
function(robostress_test name)
  if(NOT ROBOSTRESS_TESTS)
    return()
  endif()
  cmake_parse_arguments(ARG "" "TIMEOUT" "DEPS" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/test_bin)
  target_link_libraries(${name} PRIVATE ${ARG_DEPS} GTest::gmock GTest::gtest_main robostress_warnings)
  # A test's own code runs once: -Og compiles it in two thirds of -O2's time.
  target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:-Og>)
  add_test(NAME ${name} COMMAND ${name} WORKING_DIRECTORY ${CMAKE_SOURCE_DIR})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  set_tests_properties(${name} PROPERTIES TIMEOUT ${ARG_TIMEOUT}
    ENVIRONMENT "OMP_NUM_THREADS=1;OPENBLAS_NUM_THREADS=1;LP_NUM_THREADS=0")
endfunction()

# robostress_benchmark(NAME sources... DEPS libraries...)
function(robostress_benchmark name)
  if(NOT ROBOSTRESS_BENCHMARKS)
    return()
  endif()
  cmake_parse_arguments(ARG "" "" "DEPS" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  target_link_libraries(${name} PRIVATE ${ARG_DEPS} benchmark::benchmark robostress_warnings)
endfunction()

# One precompiled header for everything that includes LibTorch, of the parts that are used: a unit takes 4 s with it, 10 s with
# <torch/torch.h> in its place and 29 s without any.
if(ROBOSTRESS_TORCH)
  file(WRITE ${CMAKE_BINARY_DIR}/torch_pch.cc "")
  add_library(torch_pch STATIC ${CMAKE_BINARY_DIR}/torch_pch.cc)
  target_link_libraries(torch_pch PUBLIC ${TORCH_LIBRARIES})
  target_include_directories(torch_pch SYSTEM PUBLIC ${TORCH_INCLUDE_DIRS})
  # gRPC's target adds -pthread, and a precompiled header is refused when the flag differs.
  target_compile_options(torch_pch PUBLIC -pthread)
  target_precompile_headers(torch_pch PRIVATE <torch/types.h> <torch/autograd.h>)
  target_link_libraries(torch_pch PRIVATE robostress_warnings)

  # robostress_torch(target): links LibTorch and reuses the precompiled header. A benchmark that is not
  # built is passed over.
  function(robostress_torch target)
    if(NOT TARGET ${target})
      return()
    endif()
    target_link_libraries(${target} PUBLIC torch_pch)
    if(NOT ROBOSTRESS_NO_PCH)
      target_precompile_headers(${target} REUSE_FROM torch_pch)
    endif()
  endfunction()
endif()
