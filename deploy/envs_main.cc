// craftfleet envs: lists the environments and counts what their worlds have.

#include <cstdint>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>

#include "common/program.h"
#include "common/status_macros.h"
#include "deploy/envs/census.h"

ABSL_FLAG(int32_t, worlds, 300, "new worlds to count in, seeds 0, 1, 2, ...; 1..100000");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet envs";
constexpr char kUsage[] =
    R"(craftfleet envs lists the environments of the paper, as --env and --eval_env name them, and counts the objects of new worlds:
the mean over --worlds of them, and in brackets what the paper says.

  craftfleet envs
  craftfleet train --env=crafter:numbers=easy-x2 --eval_env=crafter --logdir=runs/easy)";

constexpr char kNotes[] = R"(
Options are joined by commas, crafter:numbers=easy-x2,inventory=off. Numbers may also be five letters for tree, coal, cow,
zombie and skeleton: q a quarter, h half, s ordinary, d double, f four times. Appearances are how often each of the four
variants is drawn, in percent; the counts above differ a little from Crafter's because drawing a variant takes a random
number. Numbers concern new worlds only: later, creatures come and go as in Crafter, so that enemies are back at ordinary
numbers within some hundred steps.

hard-x4 has 89 zombies, not the paper's 60: zombies come on grass, and with a quarter of the trees there is more of it.
Four times the zombies among four times the trees (mix) are the 60 that the paper says. The published environment gives 89 too.
)";

absl::Status Run() {
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

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
