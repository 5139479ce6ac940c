# craftfleet::torch: LibTorch, from the system or from CRAFTFLEET_LIBTORCH (also as an environment variable when a build
# folder is first configured). Its headers are SYSTEM headers, without warnings.
#
# deploy/build.sh, deploy/wheel.sh and tests read these cache entries: CRAFTFLEET_LIBTORCH_VERSION ("2.11"), CRAFTFLEET_LIBTORCH_LIB_DIR (the
# folder of libtorch.so), CRAFTFLEET_LIBTORCH_CUDA (ON or OFF).

set(CRAFTFLEET_LIBTORCH "$ENV{CRAFTFLEET_LIBTORCH}" CACHE PATH
    "LibTorch to build against: an unpacked LibTorch, a Python environment with torch, or its site-packages; empty: the system's")

# Sets `out` to the folder under `dir` that has LibTorch's include/ and lib/; fails if there is none.
function(craftfleet_libtorch_root dir out)
  file(GLOB in_python LIST_DIRECTORIES true
       ${dir}/lib/python3*/site-packages/torch ${dir}/lib64/python3*/site-packages/torch ${dir}/lib/python3*/dist-packages/torch)
  foreach(candidate IN ITEMS ${dir} ${dir}/libtorch ${dir}/torch LISTS in_python)
    if(EXISTS ${candidate}/include/torch/csrc/api/include/torch/version.h AND EXISTS ${candidate}/lib/libtorch_cpu.so)
      set(${out} ${candidate} PARENT_SCOPE)
      return()
    endif()
  endforeach()
  message(FATAL_ERROR "CRAFTFLEET_LIBTORCH=${dir}: no LibTorch there; want an unpacked LibTorch, a Python environment with "
                      "torch, or its site-packages")
endfunction()

# Sets `out` to "major.minor" from a version header in one of the include folders.
function(craftfleet_libtorch_version out)
  foreach(dir IN LISTS ARGN)
    foreach(header IN ITEMS torch/headeronly/version.h torch/version.h)
      if(NOT EXISTS ${dir}/${header})
        continue()
      endif()
      file(STRINGS ${dir}/${header} lines REGEX "^#define TORCH_VERSION_(MAJOR|MINOR) +[0-9]+")
      string(REGEX REPLACE ".*MAJOR +([0-9]+).*MINOR +([0-9]+).*" "\\1.\\2" version "${lines}")
      if(version MATCHES "^[0-9]+\\.[0-9]+$")
        set(${out} ${version} PARENT_SCOPE)
        return()
      endif()
    endforeach()
  endforeach()
  message(FATAL_ERROR "No header in ${ARGN} has the version of LibTorch")
endfunction()

add_library(craftfleet_torch INTERFACE)
add_library(craftfleet::torch ALIAS craftfleet_torch)

if(CRAFTFLEET_LIBTORCH)
  get_filename_component(libtorch_dir ${CRAFTFLEET_LIBTORCH} ABSOLUTE BASE_DIR ${CMAKE_SOURCE_DIR})
  craftfleet_libtorch_root(${libtorch_dir} libtorch_root)
  set(libtorch_lib ${libtorch_root}/lib)

  # LibTorch and the system's gRPC and Protobuf must use the same ABI of std::string.
  file(STRINGS ${libtorch_lib}/libc10.so new_abi REGEX "_ZN3c105ErrorC[12]ENS_14SourceLocationENSt7__cxx11" LIMIT_COUNT 1)
  if(NOT new_abi)
    message(FATAL_ERROR "CRAFTFLEET_LIBTORCH=${CRAFTFLEET_LIBTORCH}: this LibTorch has the pre-C++11 ABI; want one with the "
                        "C++11 ABI (wheels from torch 2.6 on, zip files named cxx11-abi)")
  endif()

  # A wheel also contains headers of other libraries, such as its own Protobuf: use only those of LibTorch.
  set(libtorch_include ${CMAKE_BINARY_DIR}/libtorch/include)
  file(MAKE_DIRECTORY ${libtorch_include})
  foreach(name IN ITEMS ATen c10 caffe2 torch)
    file(CREATE_LINK ${libtorch_root}/include/${name} ${libtorch_include}/${name} SYMBOLIC)
  endforeach()
  set(libtorch_includes ${libtorch_include} ${libtorch_include}/torch/csrc/api/include)

  # Linked directly, because LibTorch's CMake configuration requires the CUDA toolkit, which this project does not use.
  # Programs use no symbol of libtorch.so, but it loads CUDA if LibTorch has it, so it must be linked all the same. The same
  # programs therefore run with and without CUDA.
  target_include_directories(craftfleet_torch SYSTEM INTERFACE ${libtorch_includes})
  target_link_libraries(craftfleet_torch INTERFACE
    -Wl,--push-state,--no-as-needed,${libtorch_lib}/libtorch.so,--pop-state ${libtorch_lib}/libtorch_cpu.so ${libtorch_lib}/libc10.so)
  # The wheel's libraries export parts of their own C++ standard library, such as std::filesystem, which crash in other
  # programs. Symbols come from the library that was linked first.
  target_link_options(craftfleet_torch INTERFACE LINKER:--push-state,--no-as-needed,-lstdc++,--pop-state)
  # The link through which programs find it (see craftfleet_program), in the build tree and in installations.
  file(MAKE_DIRECTORY ${CMAKE_BINARY_DIR}/lib/craftfleet)
  file(CREATE_LINK ${libtorch_lib} ${CMAKE_BINARY_DIR}/lib/craftfleet/libtorch SYMBOLIC)
  install(CODE "
    set(dir \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/lib/craftfleet\")
    file(MAKE_DIRECTORY \"\${dir}\")
    file(CREATE_LINK \"${libtorch_lib}\" \"\${dir}/libtorch\" SYMBOLIC)")
else()
  find_package(Torch CONFIG REQUIRED)
  get_filename_component(libtorch_lib ${TORCH_LIBRARY} DIRECTORY)
  set(libtorch_includes ${TORCH_INCLUDE_DIRS})
  target_include_directories(craftfleet_torch SYSTEM INTERFACE ${TORCH_INCLUDE_DIRS})
  target_link_libraries(craftfleet_torch INTERFACE ${TORCH_LIBRARIES})
endif()

craftfleet_libtorch_version(libtorch_version ${libtorch_includes})
if(libtorch_version VERSION_LESS 1.13)
  message(FATAL_ERROR "LibTorch ${libtorch_version} in ${libtorch_lib}: want 1.13 or newer")
endif()
set(libtorch_cuda OFF)
if(EXISTS ${libtorch_lib}/libtorch_cuda.so)
  set(libtorch_cuda ON)
endif()
set(CRAFTFLEET_LIBTORCH_VERSION ${libtorch_version} CACHE INTERNAL "LibTorch's major.minor")
set(CRAFTFLEET_LIBTORCH_LIB_DIR ${libtorch_lib} CACHE INTERNAL "folder of libtorch.so")
set(CRAFTFLEET_LIBTORCH_CUDA ${libtorch_cuda} CACHE INTERNAL "whether it has CUDA")
message(STATUS "LibTorch ${libtorch_version} (CUDA ${libtorch_cuda}): ${libtorch_lib}")
