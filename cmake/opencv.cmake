# The modules of OpenCV as targets opencv_core, opencv_imgproc, ... Found one by one, because OpenCV's own CMake configuration
# requires every module of Debian's libopencv-dev, with GDAL and 200 other packages.
find_path(OPENCV_INCLUDE_DIR opencv2/core.hpp PATH_SUFFIXES opencv4 REQUIRED)

# craftfleet_opencv(found videoio): the target opencv_videoio, and whether there is such a module.
function(craftfleet_opencv found module)
  find_library(OPENCV_${module}_LIBRARY opencv_${module})
  set(${found} OFF PARENT_SCOPE)
  if(OPENCV_${module}_LIBRARY AND EXISTS ${OPENCV_INCLUDE_DIR}/opencv2/${module}.hpp)
    add_library(opencv_${module} UNKNOWN IMPORTED GLOBAL)
    set_target_properties(opencv_${module} PROPERTIES IMPORTED_LOCATION ${OPENCV_${module}_LIBRARY})
    target_include_directories(opencv_${module} SYSTEM INTERFACE ${OPENCV_INCLUDE_DIR})
    if(NOT module STREQUAL core)
      target_link_libraries(opencv_${module} INTERFACE opencv_core)
    endif()
    set(${found} ON PARENT_SCOPE)
  endif()
endfunction()

# As craftfleet_opencv, for modules that must be there.
function(craftfleet_require_opencv)
  foreach(module IN LISTS ARGN)
    craftfleet_opencv(found ${module})
    if(NOT found)
      message(FATAL_ERROR "OpenCV's module ${module} is missing, want Debian's libopencv-${module}-dev (deploy/install-deps.sh)")
    endif()
  endforeach()
endfunction()

# craftfleet_optional_opencv(CRAFTFLEET_WITH_VIDEO videoio): turns the AUTO of an option into ON or OFF.
macro(craftfleet_optional_opencv option module)
  if(${option} STREQUAL AUTO)
    craftfleet_opencv(${option} ${module})
  elseif(${option})
    craftfleet_require_opencv(${module})
  endif()
  message(STATUS "${option}: ${${option}}")
endmacro()
