# Precompiles the headers that most files include, for the presets asan-ubsan-unit and tsan: once for libraries and once for
# tests, whose options differ. All other builds do without, so that they find a missing #include.
#
# clang refuses a precompiled header in a file whose options differ from its own. Single files with other options have
# SKIP_PRECOMPILE_HEADERS; -pthread, which only users of gRPC have otherwise, is given to all.
target_compile_options(craftfleet_flags INTERFACE -pthread)

file(WRITE ${CMAKE_BINARY_DIR}/precompiled.cc "")
foreach(kind library test)
  set(headers craftfleet_${kind}_headers)
  add_library(${headers} OBJECT ${CMAKE_BINARY_DIR}/precompiled.cc)
  target_link_libraries(${headers} PRIVATE absl::statusor absl::str_format absl::strings absl::time craftfleet_flags)
  target_precompile_headers(${headers} PRIVATE
    <algorithm> <functional> <map> <memory> <string> <vector>
    <absl/status/statusor.h> <absl/strings/str_cat.h> <absl/strings/str_format.h> <absl/time/time.h>)
  # ccache stores a file only if its precompiled header is always the same: without timestamps.
  target_compile_options(${headers} PRIVATE "SHELL:-Xclang -fno-pch-timestamp")
endforeach()
target_link_libraries(craftfleet_test_headers PRIVATE GTest::gmock)
target_precompile_headers(craftfleet_test_headers PRIVATE <gmock/gmock.h> <gtest/gtest.h>)
# The options of the executables of craftfleet_test().
set_target_properties(craftfleet_test_headers PROPERTIES POSITION_INDEPENDENT_CODE OFF)
target_compile_options(craftfleet_test_headers PRIVATE -fPIE -O0)
