// The lanes: where each stands, who holds it and who plays it.

#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "learner/scheduling/shared_snapshot.h"
#include "learner/scheduling/worker.h"

namespace craftfleet {

// A lane after its last accepted fragment. Checkpoints store all of it except the sender.
struct LaneRecord {
  int64_t next_fragment = 0;
  SharedSnapshot snapshot;       // the state before that fragment
  SharedSnapshot previous = {};  // the state before the last one; used if no server can restore `snapshot`
  std::string sender = "";       // the actor that sent the last fragment; empty: unknown, of an earlier start
};

// An actor as the lanes know it.
struct LaneActor {
  const Worker* worker = nullptr;
  int capacity = 0;                            // lanes that it can play at once, as last reported
  std::set<int> lanes;                         // that it holds
  std::set<int> permits;                       // lanes for which it has one
  int64_t fragments = 0;                       // accepted
  absl::Time returned = absl::InfinitePast();  // when it last returned permits
  absl::Duration pause;  // length of the current or last pause for being late; 0: it has finished a fragment since
  absl::Time pause_end = absl::InfinitePast();
  int held() const { return static_cast<int>(lanes.size()); }
};

struct LaneState {
  // An actor that has the permit.
  struct Player {
    LaneActor* actor = nullptr;
    absl::Time since;  // when it got it
  };
  struct AcceptedFragment {
    int64_t fragment = 0;
    int64_t policy_version = 0;  // that it was played with
    uint64_t digest = 0;
    std::string sender;
    bool differs = false;  // a duplicate with other content was logged
  };
  // That the snapshot can't be restored.
  struct Report {
    std::string client;  // WorkerClient::Name of the actor that reported it
    std::string actor;
    absl::Time time;
  };

  int number = 0;
  LaneRecord record;
  LaneRecord start;                       // at the beginning of the current iteration
  LaneRecord earlier_start;               // at the beginning of the one before
  LaneActor* holder = nullptr;            // the actor with its game, if any
  std::optional<Permit> permit;           // the outstanding one
  std::vector<Player> players;            // who have it, in the order of their grants; the first is `holder`
  absl::Time since;                       // when the permit was last granted, or the lane became free
  std::string avoided;                    // the actor that failed to play it last
  absl::Time avoided_until;               // others are preferred until then
  std::optional<Report> report;           // the first one on its current snapshot
  int64_t reset_at = -1;                  // fragment before which it was reset; games that actors hold there are void
  std::deque<AcceptedFragment> accepted;  // of the current iteration and the previous one
  int64_t last_fragment = 0;              // permits are for fragments before this one

  bool IsOpen() const { return !permit.has_value() && record.next_fragment < last_fragment; }
  bool IsPlayedBy(const LaneActor& actor) const;
};

// What happened to lanes since the start, for status pages.
struct LaneCounters {
  int64_t lapsed = 0;     // permits that lapsed, or whose overdue fragments others finished
  int64_t resets = 0;     // of lanes because of invalid snapshots, also while loading
  int64_t differing = 0;  // duplicates that differ from the accepted fragment
  int64_t dropped = 0;    // fragments that were too old
};

// The lanes, their permits and their actors. It keeps these consistent and decides nothing: which actor gets a lane is
// up to Assignment, which fragments may be played to RolloutCutter. Not thread-safe.
class LaneTable {
 public:
  // An actor's permits and progress.
  struct ActorInfo {
    int permits = 0;
    int64_t fragments = 0;  // number of accepted fragments
    bool late = false;      // others finished its fragments, and it has finished none since
  };
  // A fragment that is being played, and by whom.
  struct Playing {
    Permit permit;
    std::vector<std::pair<std::string, absl::Duration>> actors;  // with the time since they got it
  };
  // Which actors may get permits that they could not get at the last call.
  struct Change {
    bool all = false;
    std::vector<std::string> actors = {};  // if not all
  };
  using ActorMap = std::map<std::string, LaneActor, std::less<>>;  // by name

  // `clock` outlives the table.
  LaneTable(std::vector<LaneRecord> records, Clock* clock);

  int size() const { return static_cast<int>(lanes_.size()); }
  std::vector<LaneState>& lanes() { return lanes_; }
  const std::vector<LaneState>& lanes() const { return lanes_; }
  const ActorMap& actors() const { return actors_; }
  // Null: no such actor.
  LaneActor* Find(absl::string_view actor);
  const LaneActor* Find(absl::string_view actor) const;
  // Adds the actor `worker`, which is referenced until it is removed; or returns the one of its name.
  LaneActor* Add(const Worker* worker);
  // Removes an actor and frees its lanes and permits.
  void Remove(LaneActor* actor);
  void SetCapacity(LaneActor* actor, int capacity);
  // Something has changed that the actor's share depends on.
  void NoteShares() { ++shares_; }
  // A number that changes when actors, what they can play or what they hold has changed.
  int64_t shares() const { return shares_; }

  // Gives the lane, which is open, to `actor` with a permit.
  Permit Grant(LaneActor* actor, int64_t policy_version, LaneState* lane);
  // Grants the lane's permit to one more actor.
  Permit AddPlayer(LaneActor* actor, LaneState* lane);
  // Revokes the lane's permit from `actor`, if it has it; other players continue.
  void Revoke(LaneActor* actor, LaneState* lane);
  // Ends the lane's permit for all players.
  void EndPermit(LaneState* lane);
  // `actor`: null: nobody.
  void SetHolder(LaneActor* actor, LaneState* lane);

  // Counts and logs a duplicate that differs from the accepted fragment, although it was played with the same weights.
  void Compare(absl::string_view actor, const Permit& fragment, uint64_t digest);
  // The fragment that the lane was at was played with `policy_version` and is over; `snapshot` is after it.
  void Advance(int64_t policy_version, const SharedSnapshot& snapshot, uint64_t digest, const std::string& sender,
               LaneState* lane);
  // Rolls the lane back to the beginning of the iteration.
  void Rewind(LaneState* lane);

  // Whether that fragment, of this or the previous iteration, was accepted and has not been rolled back since.
  bool Counts(int lane, int64_t fragment, uint64_t digest) const;
  // Whether the fragment, of this or the previous iteration, was accepted from `actor`.
  bool IsAcceptedFrom(absl::string_view actor, const Permit& fragment) const;
  // The state before `fragment` of `lane`.   Aborted: the lane is at another fragment.   InvalidArgument: no such lane.
  absl::StatusOr<LaneSnapshot> Snapshot(int lane, int64_t fragment) const;
  // The lanes now; or, with &LaneState::start, at the beginning of the iteration.
  std::vector<LaneRecord> Records(LaneRecord LaneState::*when = &LaneState::record) const;
  // Information about an actor of the table.
  ActorInfo InfoOf(absl::string_view actor) const;
  // The number of lanes that are being played: that have a permit.
  int playing() const;
  // The fragments that are being played, the oldest first.
  std::vector<Playing> BeingPlayed() const;

  LaneCounters counters;

  // Any actor may get permits now; or `actor` only.
  void NoteChange() { change_.all = true; }
  void NoteChange(const std::string& actor) { change_.actors.push_back(actor); }
  Change TakeChange() { return std::exchange(change_, {}); }

 private:
  Clock* const clock_;
  std::vector<LaneState> lanes_;
  ActorMap actors_;
  int64_t shares_ = 0;
  Change change_;
};

}  // namespace craftfleet
