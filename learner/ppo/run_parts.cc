#include "learner/ppo/run_parts.h"

#include <exception>
#include <vector>

#include <absl/strings/str_cat.h>

namespace craftfleet {

absl::Status RunParts(WorkerPool* workers, absl::string_view what, int count, const std::function<void(int)>& part) {
  std::vector<absl::Status> statuses(count);
  workers->Run(count, [&](int i) {
    try {
      part(i);
    } catch (const std::exception& error) {  // of LibTorch, or out of memory
      statuses[i] = absl::InternalError(absl::StrCat(what, ": ", error.what()));
    }
  });
  absl::Status status;
  for (const absl::Status& of_part : statuses) status.Update(of_part);
  return status;
}

}  // namespace craftfleet
