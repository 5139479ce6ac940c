// Counts the objects in new worlds of each environment of the paper.
// Source: envserver/world/RULES.md, section 14.

#ifndef CRAFTFLEET_DEPLOY_CLI_ENVS_CENSUS_H_
#define CRAFTFLEET_DEPLOY_CLI_ENVS_CENSUS_H_

#include <array>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

enum CountedThing { kTrees, kCoal, kCows, kZombies, kSkeletons };
inline constexpr std::array<absl::string_view, 5> kCountedThings = {"tree", "coal", "cow", "zombie", "skeleton"};

using ObjectCounts = std::array<double, kCountedThings.size()>;  // per world, in the order above

inline constexpr int kMaxCountedWorlds = 100'000;

// Mean over the first episodes of the worlds with seeds 0..`worlds`-1.
//   InvalidArgument: no such environment, or `worlds` outside 1..kMaxCountedWorlds.
absl::StatusOr<ObjectCounts> CountObjects(const std::string& env, int worlds);

// An environment of the paper.
struct KnownEnv {
  std::string name;    // a value of --env
  std::string what;    // its description
  ObjectCounts paper;  // the counts that the paper gives for its new worlds
};

// Crafter, the variants of numbers, the mixes of appearances, and the variant without inventory: each name once.
std::vector<KnownEnv> KnownEnvs();

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_ENVS_CENSUS_H_
