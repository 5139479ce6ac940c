// Reads gzip files; files without compression are read as they are.

#ifndef CRAFTFLEET_COMMON_IO_GZIP_FILE_H_
#define CRAFTFLEET_COMMON_IO_GZIP_FILE_H_

#include <string>

#include <absl/functional/function_ref.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

//   NotFound: no such file. DataLoss: cut or damaged. Both name the file.
absl::StatusOr<std::string> ReadGzipFile(const std::string& path);

// The same for a file of any size: calls `take` for one piece after the other. The first error of `take` ends the
// reading and is returned.
absl::Status ReadGzipPieces(const std::string& path, absl::FunctionRef<absl::Status(absl::string_view piece)> take);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_IO_GZIP_FILE_H_
