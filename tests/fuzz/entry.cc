#include "common/telemetry/log.h"
#include "tests/fuzz/fuzz_target.h"

// Silences warnings: most of the hundred thousand inputs are invalid.
extern "C" int LLVMFuzzerInitialize(int* /*argc*/, char*** /*argv*/) {
  craftfleet::LogOptions options;
  options.level = craftfleet::LogLevel::kError;
  craftfleet::SetUpLog(options);
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  craftfleet::TryInput({reinterpret_cast<const char*>(data), size});
  return 0;
}
