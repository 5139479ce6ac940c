// What a test must know about the sanitizer that it runs under.

#ifndef CRAFTFLEET_TESTS_FAKES_SANITIZERS_H_
#define CRAFTFLEET_TESTS_FAKES_SANITIZERS_H_

namespace craftfleet {

// AddressSanitizer needs address space without a limit, and keeps 256 MB that were freed.
#if defined(__SANITIZE_ADDRESS__)  // GCC
inline constexpr bool kAddressSanitizer = true;
#elif defined(__has_feature)  // clang
inline constexpr bool kAddressSanitizer = __has_feature(address_sanitizer);
#else
inline constexpr bool kAddressSanitizer = false;
#endif

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_SANITIZERS_H_
