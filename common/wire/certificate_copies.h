// Copies of certificate files that gRPC can watch safely.

#pragma once

#include "common/wire/security.h"

namespace craftfleet::wire {

// The paths of copies of `files` in this process' memory, of those files that are named. They follow the files within a
// second, but only to contents that are valid together: gRPC's own watcher (1.51) aborts the process if it finds an
// empty file, and refuses all connections while a certificate and its key do not fit. Other contents are logged. If the
// files are not valid now, or the system has no files in memory, these are `files` themselves.
//
// A copy lives as long as the process, since nobody knows until when gRPC reads it. Thread-safe.
TlsFiles CopiesInMemory(const TlsFiles& files);

}  // namespace craftfleet::wire
