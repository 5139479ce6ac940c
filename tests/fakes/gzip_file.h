// Reads gzip files; files without compression are read as they are.

#pragma once

#include <zlib.h>

#include <cerrno>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>

#include "common/io/files.h"

namespace craftfleet {

//   NotFound: no such file. DataLoss: cut or damaged. Both name the file.
inline absl::StatusOr<std::string> ReadGzipFile(const std::string& path) {
  const gzFile file = gzopen(path.c_str(), "rb");
  if (file == nullptr) return FileError(errno, "open", path);
  std::string text;
  std::vector<char> buffer(1 << 16);
  int count = 0;
  while ((count = gzread(file, buffer.data(), buffer.size())) > 0) text.append(buffer.data(), count);
  // For a truncated file zlib reports the error only when the file is closed.
  if (gzclose(file) != Z_OK || count != 0) return absl::DataLossError(absl::StrCat(path, ": cut or damaged gzip data"));
  return text;
}

}  // namespace craftfleet
