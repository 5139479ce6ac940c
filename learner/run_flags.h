// Flags of a training run, shared by craftfleet-learner and craftfleet train.

#pragma once

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"
#include "learner/learner.h"

namespace craftfleet {

// The help of flags that other programs have, too.
inline constexpr char kRunEnvHelp[] =
    "environment to train on: crafter, or a variant of it (craftfleet envs lists them)\n"
    "such as crafter:numbers=easy-x2,appearance=25/25/25/25,inventory=off\n"
    "[crafter]";
inline constexpr char kRunSeedHelp[] = "seed of everything random in the run [0]";

// Makes the learner's options from the flags. The configuration starts from the defaults, or with --resume from the
// stored one; --config overrides it, and other given flags override both. The caller sets the server's address.
// Progress goes to standard output. `on_gpu` is what a new run with --device=cuda computes on GPUs. Prepares LibTorch
// for the device. `page_by_default` is the address of the live page without a flag, unless the server has TLS.
//   InvalidArgument names the flag, or the file and line.   FailedPrecondition: there is no such device, or the run is
//   of another.   With --autoresume others as FindCheckpoint but NotFound, which is a new run.
absl::StatusOr<Learner::Options> LearnerOptionsFromFlags(v1::RunConfig::Device on_gpu,
                                                         absl::string_view page_by_default);

// --threads, or by default as many as the cgroup's CPU quota allows.   InvalidArgument: out of range.
absl::StatusOr<int> ThreadsFromFlags();

// For one of several learners.   InvalidArgument: --device names a GPU.
absl::Status CheckRankDevice();

// For a rank from 1 on, whose `config` is rank 0's.
//   InvalidArgument: the flags of this process ask for another configuration; names the fields.
absl::Status CheckSameAsFlags(const v1::RunConfig& config);

}  // namespace craftfleet
