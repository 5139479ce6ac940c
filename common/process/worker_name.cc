#include "common/process/worker_name.h"

#include <unistd.h>

#include <random>

#include <absl/strings/str_format.h>

#include "common/base/printable.h"

namespace craftfleet {

std::string UniqueWorkerName() {
  char host[256] = "host";
  gethostname(host, sizeof(host) - 1);
  return absl::StrFormat("%s-%d-%08x", Printable(host), getpid(), std::random_device()());
}

}  // namespace craftfleet
