#include "common/agent/safetensors.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

constexpr char kMetadata[] = "__metadata__";
constexpr char kFloat32[] = "F32";
constexpr char kUint8[] = "U8";
constexpr size_t kLengthBytes = 8;
constexpr size_t kMaxHeaderBytes = 100'000'000;  // the format's own limit

absl::Status Bad(absl::string_view what) { return absl::InvalidArgumentError(absl::StrCat("safetensors: ", what)); }

// For errors. Arrays and objects only by their kind: writing one recurses, and it may be nested a million times.
std::string Shown(const json& value) {
  if (value.is_structured()) return absl::StrCat("an ", value.type_name());
  return value.dump(-1, ' ', true, json::error_handler_t::replace);
}

// The whole numbers of array `value`; `what` names it in the error.
absl::StatusOr<std::vector<int64_t>> Counts(const json& value, const std::string& what) {
  if (!value.is_array()) return Bad(absl::StrCat(what, " is not an array"));
  std::vector<int64_t> counts;
  for (const json& count : value) {
    if (!count.is_number_unsigned() || count.get<uint64_t>() > std::numeric_limits<int64_t>::max()) {
      return Bad(absl::StrCat(what, " has ", Shown(count), ", want whole numbers"));
    }
    counts.push_back(count.get<int64_t>());
  }
  return counts;
}

// Bytes of a tensor of `shape`; -1 if they are more than `limit`.
int64_t BytesOfShape(const std::vector<int64_t>& shape, SafeTensor::Type type, size_t limit) {
  if (std::count(shape.begin(), shape.end(), 0) > 0) return 0;
  uint64_t bytes = type == SafeTensor::Type::kFloat32 ? sizeof(float) : 1;
  for (const int64_t length : shape) {
    if (bytes > limit / static_cast<uint64_t>(length)) return -1;
    bytes *= length;
  }
  return static_cast<int64_t>(bytes);
}

// One entry of the header; `data` is all that follows the header.
absl::StatusOr<SafeTensor> ReadTensor(const std::string& name, const json& entry, absl::string_view data) {
  const std::string what = absl::StrCat("tensor \"", name, "\"");
  if (!entry.is_object() || !entry.contains("dtype") || !entry.contains("shape") || !entry.contains("data_offsets")) {
    return Bad(absl::StrCat(what, " lacks dtype, shape or data_offsets"));
  }
  const json& dtype = entry["dtype"];
  if (dtype != kFloat32 && dtype != kUint8) {
    return Bad(absl::StrCat(what, " has dtype ", Shown(dtype), ", want F32 or U8"));
  }
  const SafeTensor::Type type = dtype == kFloat32 ? SafeTensor::Type::kFloat32 : SafeTensor::Type::kUint8;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<int64_t> shape, Counts(entry["shape"], what + ": shape"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<int64_t> offsets,
                              Counts(entry["data_offsets"], what + ": data_offsets"));
  if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > static_cast<int64_t>(data.size())) {
    return Bad(absl::StrCat(what, ": data_offsets do not lie in the data of ", data.size(), " bytes"));
  }
  const int64_t bytes = offsets[1] - offsets[0];
  if (bytes != BytesOfShape(shape, type, data.size())) {
    return Bad(absl::StrCat(what, " has ", bytes, " bytes of data, which is not what its shape needs"));
  }
  return SafeTensor{name, std::move(shape), data.substr(offsets[0], bytes), type};
}

absl::Status ReadMetadata(const json& entry, std::map<std::string, std::string>* metadata) {
  if (!entry.is_object()) return Bad("__metadata__ is not an object");
  for (const auto& [key, value] : entry.items()) {
    if (!value.is_string()) return Bad(absl::StrCat("__metadata__ \"", key, "\" is not a string"));
    metadata->emplace(key, value.get<std::string>());
  }
  return absl::OkStatus();
}

// Sorts by place and checks that the tensors cover `data` once.
absl::Status CheckCoverage(absl::string_view data, std::vector<SafeTensor>* tensors) {
  std::stable_sort(tensors->begin(), tensors->end(), [](const SafeTensor& a, const SafeTensor& b) {
    return std::make_pair(a.data.data(), a.data.size()) < std::make_pair(b.data.data(), b.data.size());
  });
  const char* end = data.data();
  for (const SafeTensor& tensor : *tensors) {
    if (tensor.data.data() != end) {
      return Bad(absl::StrCat("the data of tensor \"", tensor.name, "\" ",
                              tensor.data.data() < end ? "overlap the data before" : "leave a gap before"));
    }
    end += tensor.data.size();
  }
  if (end != data.data() + data.size()) return Bad("bytes follow the last tensor");
  return absl::OkStatus();
}

}  // namespace

std::string WriteSafetensors(const SafeTensors& file) {
  ordered_json header = ordered_json::object();
  if (!file.metadata.empty()) header[kMetadata] = file.metadata;
  size_t offset = 0;
  for (const SafeTensor& tensor : file.tensors) {
    header[tensor.name] = {{"dtype", tensor.type == SafeTensor::Type::kFloat32 ? kFloat32 : kUint8},
                           {"shape", tensor.shape},
                           {"data_offsets", std::vector<size_t>{offset, offset + tensor.data.size()}}};
    offset += tensor.data.size();
  }
  std::string text = header.dump(-1, ' ', true, json::error_handler_t::replace);
  text.resize((text.size() + 7) / 8 * 8, ' ');  // so that the data are aligned

  std::string bytes(kLengthBytes, '\0');
  const uint64_t length = text.size();
  std::memcpy(bytes.data(), &length, kLengthBytes);
  bytes.reserve(kLengthBytes + text.size() + offset);
  bytes += text;
  for (const SafeTensor& tensor : file.tensors) bytes.append(tensor.data.data(), tensor.data.size());
  return bytes;
}

absl::StatusOr<SafeTensors> ReadSafetensors(absl::string_view bytes) {
  if (bytes.size() < kLengthBytes) return Bad(absl::StrCat("only ", bytes.size(), " bytes, want at least 8"));
  uint64_t length = 0;
  std::memcpy(&length, bytes.data(), kLengthBytes);
  bytes.remove_prefix(kLengthBytes);
  if (length > bytes.size() || length > kMaxHeaderBytes) {
    return Bad(absl::StrCat("header of ", length, " bytes in a file of ", bytes.size() + kLengthBytes));
  }
  const absl::string_view text = bytes.substr(0, length);
  const absl::string_view data = bytes.substr(length);
  const json header = json::parse(text.begin(), text.end(), nullptr, /*allow_exceptions=*/false);
  if (!header.is_object()) return Bad("the header is not a JSON object");

  SafeTensors file;
  for (const auto& [name, entry] : header.items()) {
    if (name == kMetadata) {
      CRAFTFLEET_RETURN_IF_ERROR(ReadMetadata(entry, &file.metadata));
      continue;
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(SafeTensor tensor, ReadTensor(name, entry, data));
    file.tensors.push_back(std::move(tensor));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckCoverage(data, &file.tensors));
  return file;
}

}  // namespace craftfleet
