// Decides which actor plays which lane: permits and shares.

#ifndef CRAFTFLEET_LEARNER_SCHEDULING_LANE_SCHEDULER_H_
#define CRAFTFLEET_LEARNER_SCHEDULING_LANE_SCHEDULER_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "common/telemetry/limited_log.h"
#include "learner/scheduling/overdue.h"
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

// Decides which actor plays which lane. It has no lock and never waits. WorkerRegistry calls it under
// its mutex, tells it which actors are active, and wakes waiting calls when TakeChange returns true.
//
// Permits are synchronous by default: within an iteration, each lane gets one permit after the other, all with the
// iteration's weights. With `Options::max_staleness` a lane gets its next permit as soon as its last fragment is in,
// with the newest weights. TakeRollout cuts the fragments, in the order in which they were accepted, into rollouts for
// one update after the other; it is thus known when a fragment arrives which update would learn from it. A fragment
// that would then be more than max_staleness versions old is dropped and counted, and its lane plays it again. Permits
// run ahead only as far as drops are impossible if fragments arrive in the order of their permits: max_staleness
// rollouts beyond that of the newest weights.
//
// An actor gets its fair share of the lanes: first those that it played before (it holds their games), then
// lanes without a holder or whose holder has more than its share, and finally any lane that has been unclaimed for
// `Options::patience`. Shares differ by at most one lane, except for actors that can't play that many. While there are
// other actors, an actor that returns permits because it can't play them gets no new ones for `patience`.
//
// A permit lapses when its actor has sent no request for its lease, or for twice as long if no other actor sends
// requests; the actor is then removed. A fragment is accepted at most once.
//
// A fragment that is overdue (Overdue) since it was last granted is also granted to an actor without work, whatever its
// players report: at first only to one of another client, after one more `patience` to any. All players produce the
// same bytes, and the first result counts; the others are told that they have lost the permit. A player that was
// overdue then gets no permits for 1 s, doubling up to 5 min, and after that one at a time until a fragment of its is
// accepted.
//
// A lane whose snapshot can't be restored is reset. If it has advanced in this iteration, it is reset to the beginning
// of the iteration, so that the result does not change; otherwise to its previous snapshot, or to a new game if it has
// none. Permit::reload is set in the permit for the first fragment after a reset to another game.
//
// Since a reset can change the result, one lying client must not cause it, whatever names its actors have. A client is
// what can be told apart: a certificate or token or, without them, a host (WorkerClient). The first report that a
// snapshot can't be restored only moves the lane to an actor of another client, which either plays the fragment, and
// the report is forgotten, or confirms the report. Where all actors that can play are of one client, as in a fleet with
// one token, another actor of that client confirms it; a single actor confirms its own report, as there is nobody else
// to ask. Actors that get the lane to confirm a report, but neither play it nor report, must not keep a lane broken:
// after three of them, the next report confirms.
//
// Most requests change nothing. So none looks at all actors: shares are computed when something has changed, and lapsed
// leases are looked for when the first one may have lapsed.
//
// Not thread-safe.
class LaneScheduler {
 public:
  struct Options {
    int lanes = 16;                           // 1..
    absl::Duration lease = absl::Seconds(5);  // that actors have at least (Worker::lease)
    absl::Duration patience = absl::Seconds(1);
    absl::Duration comeback = absl::Seconds(2);  // lease left to an actor whose connection broke; at most `lease`
    absl::Duration overdue = absl::Seconds(3);   // no fragment is overdue earlier,
    absl::Duration overdue_at_first = absl::Seconds(20);  // or this early if none has been accepted yet
    int resets = 0;                                       // initial value of resets(): lanes reset while loading
    // Asynchronous play: most versions between the weights of a fragment and those from which the update with it
    // starts; 0: play is synchronous.
    int max_staleness = 0;
    int64_t rollout_fragments = 1;  // of an update; only with max_staleness
  };
  enum class Verdict { kAccepted, kDuplicate, kExpired, kStale };
  // An actor's permits and progress.
  struct ActorInfo {
    std::string name;
    std::string address;
    int permits = 0;
    int64_t fragments = 0;  // number of accepted fragments
    absl::Duration idle;    // since its last request
    bool draining = false;
    bool late = false;  // others finished its fragments, and it has finished none since
  };
  // A fragment that is being played, and by whom.
  struct Playing {
    Permit permit;
    std::vector<std::pair<std::string, absl::Duration>> actors;  // with the time since they got it
  };

  // `clock` outlives the scheduler.
  LaneScheduler(const Options& options, std::vector<LaneRecord> lanes, Clock* clock);

  // Adds the actor `worker`, which may get permits from now on. Until Remove, it is referenced and its fields are read.
  void Add(const Worker* worker);
  // Removes `actor` and frees its permits; ignored if unknown.
  void Remove(absl::string_view actor);
  // Removes actors whose lease has expired; returns their names.
  std::vector<std::string> RemoveExpired();
  // `actor` is being drained, which releases the lanes that it holds without a permit, or no longer so.
  void NoteDrain(absl::string_view actor);
  // The lease of `worker`, which was added, now ends earlier than before.
  void NoteLease(const Worker& worker);

  // Updates `actor`, which is known: it can play `capacity` lanes at once and reports the permits `active`. Frees its
  // other permits. Returns those of `active` that it has lost.
  std::vector<Permit> Renew(absl::string_view actor, absl::Span<const Permit> active, int capacity);
  // Grants new permits to `actor`, which is known, up to its capacity.
  std::vector<Permit> Grant(absl::string_view actor);

  // `actor` returns the permit for `fragment` of `lane`, since no environment server can restore the snapshot before
  // it; `reason` is logged. Ignored unless the actor has that permit.
  void Refuse(absl::string_view actor, int lane, int64_t fragment, absl::string_view reason);

  // Decides on a fragment and, if it is accepted, advances its lane by one fragment and copies `snapshot`.
  // `digest` is that of its content (FragmentDigest): a duplicate that differs from the accepted one is logged as an
  // error and counted.
  //   InvalidArgument: the version of the weights is not the permit's.
  absl::StatusOr<Verdict> Accept(absl::string_view actor, const Permit& fragment, const LaneSnapshot& snapshot,
                                 uint64_t digest = 0);

  // What Accept would say of a fragment of `actor`, before its content is known: kDuplicate for one that was accepted.
  //   InvalidArgument: as Accept.
  absl::StatusOr<Verdict> Judge(absl::string_view actor, const Permit& fragment) const;

  // Advances the lane by one fragment that an earlier start of the learner accepted. Returns false if the lane is at
  // another fragment. To be called before the first OpenIteration.
  bool Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest = 0);

  // Whether that fragment of the current iteration was accepted and has not been rolled back since.
  bool Counts(int lane, int64_t fragment, uint64_t digest) const;

  // The state before `fragment` of `lane`.   Aborted: the lane is at another fragment.   InvalidArgument: no such lane.
  absl::StatusOr<LaneSnapshot> Snapshot(int lane, int64_t fragment) const;

  // Opens the next iteration: permits for fragments up to `last_fragment` (excluded) of each lane, with
  // `policy_version`. With max_staleness an iteration begins at TakeRollout instead.
  void OpenIteration(int64_t last_fragment, int64_t policy_version);
  // With max_staleness: new permits have `policy_version`, from which the update with the next rollout will start.
  void PublishVersion(int64_t policy_version);
  // With max_staleness: the fragments that the next update learns from, in the order of their arrival, once they are
  // complete; from then on no reset affects them. The update after that starts from the next version.
  std::optional<std::vector<Arrival>> TakeRollout();
  // Rolls every lane back to the beginning of the iteration, or of the one before if `iterations` is 2; nothing is
  // granted until the next Open... or PublishVersion. Must not be called again before it.
  void RewindIterations(int iterations);
  // While paused, nothing is granted; outstanding permits remain valid. Returns whether it was paused before.
  bool SetPaused(bool paused);
  bool paused() const { return paused_; }

  bool IsKnown(absl::string_view actor) const { return Find(actor) != actors_.end(); }
  bool empty() const { return actors_.empty(); }
  int actors() const { return static_cast<int>(actors_.size()); }
  std::vector<LaneRecord> Records() const;
  // The lanes at the beginning of the iteration.
  std::vector<LaneRecord> StartRecords() const;
  std::vector<ActorInfo> Actors() const;
  // Information about a known actor.
  ActorInfo InfoOf(absl::string_view actor) const { return InfoOf(*Find(actor)); }
  // The number of outstanding permits, of all actors and of one.
  int permits() const;
  int PermitsOf(absl::string_view actor) const;
  // The fragments that are being played.
  std::vector<Playing> BeingPlayed() const;
  // The number of permits that lapsed, or whose overdue fragments others finished, since the start.
  int64_t lapsed() const { return lapsed_; }
  // The number of resets of lanes because of invalid snapshots, since the start.
  int64_t resets() const { return resets_; }
  // The number of duplicates that differ from the accepted fragment, since the start.
  int64_t differing() const { return differing_; }

  // The number of fragments dropped because they were too old, since the start.
  int64_t dropped() const { return dropped_; }

  // Which actors may get permits that they could not get at the last call.
  struct Change {
    bool all = false;
    std::vector<std::string> actors = {};  // if not all
  };
  Change TakeChange() { return std::exchange(change_, {}); }

 private:
  struct Actor {
    const Worker* worker = nullptr;
    absl::Time returned = absl::InfinitePast();  // when it last returned permits
    int64_t number = 0;                          // unique, from 1
    int capacity = 0;                            // lanes it can play at once, as last reported
    std::set<int> lanes;                         // that it holds
    std::set<int> permits;                       // lanes for which it has one
    int64_t fragments = 0;
    absl::Duration pause;  // length of the current or last pause for being late; 0: it has finished a fragment since
    absl::Time pause_end = absl::InfinitePast();
    int held() const { return static_cast<int>(lanes.size()); }
  };
  using ActorMap = std::map<std::string, Actor, std::less<>>;  // by name

  // An actor that has a lane's permit.
  struct Player {
    Actor* actor = nullptr;
    absl::Time since;  // when it got it
  };
  // An accepted fragment.
  struct AcceptedFragment {
    int64_t fragment = 0;
    uint64_t digest = 0;
    std::string sender;
    bool differs = false;  // a duplicate with other content was logged
  };
  // That a snapshot can't be restored.
  struct Report {
    std::string client;  // WorkerClient::Name of the actor that reported it
    std::string actor;
    int unanswered = 0;  // actors whose word would count beside this one's that had the lane since, but did not play it
  };
  struct Lane {
    LaneRecord record;
    LaneRecord start;                       // at the beginning of the current iteration
    LaneRecord earlier_start;               // at the beginning of the one before
    Actor* holder = nullptr;                // the actor with its game, if any
    std::optional<Permit> permit;           // the outstanding one
    std::vector<Player> players;            // who have it, in the order of their grants; the first is `holder`
    absl::Time since;                       // when the permit was last granted, or the lane became free
    int64_t avoided = 0;                    // the number of the actor that failed to play it last; 0: none
    absl::Time avoided_until;               // others are preferred until then
    std::optional<Report> report;           // the first one on its current snapshot
    int64_t reset_at = -1;                  // fragment before which it was reset; games that actors hold there are void
    std::deque<AcceptedFragment> accepted;  // of the current iteration and the previous one
    bool restored = false;                  // advanced by Restore since `start`
    int64_t last_fragment = 0;              // permits are for fragments before this one
    bool IsOpen() const { return !permit.has_value() && record.next_fragment < last_fragment; }
  };
  // A fragment accepted for a rollout that is not taken yet.
  struct WaitingArrival {
    Arrival arrival;
    SharedSnapshot snapshot;  // after it
    std::string sender;
  };
  // Fair shares: each actor may hold `all` lanes, if it can play that many, and `extra` actors one more.
  struct Shares {
    int all = 0;
    int extra = 0;
    int above = 0;  // number of actors that hold more than `all`
    int Most() const { return all + (extra > 0 ? 1 : 0); }
    bool IsOver(const Actor& actor) const { return actor.held() > all + 1 || (actor.held() > all && above > extra); }
    int Of(const Actor& actor) const { return all + (above - (actor.held() > all ? 1 : 0) < extra ? 1 : 0); }
  };

  // The reason for which an actor may get a lane, strongest first.
  enum class Claim { kOwn, kSpare, kUnclaimed, kNone };

  // Ends the pause of an actor, a fragment of which was accepted.
  void EndPause(Actor* actor);
  // Pauses those players of the lane for which its fragment was overdue when `sender` finished it.
  void PauseLate(const Lane& lane, const Actor& sender);
  // The number of lanes that the actor may currently play at once.
  static int CapacityOf(const Actor& actor);
  // Whether the actor could play now, and whether another one could; or an actor of another client.
  bool CanPlay(const Actor& actor) const;
  bool HasOthers(const Actor& actor) const;
  bool HasOtherClients(const Actor& actor) const;
  // Whether the actor's word counts beside that of `report`.
  bool IsIndependent(const Report& report, const Actor& actor) const;
  // Revokes the lane's permit from `actor` and prefers other actors for it.
  void GiveToOthers(Lane* lane, Actor* actor);
  // Resets a lane whose snapshot can't be restored; logs `reason`.
  void Reset(Lane* lane, absl::string_view reason);
  // Rolls the lane back to the beginning of the iteration.
  void Rewind(Lane* lane);
  // Drops the permits' limits and times of the iteration before.
  void BeginPermits();
  // Remembers where the lane stands, as the beginning of an iteration.
  static void BeginLane(Lane* lane);
  // How many more permits may be granted (max_staleness).
  int64_t Ahead() const;
  // With max_staleness: how old a fragment that arrives now will be when it is learned from.
  int64_t StalenessOf(int64_t policy_version) const;
  // Ends the permit of a fragment that `sender` has played, and leaves the lane to it.
  void EndPlayed(Lane* lane, Actor* sender);
  // Whether the fragment, of this or the previous iteration, was accepted from `actor`.
  bool IsAcceptedFrom(absl::string_view actor, const Permit& fragment) const;
  // Compares a duplicate with the accepted fragment.
  void Compare(absl::string_view actor, const Permit& fragment, uint64_t digest);
  ActorMap::const_iterator Find(absl::string_view actor) const { return actors_.find(actor); }
  void Remove(ActorMap::iterator actor);
  ActorInfo InfoOf(const ActorMap::value_type& actor) const;
  bool HasJustReturned(const Actor& actor) const;
  // Grants overdue fragments of other actors to `actor`, which has no work.
  std::vector<Permit> GrantOverdue(Actor* actor, const Shares& shares);
  // Whether `actor` should get an overdue lane before others do.
  bool IsPreferred(const Lane& lane, const Actor& actor) const;
  Claim ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares, absl::Time now) const;
  bool IsAvoided(const Lane& lane, const Actor& actor, absl::Time now) const;
  const Shares& FairShares() const;
  static bool IsPlayer(const Lane& lane, const Actor* actor);
  int NumberOf(const Lane& lane) const { return static_cast<int>(&lane - lanes_.data()); }
  void SetHolder(Lane* lane, Actor* actor);
  // Counts a fragment of `actor` that is too old, and logs it at a limited rate.
  void Drop(const Permit& fragment, const std::string& actor);
  // Notes that a fragment of the lane, which `sender` has played, is open.
  void NoteOpened(const Lane& lane, const Actor& sender);
  // Ends the lane's permit for all players.
  void EndPermit(Lane* lane);
  // Revokes the lane's permit from `actor`, if it has it; other players continue.
  void Revoke(Lane* lane, Actor* actor);

  const Options options_;
  Clock* const clock_;

  Change change_;
  std::vector<Lane> lanes_;
  ActorMap actors_;
  int64_t last_actor_ = 0;                // number
  int playing_ = 0;                       // lanes with a permit
  mutable std::optional<Shares> shares_;  // unset: to be computed, since actors, capacities or holders have changed
  absl::Time next_expiry_ = absl::InfiniteFuture();  // no lease expires before then
  int64_t lapsed_ = 0;
  int64_t resets_;
  int64_t differing_ = 0;
  Overdue overdue_;
  int64_t policy_version_ = 0;          // of new permits
  std::deque<WaitingArrival> waiting_;  // with max_staleness, in the order of arrival
  int64_t next_update_ = 0;             // version from which the update with the next rollout will start
  int64_t dropped_ = 0;
  LimitedLog drops_;
  bool paused_ = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SCHEDULING_LANE_SCHEDULER_H_
