// The safetensors format: named float tensors in one byte string. What Python's `safetensors` package reads and writes.
// u64 little-endian header length, JSON header {name: {dtype, shape, data_offsets}, "__metadata__": {text: text}},
// data.

#ifndef CRAFTFLEET_COMMON_AGENT_SAFETENSORS_H_
#define CRAFTFLEET_COMMON_AGENT_SAFETENSORS_H_

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// One tensor; `data` belongs to someone else.
struct SafeTensor {
  std::string name;
  std::vector<int64_t> shape;  // row-major
  absl::string_view data;      // float32 little-endian, of any alignment
};

struct SafeTensors {
  std::vector<SafeTensor> tensors;              // in the order of their data
  std::map<std::string, std::string> metadata;  // free text
};

// Names are distinct and not "__metadata__"; `data` has 4 bytes a value.
std::string WriteSafetensors(const SafeTensors& file);

// `bytes` may come from anyone. The tensors' data point into it.
//   InvalidArgument: not such a file; a dtype other than F32; data that overlap, leave a gap or lie outside.
absl::StatusOr<SafeTensors> ReadSafetensors(absl::string_view bytes);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_SAFETENSORS_H_
