// Files and folders with absl::Status instead of errno and exceptions. Every message names the path.
// Codes: NotFound (no such file), ResourceExhausted (disk, quota or file size limit full), PermissionDenied, others as
// absl::ErrnoToStatus maps them.

#ifndef CRAFTFLEET_COMMON_FILES_H_
#define CRAFTFLEET_COMMON_FILES_H_

#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// "<what> <path>: <strerror>" with the code that fits `error_number`.
absl::Status FileError(int error_number, absl::string_view what, absl::string_view path);

// `folder`/`name`.
std::string JoinPath(absl::string_view folder, absl::string_view name);

bool PathExists(const std::string& path);

absl::StatusOr<std::string> ReadFile(const std::string& path);

// Writes all of `bytes` at the descriptor's position. `path` is for the message only.
absl::Status WriteAll(int descriptor, absl::string_view bytes, absl::string_view path);

// Creates or truncates `path`, writes `bytes` and syncs the file, not its folder.
absl::Status WriteFileSynced(const std::string& path, absl::string_view bytes);

// Replaces `path` so that, whenever the machine stops, it holds the old bytes or the new ones. On failure the old stay.
absl::Status ReplaceFile(const std::string& path, absl::string_view bytes);

// Makes the names in `folder` durable.
absl::Status SyncFolder(const std::string& folder);

// Creates `path` and its parents; fine if it is there already.
absl::Status CreateFolders(const std::string& path);

// Renames and syncs the folder of `to`.
absl::Status RenameSynced(const std::string& from, const std::string& to);

// Removes `path` with all in it; fine if it is not there.
absl::Status RemoveAll(const std::string& path);

// Names (not paths) in `folder`, sorted.
absl::StatusOr<std::vector<std::string>> ListFolder(const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_FILES_H_
