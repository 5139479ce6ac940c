#include "actor/recording/npz.h"

#include <zip.h>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "common/io/files.h"

namespace craftfleet {
namespace {

constexpr size_t kAlignment = 64;  // of an npy file's data

// Converts `error` to a status; system errors keep their code.
absl::Status ZipStatus(zip_error_t* error, const std::string& path) {
  if (zip_error_system_type(error) == ZIP_ET_SYS) {
    return FileError(zip_error_code_system(error), "can't write", path);
  }
  return absl::InternalError(absl::StrCat("can't write ", path, ": ", zip_error_strerror(error)));
}

}  // namespace

std::string EncodeNpy(const NpyArray& array) {
  std::string header = absl::StrCat("{'descr': '", array.dtype, "', 'fortran_order': False, 'shape': (",
                                    absl::StrJoin(array.shape, ", "), array.shape.size() == 1 ? "," : "", "), }");
  constexpr size_t kPreamble = 10;  // magic, version, length of the header
  const size_t used = kPreamble + header.size() + 1;
  header.append((kAlignment - used % kAlignment) % kAlignment, ' ');
  header.push_back('\n');
  std::string bytes("\x93NUMPY\x01\x00", 8);
  bytes.push_back(static_cast<char>(header.size() % 256));
  bytes.push_back(static_cast<char>(header.size() / 256));
  return absl::StrCat(bytes, header, array.data);
}

absl::Status WriteNpz(const std::string& path, absl::Span<const NpyArray> arrays) {
  zip_error_t error;
  zip_error_init(&error);
  const absl::Cleanup finish_error = [&error] { zip_error_fini(&error); };
  int code = 0;
  zip_t* zip = zip_open(path.c_str(), ZIP_CREATE | ZIP_TRUNCATE, &code);
  if (zip == nullptr) {
    zip_error_init_with_code(&error, code);
    return ZipStatus(&error, path);
  }
  std::vector<std::string> contents;  // libzip reads them when the file is closed
  contents.reserve(arrays.size());
  for (const NpyArray& array : arrays) {
    const std::string& bytes = contents.emplace_back(EncodeNpy(array));
    zip_source_t* source = zip_source_buffer(zip, bytes.data(), bytes.size(), /*freep=*/0);
    if (source == nullptr ||
        zip_file_add(zip, absl::StrCat(array.name, ".npy").c_str(), source, ZIP_FL_ENC_UTF_8) < 0) {
      absl::Status status = ZipStatus(zip_get_error(zip), path);
      zip_source_free(source);
      zip_discard(zip);
      return status;
    }
  }
  if (zip_close(zip) == 0) return absl::OkStatus();
  absl::Status status = ZipStatus(zip_get_error(zip), path);
  zip_discard(zip);
  return status;
}

}  // namespace craftfleet
