#include "deploy/cli/envs/census.h"

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "envserver/world/world.h"

namespace craftfleet {
namespace {

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

}  // namespace

absl::StatusOr<ObjectCounts> CountObjects(const std::string& env, int worlds) {
  if (worlds < 1 || worlds > 100'000) {
    return absl::InvalidArgumentError(absl::StrCat("worlds is ", worlds, ", want 1..100000"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(env));
  ObjectCounts counts{};
  for (int seed = 0; seed < worlds; ++seed) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const World world, World::Create(WorldOptions::FromEnvName(name), seed));
    AddObjects(world, &counts);
  }
  for (double& count : counts) count /= worlds;
  return counts;
}

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

}  // namespace craftfleet
