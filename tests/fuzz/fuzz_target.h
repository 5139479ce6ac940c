// The interface of a fuzz target. Each fuzz_NAME.cc defines both functions; it is linked with libFuzzer's main to
// search, and with replay_main.cc to replay the inputs in corpus/NAME.tar.gz.

#ifndef CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_
#define CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Passes the untrusted `input` to the code under test, and aborts (CRAFTFLEET_CHECK) if an invariant is broken.
void TryInput(absl::string_view input);

// Valid inputs, and some that are nearly valid, to start from.
std::vector<std::string> SoundInputs();

}  // namespace craftfleet

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv);
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

#endif  // CRAFTFLEET_TESTS_FUZZ_FUZZ_TARGET_H_
