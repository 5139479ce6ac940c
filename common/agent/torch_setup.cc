#include "common/agent/torch_setup.h"

#include <dlfcn.h>

#include <fstream>
#include <istream>
#include <optional>
#include <sstream>

#include <ATen/Context.h>
#include <ATen/Parallel.h>
#include <ATen/Version.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/agent/linear.h"
#include "common/base/printable.h"

namespace craftfleet {
namespace {

// openblas_set_num_threads; null under another BLAS. Not a weak symbol: see linear.cc.
using SetThreads = void (*)(int threads);
SetThreads FindOpenBlasSetThreads() {
  static const auto set_threads = reinterpret_cast<SetThreads>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"));
  return set_threads;
}

// The rest of the first line that begins with `prefix`.
std::optional<std::string> ValueAfter(absl::string_view prefix, std::istream* lines) {
  for (std::string line; std::getline(*lines, line);) {
    if (absl::StartsWith(line, prefix)) return line.substr(prefix.size());
  }
  return std::nullopt;
}

}  // namespace

void SetUpTorchThread() {
  thread_local bool is_set_up = false;
  if (is_set_up) return;
  at::set_num_threads(1);
  // Ignores at::set_num_threads.
  if (const SetThreads set_threads = FindOpenBlasSetThreads(); set_threads != nullptr) set_threads(1);
  at::globalContext().setFlushDenormal(true);
  is_set_up = true;
}

std::string SlowMathWarning() {
  if (LinearUsesOneDnn() || FindOpenBlasSetThreads() != nullptr || at::hasMKL()) return "";
  return "LibTorch runs on the reference BLAS: install libopenblas0-pthread; without it training is 4.5 times slower";
}

std::string CpuDescription() {
  std::ifstream info("/proc/cpuinfo");
  const std::string model = ValueAfter("model name\t: ", &info).value_or("unknown CPU");
  // The only place where LibTorch 1.13 reports the instruction set in use.
  std::istringstream config(at::show_config());
  return absl::StrCat(Printable(model), ", ", ValueAfter("  - CPU capability usage: ", &config).value_or("plain"));
}

}  // namespace craftfleet
