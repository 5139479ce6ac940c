// NumPy's file formats: named arrays (npy) in a compressed zip file (npz), as numpy.savez_compressed writes them.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/types/span.h>

namespace craftfleet {

struct NpyArray {
  std::string name;            // as in numpy.load(file)[name]
  std::string dtype;           // "|u1", "|b1", "<i8", "<f8"
  std::vector<int64_t> shape;  // [n, ...]
  std::string data;            // its values, row-major, little-endian
};

// Encodes the array as an npy file, format 1.0.
std::string EncodeNpy(const NpyArray& array);

// Writes `arrays` to `path`, completely or not at all; replaces an existing file.
//   Codes of common/io/files.h, or Internal with the zip library's message.
absl::Status WriteNpz(const std::string& path, absl::Span<const NpyArray> arrays);

}  // namespace craftfleet
