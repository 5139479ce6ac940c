// Parts of a computation with LibTorch, on all workers.

#pragma once

#include <functional>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/base/worker_pool.h"

namespace craftfleet {

// Calls part(i) for each i of 0..count-1 on the workers, and returns when all have returned.
//   Internal: LibTorch failed, or memory ran out, in one of them; the message begins with `what`.
absl::Status RunParts(WorkerPool* workers, absl::string_view what, int count, const std::function<void(int)>& part);

}  // namespace craftfleet
