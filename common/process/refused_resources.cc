#include "common/process/refused_resources.h"

#include <unistd.h>

#include <exception>
#include <new>
#include <stdexcept>
#include <system_error>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

std::terminate_handler g_before = nullptr;

[[noreturn]] void OnUncaught() {
  try {
    if (const std::exception_ptr error = std::current_exception()) std::rethrow_exception(error);
  } catch (const std::system_error& error) {
    if (error.code() == std::errc::resource_unavailable_try_again) {
      LogError(
          "cannot start another thread: raise the limit of threads (ulimit -u, pids.max of the container, TasksMax of "
          "systemd), or start fewer (--threads)");
      _exit(1);
    }
    LogError("%s", error.what());
    _exit(1);
  } catch (const std::runtime_error& error) {
    // What libraries throw instead.
    LogError("%s: it may be a limit of this system (ulimit -a, the container's)", error.what());
    _exit(1);
  } catch (const std::bad_alloc&) {
    LogError("out of memory: raise the limit (ulimit -v, the container's), or lower what needs it");
    _exit(1);
  } catch (...) {  // NOLINT(bugprone-empty-catch): ends as before
  }
  g_before();
  _exit(1);
}

}  // namespace

void ExplainRefusedResources() { g_before = std::set_terminate(OnUncaught); }

}  // namespace craftfleet
