// Detects the sanitizer that a test runs under.

#pragma once

namespace craftfleet {

// AddressSanitizer needs unlimited address space, and keeps 256 MB of freed memory.
#if defined(__SANITIZE_ADDRESS__)  // GCC
inline constexpr bool kAddressSanitizer = true;
#elif defined(__has_feature)  // clang
inline constexpr bool kAddressSanitizer = __has_feature(address_sanitizer);
#else
inline constexpr bool kAddressSanitizer = false;
#endif

}  // namespace craftfleet
