// Reads gzip files, and plain ones as they are.

#ifndef CRAFTFLEET_COMMON_GZIP_FILE_H_
#define CRAFTFLEET_COMMON_GZIP_FILE_H_

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

//   NotFound: no such file. DataLoss: cut or damaged. Both name the file.
absl::StatusOr<std::string> ReadGzipFile(const std::string& path);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_GZIP_FILE_H_
