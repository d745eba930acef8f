# Debian packages by CPack: one for each component, so that only the server's brings LibTorch.
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME robostress)
set(CPACK_PACKAGE_VENDOR RoboStress)
set(CPACK_PACKAGE_CONTACT "RoboStress maintainers <maintainers@robostress.invalid>")
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_DIRECTORY ${CMAKE_BINARY_DIR}/packages)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_COMPONENTS_ALL ${ROBOSTRESS_COMPONENTS})
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)

# robostress_deb(component package summary text [KEY value...]): KEY is what CPack calls CPACK_DEBIAN_<component>_KEY.
function(robostress_deb component package summary text)
  string(TOUPPER ${component} upper)
  set(prefix CPACK_DEBIAN_${upper}_)
  set(${prefix}PACKAGE_NAME ${package} PARENT_SCOPE)
  # The first line of a description is the package's summary.
  set(CPACK_COMPONENT_${upper}_DESCRIPTION "${summary}\n${text}" PARENT_SCOPE)
  while(ARGN)
    list(POP_FRONT ARGN key value)
    set(${prefix}PACKAGE_${key} "${value}" PARENT_SCOPE)
  endwhile()
  set(folder ${CMAKE_INSTALL_DATADIR}/doc/${package})
  install(FILES ${CMAKE_BINARY_DIR}/packages/copyright ${CMAKE_BINARY_DIR}/packages/changelog.gz
    ${CMAKE_BINARY_DIR}/packages/changelog.Debian.gz DESTINATION ${folder}
    COMPONENT ${component})
endfunction()

set(subject "RoboStress measures how joint errors of an arm hurt a
vision-language-action policy, and what the policy wins back when it
corrects itself by what the arm did.")
robostress_deb(evaluation robostress-evaluation "sweeps of robot policies under joint errors, and reports"
  "${subject}\nThis package has the front door, the sweep, its report and its stores.\nA sweep here needs the worker and the server, too."
  RECOMMENDS "robostress-worker, robostress-server")
robostress_deb(worker robostress-worker "simulated arms with joint errors, for RoboStress"
  "${subject}\nThis package plays the episodes in MuJoCo and draws them without\na display: a Panda, and a Piper behind its CAN frames."
  DEPENDS "libegl-mesa0, libgl1-mesa-dri" SUGGESTS "robostress-evaluation")
robostress_deb(robot-client robostress-robot-client "drives an AgileX Piper by a policy server"
  "${subject}\nThis package commands the arm 30 times a second within limits and\nwatchdogs, records, and teaches by hand. Its proxy corrects any robot\nbetween its client and the policy server of somebody else."
  SUGGESTS "robostress-server, can-utils")
robostress_deb(calibration robostress-calibration "finds what a robot's model lacks, from its logs"
  "${subject}\nThis package fits friction, backlash, compliance and gravity to\nrecordings of joints."
  SUGGESTS "robostress-evaluation")
robostress_deb(server robostress-server "policy server with online self-compensation"
  "${subject}\nThis package serves policies over gRPC and WebSocket, trains and\ninspects them, and has the small policies' weights."
  DEPENDS "libopenblas0-openmp" SUGGESTS "robostress-evaluation")
set(shared "")
if(TARGET robostress_c)
  robostress_deb(library librobostress1 "joint errors of robot arms in C"
    "${subject}\nThis package has the joint errors and the corrections without LibTorch\nas a library for simulators of others."
    SECTION libs)
  set(shared "librobostress1 (= ${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE}), ")
endif()
robostress_deb(dev librobostress-dev "C and C++ libraries of RoboStress"
  "${subject}\nThis package has the joint errors, the corrections without LibTorch and\nthe client of the policy server as static libraries, and the C header."
  SECTION libdevel
  DEPENDS "${shared}libabsl-dev, libeigen3-dev, libgrpc++-dev, libpng-dev, libprotobuf-dev, libspdlog-dev, libssl-dev, libwebp-dev, libyaml-cpp-dev, nlohmann-json3-dev, pkg-config")
set(CPACK_DEBIAN_DEV_PACKAGE_SHLIBDEPS OFF)

file(WRITE ${CMAKE_BINARY_DIR}/packages/copyright
"Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: RoboStress

Files: *
Copyright: 2026 the RoboStress authors
License: Apache-2.0
 On Debian systems the text is in /usr/share/common-licenses/Apache-2.0.
")
execute_process(COMMAND ${GZIP_PROGRAM} -9nc ${PROJECT_SOURCE_DIR}/CHANGELOG.md
  OUTPUT_FILE ${CMAKE_BINARY_DIR}/packages/changelog.gz COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND git log -1 --format=%cD WORKING_DIRECTORY ${PROJECT_SOURCE_DIR}
  OUTPUT_VARIABLE date OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
if(NOT date)
  string(TIMESTAMP date "%a, %d %b %Y %H:%M:%S +0000" UTC)
endif()
file(WRITE ${CMAKE_BINARY_DIR}/packages/changelog.Debian
"robostress (${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE}) unstable; urgency=medium

  * What changed stands in changelog.gz.

 -- ${CPACK_PACKAGE_CONTACT}  ${date}
")
execute_process(COMMAND ${GZIP_PROGRAM} -9nkf ${CMAKE_BINARY_DIR}/packages/changelog.Debian COMMAND_ERROR_IS_FATAL ANY)
# The search path is on purpose (RobostressInstall.cmake): libtorch's BLAS must be the one with OpenMP.
file(WRITE ${CMAKE_BINARY_DIR}/packages/overrides/robostress-server
  "robostress-server: custom-library-search-path RPATH */openblas-openmp *\n")
install(FILES ${CMAKE_BINARY_DIR}/packages/overrides/robostress-server
  DESTINATION ${CMAKE_INSTALL_DATADIR}/lintian/overrides COMPONENT server)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/CHANGELOG.md)

include(CPack)
