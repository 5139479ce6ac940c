#include "learner/training/records/checkpoint_writer.h"

#include <utility>

#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {

CheckpointWriter::CheckpointWriter(int every_iterations, Parts parts)
    : every_iterations_(every_iterations), parts_(std::move(parts)), time_(parts_.clock->Now()) {}

absl::Status CheckpointWriter::Write() {
  CRAFTFLEET_ASSIGN_OR_RETURN(Checkpoint checkpoint, parts_.make());
  const int64_t iteration = checkpoint.state.iteration();
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->WriteCheckpoint(std::move(checkpoint)));
  written_ = iteration;
  const MutexLock lock(&mu_);
  time_ = parts_.clock->Now();
  return absl::OkStatus();
}

absl::Status CheckpointWriter::WriteUnlessWritten(int64_t iteration) {
  return written_ == iteration ? absl::OkStatus() : Write();
}

absl::Status CheckpointWriter::OnIteration(int64_t iteration) {
  if (!missed_ && iteration % every_iterations_ != 0) return absl::OkStatus();
  const absl::Status status = Write();
  missed_ = !status.ok();
  if (status.ok()) return status;
  CRAFTFLEET_RETURN_IF_ERROR(parts_.folder->CheckOwned());
  LogError("checkpoint of iteration %d: %s; training continues and tries again after the next iteration", iteration,
           status.message());
  return absl::OkStatus();
}

void CheckpointWriter::ServeRequests(int64_t iteration) {
  if (!parts_.requests->pending()) return;
  const absl::Status status = WriteUnlessWritten(iteration);
  if (status.ok()) {
    parts_.requests->Answer(iteration);
  } else {
    parts_.requests->Answer(status);
  }
}

absl::Status CheckpointWriter::WriteLast(int64_t iteration) {
  absl::Status status = WriteUnlessWritten(iteration);
  while (absl::IsResourceExhausted(status) || absl::IsPermissionDenied(status)) {
    const absl::string_view when = absl::IsResourceExhausted(status) ? "there is space" : "that is allowed";
    if (!parts_.disk->Wait(status, absl::StrCat("the last checkpoint will be written once ", when))) break;
    status = Write();
  }
  return status;
}

absl::Duration CheckpointWriter::age() const {
  const MutexLock lock(&mu_);
  return parts_.clock->Now() - time_;
}

}  // namespace craftfleet
