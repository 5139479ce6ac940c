#include "common/agent/torch_setup.h"

#include <unistd.h>

#include <csignal>
#include <fstream>
#include <istream>
#include <mutex>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <thread>

#include <ATen/Context.h>
#include <ATen/Parallel.h>
#include <ATen/Version.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <c10/util/Exception.h>
#include <torch/version.h>

#include "common/agent/linear.h"
#include "common/base/find_symbol.h"
#include "common/base/mutex.h"
#include "common/base/need_threads.h"
#include "common/base/printable.h"
#include "common/base/stop_signals.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

// OpenBLAS' openblas_set_num_threads; null under another BLAS.
using SetThreads = void(int threads);
SetThreads* OpenBlasSetThreads() { return FindSymbol<SetThreads>("openblas_set_num_threads"); }

// The rest of the first line that begins with `prefix`.
std::optional<std::string> ValueAfter(absl::string_view prefix, std::istream* lines) {
  for (std::string line; std::getline(*lines, line);) {
    if (absl::StartsWith(line, prefix)) return line.substr(prefix.size());
  }
  return std::nullopt;
}

#if TORCH_VERSION_MAJOR >= 2
namespace Warnings = c10::WarningUtils;
#else
namespace Warnings = c10::Warning;
#endif

class LogOfWarnings final : public c10::WarningHandler {
 public:
#if TORCH_VERSION_MAJOR >= 2
  void process(const c10::Warning& warning) override { LogOnce(warning.msg()); }
#else
  void process(const c10::SourceLocation& /*place*/, const std::string& text, bool /*verbatim*/) override {
    LogOnce(text);
  }
#endif

 private:
  static void LogOnce(const std::string& text) {
    static auto* const mutex = new Mutex;
    static auto* const known = new std::set<std::string>;
    const MutexLock lock(mutex);
    if (known->insert(text).second) LogWarning("LibTorch: %s", text);
  }
};

}  // namespace

void SetUpTorchThread() {
  thread_local bool is_set_up = false;
  if (is_set_up) return;
  // Without a StopSignal the main thread must end at a signal, which then has no handler.
  if (gettid() != getpid()) MaskStopSignals(SIG_BLOCK);
  // LibTorch then starts a thread for each CPU, and hangs if it gets none.
  static std::once_flag once;
  std::call_once(once, NeedThreads, std::thread::hardware_concurrency());
  at::set_num_threads(1);
  // Ignores at::set_num_threads.
  if (SetThreads* const set_threads = OpenBlasSetThreads(); set_threads != nullptr) set_threads(1);
  at::globalContext().setFlushDenormal(true);
  static LogOfWarnings warnings;
  Warnings::set_warning_handler(&warnings);  // of this thread; autograd hands over those of its own threads
  is_set_up = true;
}

std::string SlowMathWarning() {
  if (LinearUsesOneDnn() || OpenBlasSetThreads() != nullptr || at::hasMKL()) return "";
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
