# Script: writes OUTPUT from INPUT with PROJECT_VERSION and the revision of SOURCE_DIR's checkout. Leaves OUTPUT alone while
# nothing changes, so that a build without a new commit links nothing again.
execute_process(
  COMMAND git -C ${SOURCE_DIR} describe --always --dirty --exclude=*
  OUTPUT_VARIABLE GIT_REVISION OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
if(failed)
  set(GIT_REVISION unknown)
endif()
configure_file(${INPUT} ${OUTPUT} @ONLY)
