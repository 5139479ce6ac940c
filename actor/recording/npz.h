// numpy's file formats: arrays (npy) by name in a compressed zip (npz), as numpy.savez_compressed writes them.

#ifndef CRAFTFLEET_ACTOR_RECORDING_NPZ_H_
#define CRAFTFLEET_ACTOR_RECORDING_NPZ_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/types/span.h>

namespace craftfleet {

struct NpyArray {
  std::string name;            // by which numpy.load(file)[name] finds it
  std::string dtype;           // "|u1", "|b1", "<i8", "<f8"
  std::vector<int64_t> shape;  // [n, ...]
  std::string data;            // its values, row-major, little-endian
};

// The array as the bytes of an npy file, format 1.0.
std::string EncodeNpy(const NpyArray& array);

// Writes `arrays` to `path`, whole or not at all; a file there is replaced.
//   The codes of common/files.h, or Internal with the zip library's words.
absl::Status WriteNpz(const std::string& path, absl::Span<const NpyArray> arrays);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_RECORDING_NPZ_H_
