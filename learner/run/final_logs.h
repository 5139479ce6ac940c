// The logs of the final evaluation in a run that was extended after its end.
//
// final_argmax.jsonl and final_sampled.jsonl contain one final evaluation: that of the run's last weights. When a
// finished run of, say, 4096 steps trains further, they are renamed to final_argmax-4096.jsonl and
// final_sampled-4096.jsonl. They are renamed back when the run returns to the checkpoint that they belong to.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/checkpoint.pb.h"

namespace craftfleet {

// The path of the log `name` (such as "final_argmax.jsonl") that belongs to `state`: set aside, or under its own name.
// Logs other than those of the final evaluation are always under their own names.
std::string FindFinalLog(const std::string& logdir, absl::string_view name, const v1::CheckpointState& state);

// Makes the logs match `state`, from which the run resumes: renames back logs set aside since then, and removes logs
// set aside after more steps than `state` has. Idempotent.
absl::Status RestoreFinalLogs(const std::string& logdir, const v1::CheckpointState& state);

// Sets aside the logs of `state`, from which a finished run trains further. Sets their lengths in `state` to 0.
absl::Status SetFinalLogsAside(const std::string& logdir, v1::CheckpointState* state);

}  // namespace craftfleet
