# Script that writes OUTPUT from INPUT with PROJECT_VERSION and the revision of the checkout in SOURCE_DIR. It does not touch
# OUTPUT unless the content changes, so that a build without a new commit relinks nothing.
execute_process(
  COMMAND git -C ${SOURCE_DIR} describe --always --exclude=*
  OUTPUT_VARIABLE GIT_REVISION OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
# Changed or added files; images are built without those of .dockerignore.
execute_process(
  COMMAND git -C ${SOURCE_DIR} diff --quiet --diff-filter=d HEAD
  OUTPUT_QUIET ERROR_QUIET RESULT_VARIABLE changed)
if(failed)
  set(GIT_REVISION unknown)
elseif(changed)
  string(APPEND GIT_REVISION -dirty)
endif()
configure_file(${INPUT} ${OUTPUT} @ONLY)
