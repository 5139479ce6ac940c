// The safetensors format: named tensors of floats or bytes in one byte string. Compatible with Python's `safetensors`
// package. u64 little-endian header length, JSON header {name: {dtype, shape, data_offsets}, "__metadata__": {text:
// text}}, data.

#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// One tensor; `data` is not owned.
struct SafeTensor {
  enum class Type { kFloat32, kUint8 };  // F32, U8

  std::string name;
  std::vector<int64_t> shape;  // row-major
  absl::string_view data;      // little-endian, of any alignment
  Type type = Type::kFloat32;
};

struct SafeTensors {
  std::vector<SafeTensor> tensors;              // in the order of their data
  std::map<std::string, std::string> metadata;  // free text
};

// Names are distinct and not "__metadata__"; `data` has 4 bytes or 1 byte a value, by its type.
std::string WriteSafetensors(const SafeTensors& file);

// `bytes` may be untrusted. The tensors' data point into it.
//   InvalidArgument: not such a file; a dtype other than F32 and U8; data that overlap, leave a gap or are outside the
//   file.
absl::StatusOr<SafeTensors> ReadSafetensors(absl::string_view bytes);

}  // namespace craftfleet
