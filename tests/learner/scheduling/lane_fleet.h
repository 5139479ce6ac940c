// A registry of lanes with its clock, for tests of the lane scheduler.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {

constexpr int kAll = 4096;  // a capacity that never limits
constexpr int64_t kVersion = 20;

// A registry with `lanes` new lanes, its clock, and short forms of its calls. An iteration of `fragments` is open.
class LaneFleet {
 public:
  explicit LaneFleet(int lanes, int64_t fragments = 1) : LaneFleet(std::vector<LaneRecord>(lanes), fragments) {}
  LaneFleet(const std::vector<LaneRecord>& records, int64_t last_fragment)
      : registry({static_cast<int>(records.size()), absl::Seconds(5)}, records, &clock) {
    registry.OpenIteration(last_fragment, kVersion);
  }

  TestRegistry::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = kAll) {
    const auto grant = registry.GetPermits(actor, active, capacity, absl::ZeroDuration());
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(TestRegistry::Grant());
  }
  // Joins and requests permits.
  std::vector<Permit> Enter(const std::string& actor, int capacity = kAll) {
    registry.Join(actor, "address of " + actor);
    return Ask(actor, {}, capacity).granted;
  }
  LaneScheduler::Verdict Push(const std::string& actor, const Permit& permit) {
    const auto verdict = registry.Accept(actor, permit, {"after " + std::to_string(permit.fragment), {1.5F}});
    EXPECT_THAT(verdict, IsOk());
    return verdict.value_or(LaneScheduler::Verdict::kExpired);
  }

  FakeClock clock;
  TestRegistry registry;
};

inline std::vector<int> Lanes(const std::vector<Permit>& permits) {
  std::vector<int> lanes;
  lanes.reserve(permits.size());
  for (const Permit& permit : permits) lanes.push_back(permit.lane);
  return lanes;
}

}  // namespace craftfleet
