# Functions that declare libraries, programs and tests.

# Warnings for our code only; third-party headers are included as SYSTEM. -ffp-contract=off: a fused multiply-add would change
# the last bits of results, and games must be the same on every CPU.
add_library(craftfleet_flags INTERFACE)
target_compile_options(craftfleet_flags INTERFACE -Wall -Wextra $<$<BOOL:${CRAFTFLEET_WERROR}>:-Werror> -ffp-contract=off)
if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
  target_compile_options(craftfleet_flags INTERFACE -Wthread-safety)
endif()

# Links take a fraction of the time.
include(CheckLinkerFlag)
check_linker_flag(CXX -fuse-ld=lld CRAFTFLEET_HAS_LLD)
if(CRAFTFLEET_HAS_LLD)
  target_link_options(craftfleet_flags INTERFACE -fuse-ld=lld)
endif()

# The allocator of programs and benchmarks. Each arena of glibc's malloc keeps the peak memory of its threads. That adds up
# when megabytes pass through short-lived threads of connections: the learner of a fleet under chaos tests grew from 200 to
# 330 MB in half an hour. tcmalloc has one heap for all threads.
add_library(craftfleet_heap INTERFACE)
if(CRAFTFLEET_WITH_TCMALLOC)
  pkg_check_modules(tcmalloc REQUIRED IMPORTED_TARGET libtcmalloc_minimal)
  target_link_libraries(craftfleet_heap INTERFACE PkgConfig::tcmalloc)
endif()

# Compiles up to 16 sources of a target together. With gcc 12 most of the time goes into headers, which a unit of many files
# parses once. (Precompiled headers save nothing there: loading them takes as long.) Sources with compiler options of their own
# stay apart.
function(craftfleet_compile_together target)
  if(CRAFTFLEET_UNITY)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 16)
    target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
  endif()
endfunction()

# craftfleet_library(NAME world SRCS ... DEPS ...): static library craftfleet_world with the alias craftfleet::world.
function(craftfleet_library)
  cmake_parse_arguments(ARG "" "NAME" "SRCS;DEPS" ${ARGN})
  add_library(craftfleet_${ARG_NAME} STATIC ${ARG_SRCS})
  add_library(craftfleet::${ARG_NAME} ALIAS craftfleet_${ARG_NAME})
  target_include_directories(craftfleet_${ARG_NAME} PUBLIC ${PROJECT_SOURCE_DIR})
  target_link_libraries(craftfleet_${ARG_NAME} PUBLIC ${ARG_DEPS} PRIVATE craftfleet_flags)
  set_property(GLOBAL APPEND PROPERTY CRAFTFLEET_LIBRARIES craftfleet_${ARG_NAME})
  craftfleet_compile_together(craftfleet_${ARG_NAME})
  if(TARGET craftfleet_library_headers)
    target_precompile_headers(craftfleet_${ARG_NAME} REUSE_FROM craftfleet_library_headers)
  endif()
endfunction()

# craftfleet_program(NAME craftfleet-actor SRCS ... DEPS ...): an executable in build/bin that is installed. It finds
# LibTorch through a link (cmake/libtorch.cmake), by an old-style RPATH, because a RUNPATH does not apply to indirect dependencies.
function(craftfleet_program)
  cmake_parse_arguments(ARG "" "NAME" "SRCS;DEPS" ${ARGN})
  add_executable(${ARG_NAME} ${ARG_SRCS})
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS} craftfleet_heap craftfleet_flags)
  target_link_options(${ARG_NAME} PRIVATE -Wl,--disable-new-dtags)
  # The build tree uses the same RPATH. If CMake rewrote it when installing, it would reserve space with an empty entry, which
  # the loader takes for the working folder.
  set_target_properties(${ARG_NAME} PROPERTIES BUILD_WITH_INSTALL_RPATH ON
    INSTALL_RPATH "$ORIGIN/../lib/craftfleet/libtorch")
  install(TARGETS ${ARG_NAME} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endfunction()

# craftfleet_test(NAME learner_test LABELS unit tsan SRCS a_test.cc b_test.cc DEPS ...): GoogleTest sources of the executable
# NAME. One executable holds the tests of a folder, since linking LibTorch and gRPC takes longer than compiling a test: further
# calls with its NAME add sources, also with other labels. There is one ctest entry per TEST, so that `ctest` finds them by name;
# with CRAFTFLEET_TEST_PROGRAMS, one per call, because a program with LibTorch takes a second to start. A source that takes long or
# changes its process has a call of its own, and with a TIMEOUT or one of the labels below each has an entry. Those with the longest
# TIMEOUT start first. Tests find files and programs with test_paths.h.
function(craftfleet_test)
  cmake_parse_arguments(ARG "" "NAME;TIMEOUT" "SRCS;DEPS;LABELS" ${ARGN})
  if(CRAFTFLEET_TEST_LIBRARIES AND NOT ARG_LABELS MATCHES "unit|property")
    return()
  endif()
  if(NOT TARGET ${ARG_NAME})
    add_executable(${ARG_NAME})
    target_link_libraries(${ARG_NAME} PRIVATE craftfleet::test_paths GTest::gmock GTest::gtest_main craftfleet_flags)
    # Compiling tests takes longer than running them, so they are not optimised; the code under test is.
    target_compile_options(${ARG_NAME} PRIVATE -O0)
    craftfleet_compile_together(${ARG_NAME})
    if(TARGET craftfleet_test_headers)
      target_precompile_headers(${ARG_NAME} REUSE_FROM craftfleet_test_headers)
    endif()
  endif()
  target_link_libraries(${ARG_NAME} PRIVATE ${ARG_DEPS})
  list(LENGTH ARG_SRCS count)
  set(others "")
  if(count GREATER 1 AND NOT ARG_TIMEOUT AND NOT ARG_LABELS MATCHES "golden|integration|slow")
    set(others _and_others)
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  set(all_filter "")
  set(entries "")
  foreach(source IN LISTS ARG_SRCS)
    target_sources(${ARG_NAME} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/${source})
    craftfleet_new_suites(${ARG_NAME} ${CMAKE_CURRENT_SOURCE_DIR}/${source} filter)
    string(APPEND all_filter "${filter}")
    if(NOT entries OR NOT others)
      get_filename_component(entry ${source} NAME_WE)
      list(APPEND entries ${entry})
      set(filter_of_${entry} "")
    endif()
    string(APPEND filter_of_${entry} "${filter}")
  endforeach()
  if(NOT all_filter)
    return()
  endif()
  if(CRAFTFLEET_TEST_PROGRAMS)
    foreach(entry IN LISTS entries)
      if(filter_of_${entry})
        set(test ${ARG_NAME}/${entry}${others})
        add_test(NAME ${test} COMMAND ${ARG_NAME} --gtest_filter=${filter_of_${entry}})
        set_tests_properties(${test} PROPERTIES LABELS "${ARG_LABELS}" COST ${ARG_TIMEOUT} TIMEOUT 1800)
      endif()
    endforeach()
    return()
  endif()
  # CMake 3.25 expands the list of labels four times before ctest reads it; without the backslashes only its first entry
  # would remain, and no timeout.
  string(REPLACE ";" "\\\\\\\\\\\\\\\\;" labels "${ARG_LABELS}")
  gtest_discover_tests(${ARG_NAME} TEST_FILTER "${all_filter}" DISCOVERY_TIMEOUT 60
                       PROPERTIES LABELS "${labels}" TIMEOUT ${ARG_TIMEOUT})
endfunction()

# Sets `result` to a filter for the suites of a source of tests that no source of the program `name` before it has.
function(craftfleet_new_suites name source result)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${source})
  get_target_property(known ${name} CRAFTFLEET_SUITES)
  file(STRINGS ${source} lines REGEX "^(TYPED_)?TEST(_F|_P)?\\(")
  list(TRANSFORM lines REPLACE "^[A-Z_]+\\( *([A-Za-z0-9_]+).*" "\\1")
  list(REMOVE_DUPLICATES lines)
  list(REMOVE_ITEM lines ${known})
  set_property(TARGET ${name} APPEND PROPERTY CRAFTFLEET_SUITES ${lines})
  set(filter "")
  foreach(suite IN LISTS lines)
    string(APPEND filter "${suite}.*:${suite}/*:*/${suite}.*:*/${suite}/*:")
  endforeach()
  set(${result} "${filter}" PARENT_SCOPE)
endfunction()
include(GoogleTest)

# craftfleet_python_test(NAME LocalFleet SCRIPT local_fleet_test.py LABELS integration): one ctest entry per `def test_...` of
# the script, which calls main() of tests/fakes/python_case.py; with CRAFTFLEET_TEST_PROGRAMS, one for all of them, unless
# EACH_CASE is given, which cases need that use what another one has made.
function(craftfleet_python_test)
  cmake_parse_arguments(ARG "EACH_CASE" "NAME;SCRIPT;TIMEOUT" "LABELS" ${ARGN})
  set(script ${CMAKE_CURRENT_SOURCE_DIR}/${ARG_SCRIPT})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${script})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  set(cost ${ARG_TIMEOUT})
  if(CRAFTFLEET_TEST_PROGRAMS AND NOT ARG_EACH_CASE)
    add_test(NAME ${ARG_NAME} COMMAND python3 ${script})
    set(tests ${ARG_NAME})
    set(ARG_TIMEOUT 1800)
  else()
    file(STRINGS ${script} tests REGEX "^ +def test_")
    list(TRANSFORM tests REPLACE "^ +def test_([A-Za-z0-9_]+).*" "\\1")
    foreach(case IN LISTS tests)
      add_test(NAME ${ARG_NAME}.${case} COMMAND python3 ${script} test_${case})
    endforeach()
    list(TRANSFORM tests PREPEND "${ARG_NAME}.")
  endif()
  if(CRAFTFLEET_TEST_PROGRAMS)
    set_tests_properties(${tests} PROPERTIES COST ${cost})
  endif()
  set_tests_properties(${tests} PROPERTIES LABELS "${ARG_LABELS}" TIMEOUT ${ARG_TIMEOUT} SKIP_RETURN_CODE 77
    ENVIRONMENT "CRAFTFLEET_BIN_DIR=${CMAKE_BINARY_DIR}/bin;CRAFTFLEET_SOURCE_DIR=${PROJECT_SOURCE_DIR};PYTHONDONTWRITEBYTECODE=1;PYTHONPATH=${PROJECT_SOURCE_DIR}")
endfunction()
