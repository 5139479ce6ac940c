// How many things new worlds have, for each environment of the paper.
// Source: the CrafterOOD page, "Counts at reset".

#ifndef CRAFTFLEET_DEPLOY_ENVS_CENSUS_H_
#define CRAFTFLEET_DEPLOY_ENVS_CENSUS_H_

#include <array>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

enum CountedThing { kTrees, kCoal, kCows, kZombies, kSkeletons };
inline constexpr std::array<absl::string_view, 5> kCountedThings = {"tree", "coal", "cow", "zombie", "skeleton"};

using ObjectCounts = std::array<double, kCountedThings.size()>;  // per world, in the order above

// Mean over the first episodes of the worlds with seeds 0..`worlds`-1.
//   InvalidArgument: no such environment, or `worlds` outside 1..100000.
absl::StatusOr<ObjectCounts> CountObjects(const std::string& env, int worlds);

// An environment of the paper.
struct KnownEnv {
  std::string name;    // as --env takes it
  std::string what;    // for people
  ObjectCounts paper;  // what the paper says that its new worlds have
};

// Crafter, then the settings of numbers, the mixes of appearances, and no inventory: each name once.
std::vector<KnownEnv> KnownEnvs();

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_ENVS_CENSUS_H_
