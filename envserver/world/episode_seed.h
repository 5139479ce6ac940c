// The seed of an episode's random stream. Source: RULES.md, section 2.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_EPISODE_SEED_H_
#define CRAFTFLEET_ENVSERVER_WORLD_EPISODE_SEED_H_

#include <cstdint>

namespace craftfleet {

// CPython's hash((seed, episode)) modulo 2^31 - 1: 0..2^31-2.
uint32_t EpisodeSeed(int64_t seed, int64_t episode);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_EPISODE_SEED_H_
