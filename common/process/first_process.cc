#include "common/process/first_process.h"

#include <signal.h>
#include <unistd.h>

namespace craftfleet {
namespace {

void EndAt(int signal) { _exit(128 + signal); }

}  // namespace

void LetSignalsEndProcess1() {
  if (getpid() != 1) return;
  signal(SIGTERM, EndAt);
  signal(SIGINT, EndAt);
}

}  // namespace craftfleet

// Sanitizers are not ready at this point.
#if !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__) && !defined(__clang__)
namespace {
__attribute__((section(".preinit_array"), used)) void (*g_before_libraries)() = craftfleet::LetSignalsEndProcess1;
}  // namespace
#endif
