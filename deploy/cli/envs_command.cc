// craftfleet envs: lists the environments and counts the objects in their worlds.

#include <cstdint>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/process/flag_check.h"
#include "common/process/program.h"
#include "deploy/cli/command.h"
#include "deploy/cli/envs/census.h"

ABSL_FLAG(int32_t, worlds, 300, "number of new worlds to count objects in, with the seeds 0, 1, 2, ...; 1..100000");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet envs";
constexpr char kUsage[] =
    R"(craftfleet envs lists the paper's environments with their names for --env and --eval_env, the mean number of objects in
new worlds, and the paper's number in brackets.

  craftfleet envs
  craftfleet train --env=crafter:numbers=easy-x2 --eval_env=crafter --logdir=runs/easy)";

constexpr char kNotes[] = R"(
Join options by commas, as in crafter:numbers=easy-x2,inventory=off. Numbers may also be five letters for tree, coal, cow,
zombie and skeleton: q a quarter, h half, s ordinary, d double, f four times. An appearance gives the probability of each of
the four variants in percent; its counts differ slightly from Crafter's, because drawing a variant consumes a random number.
Numbers apply to new worlds only. Later, creatures appear and vanish as in Crafter, so that enemies return to their ordinary
numbers within a few hundred steps.

hard-x4 has 89 zombies, not the paper's 60: zombies appear on grass, and with a quarter of the trees there is more grass.
With four times the trees (mix), four times the zombies are the paper's 60. The published environment also has 89.
)";

absl::Status Run() {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("worlds", absl::GetFlag(FLAGS_worlds), 1, kMaxCountedWorlds));
  absl::PrintF("%-32s", "environment");
  for (const absl::string_view thing : kCountedThings) absl::PrintF(" %13s", thing);
  absl::PrintF("\n");
  for (const KnownEnv& env : KnownEnvs()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const ObjectCounts counts, CountObjects(env.name, absl::GetFlag(FLAGS_worlds)));
    absl::PrintF("%-32s", env.name);
    for (size_t i = 0; i < counts.size(); ++i) {
      absl::PrintF(" %13s", absl::StrFormat("%.1f (%g)", counts[i], env.paper[i]));
    }
    absl::PrintF("   %s\n", env.what);
  }
  absl::PrintF("%s", kNotes);
  return absl::OkStatus();
}

int RunEnvs(int argc, char** argv) {
  ParseFlags({kProgram, kUsage, {"worlds"}, {}}, argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("envs", &RunEnvs);

}  // namespace
}  // namespace craftfleet
