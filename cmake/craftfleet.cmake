# How a room, a program and a test are declared.

# Warnings for our code only; third-party headers come in as SYSTEM. -ffp-contract=off: a fused multiply-add would change
# last bits, and games must be the same on every CPU.
add_library(craftfleet_flags INTERFACE)
target_compile_options(craftfleet_flags INTERFACE -Wall -Wextra $<$<BOOL:${CRAFTFLEET_WERROR}>:-Werror> -ffp-contract=off)
if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
  target_compile_options(craftfleet_flags INTERFACE -Wthread-safety)
endif()

# What programs and their benchmarks allocate with. Each of the arenas of glibc's malloc keeps the most that its threads have
# ever held at once, which adds up where megabytes pass through threads that come and go with their connections: the learner
# of a fleet under kills grew from 200 to 330 MB in half an hour. tcmalloc has one heap for all threads.
add_library(craftfleet_heap INTERFACE)
if(CRAFTFLEET_WITH_TCMALLOC)
  pkg_check_modules(tcmalloc REQUIRED IMPORTED_TARGET libtcmalloc_minimal)
  target_link_libraries(craftfleet_heap INTERFACE PkgConfig::tcmalloc)
endif()

# craftfleet_library(NAME world SRCS ... DEPS ...): static library craftfleet_world with the alias craftfleet::world.
function(craftfleet_library)
  cmake_parse_arguments(ARG "" "NAME" "SRCS;DEPS" ${ARGN})
  add_library(craftfleet_${ARG_NAME} STATIC ${ARG_SRCS})
  add_library(craftfleet::${ARG_NAME} ALIAS craftfleet_${ARG_NAME})
  target_include_directories(craftfleet_${ARG_NAME} PUBLIC ${PROJECT_SOURCE_DIR})
  target_link_libraries(craftfleet_${ARG_NAME} PUBLIC ${ARG_DEPS} PRIVATE craftfleet_flags)
endfunction()

# craftfleet_program(NAME craftfleet-actor SRCS ... DEPS ...): an installed executable in build/bin. Where it is installed,
# libraries in lib/craftfleet come before the system's; those of a bundle lie there (deploy/bundle.sh). An old-style RPATH,
# because a RUNPATH would not count for what libraries want in turn.
function(craftfleet_program)
  cmake_parse_arguments(ARG "" "NAME" "SRCS;DEPS" ${ARGN})
  add_executable(${ARG_NAME} ${ARG_SRCS})
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS} craftfleet_heap craftfleet_flags)
  target_link_options(${ARG_NAME} PRIVATE -Wl,--disable-new-dtags)
  # The same in the build tree: what CMake could change when it installs would have an empty entry there, which the loader
  # takes for the working folder.
  set_target_properties(${ARG_NAME} PROPERTIES BUILD_WITH_INSTALL_RPATH ON
    INSTALL_RPATH "$ORIGIN/../lib/craftfleet:$ORIGIN/../lib/craftfleet/libtorch")
  install(TARGETS ${ARG_NAME} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endfunction()

# craftfleet_test(NAME fragment_queue_test LABELS unit;tsan SRCS ... DEPS ...): one GoogleTest executable, one ctest entry per
# TEST so that `ctest` counts cases. CRAFTFLEET_SOURCE_DIR tells tests where tests/data lies.
function(craftfleet_test)
  cmake_parse_arguments(ARG "" "NAME;TIMEOUT" "SRCS;DEPS;LABELS" ${ARGN})
  add_executable(${ARG_NAME} ${ARG_SRCS})
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS} GTest::gmock GTest::gtest_main craftfleet_flags)
  # What a test costs is to compile it; what it tests is compiled as it ships.
  target_compile_options(${ARG_NAME} PRIVATE -O0)
  target_compile_definitions(${ARG_NAME} PRIVATE CRAFTFLEET_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
                                                 CRAFTFLEET_BIN_DIR="${CMAKE_BINARY_DIR}/bin")
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  # The list of labels is unpacked four times on its way to ctest (CMake 3.25); without the backslashes only its first
  # entry would arrive, and no timeout.
  string(REPLACE ";" "\\\\\\\\\\\\\\\\;" labels "${ARG_LABELS}")
  gtest_discover_tests(${ARG_NAME} DISCOVERY_TIMEOUT 60 PROPERTIES LABELS "${labels}" TIMEOUT ${ARG_TIMEOUT})
endfunction()
include(GoogleTest)

# craftfleet_python_test(NAME LocalFleet SCRIPT local_fleet_test.py LABELS integration): one ctest entry per `def test_...` of
# the script, which ends with tests/fakes/python_case.py's main().
function(craftfleet_python_test)
  cmake_parse_arguments(ARG "" "NAME;SCRIPT;TIMEOUT" "LABELS" ${ARGN})
  set(script ${CMAKE_CURRENT_SOURCE_DIR}/${ARG_SCRIPT})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${script})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  file(STRINGS ${script} lines REGEX "^ +def test_")
  foreach(line IN LISTS lines)
    string(REGEX REPLACE "^ +def test_([A-Za-z0-9_]+).*" "\\1" case "${line}")
    add_test(NAME ${ARG_NAME}.${case} COMMAND python3 ${script} test_${case})
    set_tests_properties(${ARG_NAME}.${case} PROPERTIES LABELS "${ARG_LABELS}" TIMEOUT ${ARG_TIMEOUT} SKIP_RETURN_CODE 77
      ENVIRONMENT "CRAFTFLEET_BIN_DIR=${CMAKE_BINARY_DIR}/bin;CRAFTFLEET_SOURCE_DIR=${PROJECT_SOURCE_DIR};PYTHONDONTWRITEBYTECODE=1;PYTHONPATH=${PROJECT_SOURCE_DIR}")
  endforeach()
endfunction()
