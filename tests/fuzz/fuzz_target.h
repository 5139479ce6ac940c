// What a fuzz target is. Each fuzz_NAME.cc defines both functions; it is linked with libFuzzer's main to search, and
// with replay_main.cc to try the inputs in corpus/NAME again.

#ifndef CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_
#define CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Hands `input` to the code under test as if it came from a stranger, and aborts (CRAFTFLEET_CHECK) on a wrong state.
void TryInput(absl::string_view input);

// Sound inputs to begin with.
std::vector<std::string> SoundInputs();

}  // namespace craftfleet

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv);
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

#endif  // CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_
