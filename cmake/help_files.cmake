# Generates man pages and completions for bash and zsh from the flags of the programs, in share/ of the build folder, and
# installs them. Skipped without Python, without most of the programs, and where they are for another CPU.
find_package(Python3 COMPONENTS Interpreter)
if(NOT Python3_FOUND OR NOT CRAFTFLEET_WITH_FLEET OR CMAKE_CROSSCOMPILING)
  message(STATUS "No Python 3, no fleet, or cross-compiling: no man pages and no shell completion")
  return()
endif()

get_property(programs GLOBAL PROPERTY CRAFTFLEET_PROGRAMS)
file(GLOB python_sources CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/deploy/python/craftfleet/analysis/*.py)
set(help_stamp ${CMAKE_BINARY_DIR}/help_files.stamp)
add_custom_command(
  OUTPUT ${help_stamp}
  COMMAND ${Python3_EXECUTABLE} ${PROJECT_SOURCE_DIR}/deploy/help_files.py --bin=${CMAKE_BINARY_DIR}/bin --out=${CMAKE_BINARY_DIR}/share
          --version=${PROJECT_VERSION}
  COMMAND ${CMAKE_COMMAND} -E touch ${help_stamp}
  DEPENDS ${PROJECT_SOURCE_DIR}/deploy/help_files.py ${programs} ${python_sources} VERBATIM)
add_custom_target(craftfleet_help_files ALL DEPENDS ${help_stamp})

foreach(folder IN ITEMS bash-completion man zsh)
  install(DIRECTORY ${CMAKE_BINARY_DIR}/share/${folder} DESTINATION ${CMAKE_INSTALL_DATADIR})
endforeach()
