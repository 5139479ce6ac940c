// Which actor gets the next fragment.

#pragma once

#include <cstdint>
#include <vector>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "learner/scheduling/lane_table.h"
#include "learner/scheduling/overdue.h"

namespace craftfleet {

// An actor gets its fair share of the lanes: first those that it played before (it holds their games), then lanes
// without a holder or whose holder has more than its share, and finally any lane that has been unclaimed for
// `kPatience`. Shares differ by at most one lane, except for actors that can't play that many. While there are other
// actors, an actor that returns permits because it can't play them gets no new ones for as long.
//
// A fragment that is overdue (Overdue) since it was last granted is also granted to an actor without work, whatever its
// players report: at first only to one of another client, after one more `kPatience` to any. All players produce the
// same bytes, and the first result counts; the others are told that they have lost the permit. A player that was
// overdue then gets no permits for 1 s, doubling up to 5 min, and after that one at a time until a fragment of its is
// accepted.
//
// Not thread-safe.
class Assignment {
 public:
  static constexpr absl::Duration kPatience = absl::Seconds(1);

  // For `avoidance` others are preferred to an actor that could not play a lane. `is_asynchronous`: no actor without
  // work waits for the others. The pointers outlive it.
  Assignment(absl::Duration avoidance, bool is_asynchronous, LaneTable* table, Clock* clock)
      : avoidance_(avoidance), is_asynchronous_(is_asynchronous), table_(table), clock_(clock) {}

  // New permits for `actor` with `policy_version`, up to its capacity and its share, and at most `ahead`.
  std::vector<Permit> Grant(int64_t policy_version, int64_t ahead, LaneActor* actor);
  // `sender` has played the lane's fragment, which ends its permit and leaves the lane to it.
  void OnPlayed(LaneActor* sender, LaneState* lane);
  // `actor` can't play the lane: revokes its permit and prefers others.
  void GiveToOthers(LaneActor* actor, LaneState* lane);
  // While paused, nothing is granted; outstanding permits remain valid. Returns whether it was paused before.
  bool SetPaused(bool paused);
  bool paused() const { return paused_; }

  // Whether an actor other than this could play now; or one of another client.
  bool HasOthers(const LaneActor& actor) const;
  bool HasOtherClients(const LaneActor& actor) const;
  // Whether others may take lanes from the actor, since it holds more than its share.
  bool IsOverShare(const LaneActor& actor) { return FairShares().IsOver(actor); }

 private:
  // Each actor may hold `all` lanes, if it can play that many, and `extra` actors one more.
  struct Shares {
    int all = 0;
    int extra = 0;
    int above = 0;  // number of actors that hold more than `all`
    int Most() const { return all + (extra > 0 ? 1 : 0); }
    bool IsOver(const LaneActor& actor) const {
      return actor.held() > all + 1 || (actor.held() > all && above > extra);
    }
    int Of(const LaneActor& actor) const { return all + (above - (actor.held() > all ? 1 : 0) < extra ? 1 : 0); }
  };
  // The reason for which an actor may get a lane, strongest first.
  enum class Claim { kOwn, kSpare, kUnclaimed, kNone };

  // The number of lanes that the actor may currently play at once.
  static int CapacityOf(const LaneActor& actor);
  bool CanPlay(const LaneActor& actor) const;
  bool HasJustReturned(const LaneActor& actor) const;
  bool IsAvoided(const LaneState& lane, const LaneActor& actor, absl::Time now) const;
  Claim ClaimOn(const LaneState& lane, const LaneActor& actor, const Shares& shares, absl::Time now) const;
  const Shares& FairShares();
  // Grants overdue fragments of other actors to `actor`, which has no work.
  std::vector<Permit> GrantOverdue(LaneActor* actor);
  // Whether `actor` should get an overdue lane before others do.
  bool IsPreferred(const LaneState& lane, const LaneActor& actor) const;
  // Pauses those players of the lane for which its fragment was overdue when `sender` finished it.
  void PauseLate(const LaneState& lane, const LaneActor& sender);

  const absl::Duration avoidance_;
  const bool is_asynchronous_;
  LaneTable* const table_;
  Clock* const clock_;
  Overdue overdue_{/*least=*/absl::Seconds(3), /*at_first=*/absl::Seconds(20)};
  Shares shares_;
  int64_t shares_of_ = -1;  // LaneTable::shares() for which `shares_` are
  bool paused_ = false;
};

}  // namespace craftfleet
