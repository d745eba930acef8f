# What is installed, where, and in which package: `cmake --install`, find_package(robostress), `./run package`.
# Programs find one another and their data by their own folder (common/program_folder.h): any prefix will do.
if(ROBOSTRESS_SANITIZE)
  return()  # such programs are for tests
endif()
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(ROBOSTRESS_COMPONENTS evaluation worker robot-client calibration server dev)
set(programs_evaluation robostress robostress-sweep robostress-report robostress-export robostress-compare robostress-store robostress-residual robostress-paper
  robostress-error-models robostress-grid-job robostress-scenarios robostress-piper-study)
set(programs_worker robostress-worker robostress-environment robostress-suites robostress-record robostress-replay robostress-libero robostress-piper-worker
  piper_emulator piper_residual)
set(programs_robot-client robot_client robostress-proxy)
set(programs_calibration robostress-calibrate robostress-excite robostress-log robostress-record-to-rig robostress-fidelity robostress-close-loop robostress-identify robostress-urdf)
set(programs_server robostress-serve robostress-sessions robostress-policy robostress-tokenize robostress-train)

# Pages and completions, from the table of options that each program prints.
set(manual ${CMAKE_BINARY_DIR}/manual)
set(tables "")
set(pages "")
set(made "")
file(MAKE_DIRECTORY ${manual}/tables)
find_program(GZIP_PROGRAM gzip REQUIRED)

# option_table(PAGE PROGRAM [COMMAND]): the table of a program, or of its command that is a command line of its own.
function(option_table page program)
  set(table ${manual}/tables/${page}.json)
  add_custom_command(OUTPUT ${table}
    COMMAND ${program} ${ARGN} --option-table > ${table}
    DEPENDS ${program} COMMENT "" VERBATIM)
  set(tables ${tables} ${table} PARENT_SCOPE)
  set(pages ${pages} ${page} PARENT_SCOPE)
endfunction()

foreach(component ${ROBOSTRESS_COMPONENTS})
  set(pages "")
  foreach(program ${programs_${component}})
    if(NOT TARGET ${program})
      continue()  # an option leaves it out
    endif()
    # Libraries of an unpacked archive lie in lib/. RPATH, not RUNPATH: it holds for what those libraries need, too.
    set(rpath "$ORIGIN/../lib")
    if(program MATCHES "serve|policy|train" AND CMAKE_LIBRARY_ARCHITECTURE)
      # LibTorch's BLAS is the one whose threads OpenMP controls, whatever the machine's alternatives say.
      list(APPEND rpath /usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/openblas-openmp)
    endif()
    set_target_properties(${program} PROPERTIES INSTALL_RPATH "${rpath}")
    target_link_options(${program} PRIVATE LINKER:--disable-new-dtags)
    install(TARGETS ${program} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT ${component})
    option_table(${program} ${program})
    if(program STREQUAL robot_client)
      foreach(command cameras monitor replay excite teach)
        option_table(robot_client-${command} robot_client ${command})
      endforeach()
    endif()
  endforeach()
  foreach(page ${pages})
    list(APPEND made ${manual}/man1/${page}.1)
    install(FILES ${manual}/man1/${page}.1.gz DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT ${component})
    if(NOT page MATCHES "^robot_client-")  # its own holds those of its commands
      install(FILES ${manual}/completions/${page} DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions
        COMPONENT ${component})
    endif()
  endforeach()
endforeach()
add_custom_command(OUTPUT ${manual}/made
  COMMAND write_manual --out ${manual} ${tables}
  COMMAND ${GZIP_PROGRAM} -9nkf ${made}
  COMMAND ${CMAKE_COMMAND} -E touch ${manual}/made
  DEPENDS write_manual ${tables} COMMENT "Write manual pages and completions" VERBATIM)
add_custom_target(manual ALL DEPENDS ${manual}/made)
add_dependencies(tests manual)

# What `./run package` builds: no test.
add_custom_target(package_files DEPENDS manual rs_rpc rs_adapter_core rs_joint_errors rs_rollout)
set(CMAKE_SKIP_INSTALL_ALL_DEPENDENCY ON)

# What comes with the programs, at its path in the source below share/robostress.
set(data ${CMAKE_INSTALL_DATADIR}/robostress)
if(ROBOSTRESS_TORCH)
  install(DIRECTORY server/models/weights DESTINATION ${data}/server/models COMPONENT server)
  install(DIRECTORY server/training DESTINATION ${data}/server COMPONENT server FILES_MATCHING PATTERN "*.yaml")
endif()

if(TARGET robostress-libero)
  install(FILES sim_worker/libero/needed_files.sha256 DESTINATION ${data}/sim_worker/libero COMPONENT worker)
endif()

# The service and examples.
set(doc ${CMAKE_INSTALL_DATADIR}/doc)
file(READ deploy/systemd/robostress-serve.service service)
string(REPLACE "/usr/lib/robostress/bin/" "/usr/bin/" service "${service}")
string(REPLACE " ROBOSTRESS_WEIGHTS_DIR=/usr/lib/robostress/weights" "" service "${service}")
string(REGEX REPLACE "Documentation=[^\n]*" "Documentation=man:robostress-serve(1)" service "${service}")
file(WRITE ${CMAKE_BINARY_DIR}/packages/robostress-serve.service "${service}")
if(ROBOSTRESS_TORCH)
  install(FILES ${CMAKE_BINARY_DIR}/packages/robostress-serve.service DESTINATION lib/systemd/system COMPONENT server)
  install(FILES deploy/serve.yaml deploy/README.md DESTINATION ${doc}/robostress-server/examples COMPONENT server)
  install(DIRECTORY deploy/systemd/robostress-serve.service.d deploy/monitoring
    DESTINATION ${doc}/robostress-server/examples COMPONENT server)
endif()
if(ROBOSTRESS_ROBOT_CLIENT)
  install(FILES robot_client/lab.yaml robot_client/bridge/so101.yaml deploy/robostress_bridge.py
    DESTINATION ${doc}/robostress-robot-client/examples COMPONENT robot-client)
  install(PROGRAMS deploy/can0.sh deploy/robostress_bridge_lerobot.py deploy/robostress_bridge_ros2.py
    DESTINATION ${doc}/robostress-robot-client/examples COMPONENT robot-client)
endif()
install(PROGRAMS deploy/robostress_serve_lerobot.py deploy/robostress_serve_vla_eval.py
  DESTINATION ${doc}/robostress-evaluation/examples COMPONENT evaluation)
install(DIRECTORY calibration/rigs DESTINATION ${doc}/robostress-calibration/examples COMPONENT calibration)

# The C++ interface: find_package(robostress), robostress::common, joint_errors, rollout, adapter; client with gRPC.
set(headers ${CMAKE_INSTALL_INCLUDEDIR}/robostress)
foreach(folder common common/libero common/joint_errors common/joint_errors/effects common/rollout common/rpc adapter)
  file(GLOB found CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/${folder}/*.h)
  # Programs' own; what includes LibTorch.
  list(FILTER found EXCLUDE REGEX "/(run_main|option_table|hdf5_file|libero/demonstrations|init_states|zip_entry|adam|compensation|lora|lora_adapter|velocity_field|adaptation_state|update_guard|peft)\\.h$")
  install(FILES ${found} DESTINATION ${headers}/${folder} COMPONENT dev)
endforeach()
install(FILES ${CMAKE_BINARY_DIR}/generated/proto/robostress/v1/policy.pb.h
  ${CMAKE_BINARY_DIR}/generated/proto/robostress/v1/policy.grpc.pb.h proto/robostress/v1/policy.proto
  DESTINATION ${headers}/proto/robostress/v1 COMPONENT dev)
set(cmake_files ${CMAKE_INSTALL_LIBDIR}/cmake/robostress)
function(robostress_export set)
  foreach(pair ${ARGN})
    string(REPLACE "=" ";" pair ${pair})
    list(GET pair 0 target)
    list(GET pair 1 name)
    set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} OUTPUT_NAME robostress_${name})
    target_include_directories(${target} INTERFACE $<INSTALL_INTERFACE:${headers}>)
    install(TARGETS ${target} EXPORT ${set} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT dev)
  endforeach()
  install(EXPORT ${set} NAMESPACE robostress:: FILE ${set}.cmake DESTINATION ${cmake_files} COMPONENT dev)
endfunction()
robostress_export(robostress-core rs_common=common rs_joint_errors=joint_errors rs_rollout=rollout
  rs_adapter_core=adapter)
robostress_export(robostress-client rs_proto=proto rs_rpc=client)
target_include_directories(rs_proto SYSTEM INTERFACE $<INSTALL_INTERFACE:${headers}/proto>)
configure_package_config_file(cmake/robostress-config.cmake.in ${CMAKE_BINARY_DIR}/packages/robostress-config.cmake
  INSTALL_DESTINATION ${cmake_files} NO_SET_AND_CHECK_MACRO)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/packages/robostress-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/packages/robostress-config.cmake
  ${CMAKE_BINARY_DIR}/packages/robostress-config-version.cmake DESTINATION ${cmake_files} COMPONENT dev)

# The C interface: `pkg-config robostress`.
if(TARGET robostress_c)
  list(APPEND ROBOSTRESS_COMPONENTS library)
  install(TARGETS robostress_c LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT library NAMELINK_COMPONENT dev)
  install(FILES python/library/robostress.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT dev)
  file(RELATIVE_PATH includes /${CMAKE_INSTALL_LIBDIR}/pkgconfig /${CMAKE_INSTALL_INCLUDEDIR})
  file(WRITE ${CMAKE_BINARY_DIR}/packages/robostress.pc
"Name: robostress
Description: Joint errors of robot arms, and their compensation
Version: ${PROJECT_VERSION}
Cflags: -I\${pcfiledir}/${includes}
Libs: -L\${pcfiledir}/.. -lrobostress
")
  install(FILES ${CMAKE_BINARY_DIR}/packages/robostress.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT dev)
  add_dependencies(package_files robostress_c)
endif()

include(RobostressDebs)
