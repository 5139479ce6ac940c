// CRC-32C (Castagnoli), the checksum of checkpoints and of TensorBoard's event files.
// Source: RFC 3720, section 12.1; test vectors in its appendix B.4.

#pragma once

#include <cstdint>

#include <absl/strings/string_view.h>

namespace craftfleet {

uint32_t Crc32c(absl::string_view bytes);

}  // namespace craftfleet
