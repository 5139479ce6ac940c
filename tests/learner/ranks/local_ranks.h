// A group of ranks on threads of this process, connected over loopback.

#pragma once

#include <functional>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "learner/ranks/rank_group.h"
#include "learner/ranks/rank_meeting.h"
#include "tests/fakes/loopback.h"

namespace craftfleet {

inline RankOptions LocalRank(int rank, int world_size, int port) {
  RankOptions options;
  options.rank = rank;
  options.world_size = world_size;
  options.master_port = port;
  options.timeout = absl::Seconds(60);
  return options;
}

// Calls `run(rank)` for each rank, on a thread each, and waits for all.
inline void OnRanks(int world_size, const std::function<void(int)>& run) {
  std::vector<std::thread> threads;
  threads.reserve(world_size);
  for (int rank = 0; rank < world_size; ++rank) threads.emplace_back(run, rank);
  for (std::thread& thread : threads) thread.join();
}

// Makes a group of `world_size` ranks and calls `run` for each, on a thread each.
inline void InGroup(int world_size, const std::function<void(RankGroup*)>& run) {
  const int port = FreePort();
  std::vector<std::unique_ptr<RankGroup>> groups(world_size);
  OnRanks(world_size, [&](int rank) {
    const auto meeting = RankMeeting::Open(LocalRank(rank, world_size, port), "");
    ASSERT_TRUE(meeting.ok()) << meeting.status();
    auto links = (*meeting)->Connect({"canary", "build"});
    ASSERT_TRUE(links.ok()) << links.status();
    groups[rank] = std::make_unique<RankGroup>(*std::move(links));
    run(groups[rank].get());
  });
}

}  // namespace craftfleet
