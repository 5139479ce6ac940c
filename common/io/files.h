// Files and folders with absl::Status instead of errno and exceptions. Every message names the path.
// Codes: NotFound (no such file), ResourceExhausted (disk, quota or file size limit full), PermissionDenied, others as
// absl::ErrnoToStatus maps them.

#pragma once

#include <cstdint>
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

// Bytes in the file.
absl::StatusOr<int64_t> FileSize(const std::string& path);

// Writes all of `bytes` at the descriptor's position. `path` is for the message only.
absl::Status WriteAll(int descriptor, absl::string_view bytes, absl::string_view path);

// fsync(2); 0 also where the file system cannot do it for this kind of file, as FUSE and some NFS for folders.
int SyncDescriptor(int descriptor);

// Creates or truncates `path`, writes `bytes` and syncs the file, not its folder. After an error the content is
// undefined, even if a later sync succeeds: call it again with all the bytes, or remove the file.
absl::Status WriteFileSynced(const std::string& path, absl::string_view bytes);

// Creates an empty file in the folder of `path`, under a name with this `ending` that no file had. Returns its path.
absl::StatusOr<std::string> CreateBeside(const std::string& path, absl::string_view ending = ".tmp");

// Replaces `path` atomically: after a crash it holds the old bytes or the new ones. Keeps the file's mode. On failure
// the old bytes stay, unless the sync of the folder failed: then the new ones are in place but may not survive a crash.
absl::Status ReplaceFile(const std::string& path, absl::string_view bytes);

// Removes the files that ReplaceFile was writing in `folder` when its process was killed.
absl::Status RemoveUnfinished(const std::string& folder);

// Makes the names in `folder` durable, if the folder may be read.
absl::Status SyncFolder(const std::string& folder);

// Creates `path` and its parents. OK if it exists already.
absl::Status CreateFolders(const std::string& path);

// Renames and syncs the folder of `to`. If the sync fails the new name exists, but may not survive a crash.
absl::Status RenameSynced(const std::string& from, const std::string& to);

// Removes `path` and its contents, also if another process is still adding files there. OK if it does not exist.
absl::Status RemoveAll(const std::string& path);

// Names (not paths) in `folder`, sorted.
absl::StatusOr<std::vector<std::string>> ListFolder(const std::string& folder);

}  // namespace craftfleet
