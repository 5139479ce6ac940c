// A lane's snapshot that many records share.

#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/base/types.h"

namespace craftfleet {

// A lane's records and those of checkpoints contain the same snapshots of some 12 KB. Copies take a pointer's space and
// time, for which thousands of lanes are copied with a lock held. The content never changes. Copies may be used by
// different threads.
class SharedSnapshot {
 public:
  SharedSnapshot() = default;
  SharedSnapshot(LaneSnapshot snapshot)  // NOLINT(google-explicit-constructor): it is one
      : snapshot_(std::make_shared<const LaneSnapshot>(std::move(snapshot))) {}
  SharedSnapshot(std::string game, std::vector<float> state)
      : SharedSnapshot(LaneSnapshot{std::move(game), std::move(state)}) {}

  const LaneSnapshot& operator*() const {
    static const LaneSnapshot empty;
    return snapshot_ == nullptr ? empty : *snapshot_;
  }
  const LaneSnapshot* operator->() const { return &**this; }
  friend bool operator==(const SharedSnapshot& a, const SharedSnapshot& b) { return *a == *b; }

 private:
  std::shared_ptr<const LaneSnapshot> snapshot_;  // null: an empty one
};

}  // namespace craftfleet
