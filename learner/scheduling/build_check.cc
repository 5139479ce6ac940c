#include "learner/scheduling/build_check.h"

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kComputes =
    "run the same build with the same libraries everywhere; if CPUs differ, start the run with --cpu=avx2 and in FP32";
constexpr absl::string_view kPlays = "run the same build everywhere";
constexpr size_t kMaxShown = 64;  // bytes of a worker's text; a canary has 16

// `text` from a worker, for logs and status pages.
std::string Shown(absl::string_view text, absl::string_view nothing) {
  return text.empty() ? std::string(nothing) : absl::CHexEscape(text.substr(0, kMaxShown));
}

}  // namespace

absl::Status BuildCheck::Check(const WorkerBuild& build, absl::Time now, Worker* worker) {
  worker->mismatch.reset();
  const bool is_actor = worker->role == WorkerRole::kActor;
  const std::string& want = is_actor ? options_.policy_canary : options_.game_canary;
  if (want.empty() || build.canary == want) return absl::OkStatus();

  ++differing_;
  const std::string shown_build = Shown(build.build, "older than this one");
  worker->mismatch = {shown_build, now};
  const std::string does =
      is_actor ? absl::StrCat("computes different results from this learner, on \"", Shown(build.cpu, "?"), "\"")
               : "plays another game";
  const std::string text =
      absl::StrFormat("%s %s (build %s) %s (build %s): its canary is %s", is_actor ? "actor" : "environment server",
                      worker->name, shown_build, does, options_.build, Shown(build.canary, "none"));
  if (!options_.allow_mixed) {
    return absl::FailedPreconditionError(
        absl::StrCat(text, ". ", is_actor ? kComputes : kPlays, "; with --allow_mixed the learner accepts it"));
  }
  if (warned_ != shown_build)
    LogWarning("%s; accepted because of --allow_mixed: the result depends on which workers play", text);
  warned_ = shown_build;
  return absl::OkStatus();
}

}  // namespace craftfleet
