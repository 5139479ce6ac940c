// craftfleet envs: lists the environments and counts the objects in their worlds.

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "deploy/cli/command.h"
#include "envserver/world/world.h"

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

// The objects that are counted. Source: envserver/world/RULES.md, section 14.
enum CountedObject { kTrees, kCoal, kCows, kZombies, kSkeletons };
constexpr std::array<absl::string_view, 5> kCountedObjects = {"tree", "coal", "cow", "zombie", "skeleton"};

using ObjectCounts = std::array<double, kCountedObjects.size()>;  // per world, in the order above

// An environment of the paper.
struct KnownEnv {
  std::string name;    // a value of --env
  std::string what;    // its description
  ObjectCounts paper;  // the counts that the paper gives for its new worlds
};

constexpr ObjectCounts kOrdinary = {189, 50, 26, 15, 9.5};

void AddObjects(const World& world, ObjectCounts* counts) {
  const WorldOptions& options = world.options();
  for (int x = 0; x < options.width; ++x) {
    for (int y = 0; y < options.height; ++y) {
      const Material material = world.material({x, y});
      if (material == Material::kTree) ++(*counts)[kTrees];
      if (material == Material::kCoal) ++(*counts)[kCoal];
    }
  }
  for (const Object& object : world.objects()) {
    if (object.type == ObjectType::kCow) ++(*counts)[kCows];
    if (object.type == ObjectType::kZombie) ++(*counts)[kZombies];
    if (object.type == ObjectType::kSkeleton) ++(*counts)[kSkeletons];
  }
}

// Mean over the first episodes of the worlds with seeds 0..`worlds`-1.
absl::StatusOr<ObjectCounts> CountObjects(const std::string& env, int worlds) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(env));
  ObjectCounts counts{};
  for (int seed = 0; seed < worlds; ++seed) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const World world, World::Create(WorldOptions::FromEnvName(name), seed));
    AddObjects(world, &counts);
  }
  for (double& count : counts) count /= worlds;
  return counts;
}

// Crafter, the variants of numbers, the mixes of appearances, and the variant without inventory.
std::vector<KnownEnv> KnownEnvs() {
  std::vector<KnownEnv> envs = {
      {"crafter", "Crafter", kOrdinary},
      {"crafter:numbers=easy-x2", "twice the resources, half the enemies", {380, 102, 46, 6, 4.5}},
      {"crafter:numbers=easy-x4", "four times the resources, a quarter of the enemies", {764, 206, 100, 3, 2.5}},
      {"crafter:numbers=mix", "four times everything (the paper's mix x4)", {764, 206, 100, 60, 38}},
      {"crafter:numbers=hard-x2", "half the resources, twice the enemies", {95, 27, 13, 33, 19}},
      {"crafter:numbers=hard-x4", "a quarter of the resources, four times the enemies", {52, 12.5, 6, 60, 38}},
  };
  for (const char* mix : {"100/0/0/0", "25/25/25/25", "52/16/16/16", "76/8/8/8", "88/4/4/4", "94/2/2/2", "97/1/1/1"}) {
    envs.push_back({absl::StrCat("crafter:appearance=", mix), "to train on", kOrdinary});
  }
  envs.push_back({"crafter:appearance=0/33/33/34", "to evaluate on: looks that a mix had rarely or never", kOrdinary});
  envs.push_back({"crafter:inventory=off", "the picture lacks the inventory", kOrdinary});
  return envs;
}

absl::Status Run() {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("worlds", absl::GetFlag(FLAGS_worlds), 1, 100'000));
  absl::PrintF("%-32s", "environment");
  for (const absl::string_view object : kCountedObjects) absl::PrintF(" %13s", object);
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
