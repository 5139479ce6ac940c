// Who may play what: the learner's book of lanes, permits and actors.

#ifndef CRAFTFLEET_LEARNER_LANE_LEDGER_H_
#define CRAFTFLEET_LEARNER_LANE_LEDGER_H_

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/clock.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// Leave to collect one fragment.
struct Permit {
  int lane = 0;
  int64_t fragment = 0;        // per lane, from 0
  int64_t policy_version = 0;  // weights to play it with
  friend bool operator==(const Permit& a, const Permit& b) {
    return a.lane == b.lane && a.fragment == b.fragment && a.policy_version == b.policy_version;
  }
  friend bool operator!=(const Permit& a, const Permit& b) { return !(a == b); }
};

// A lane as last accepted: what a checkpoint keeps of it, but for the sender.
struct LaneRecord {
  int64_t next_fragment = 0;
  LaneSnapshot snapshot;       // before that fragment
  LaneSnapshot previous = {};  // before the last one: where the lane goes on if nobody can restore `snapshot`
  std::string sender = "";     // the actor that sent the last one; empty: unknown, of an earlier start
};

// Synchronous permits: within an iteration each lane gets them one after the other, all under the
// iteration's weights. An actor gets its fair share of the lanes: those that it played before first (it holds their
// games), then those that nobody holds or whose holder has more than its share, at last, when a lane was left lying for
// `Options::patience`, anybody's. Shares differ by one lane at most, but for actors that can't play as many. An actor
// that gives permits back, because it can't play, gets no other for `patience` where there are more actors, who may.
// A permit lapses when its actor has not asked for `lease`, or for twice as long if nobody else asks, and the actor is
// forgotten then; after `comeback` already if its connection broke, as that of a dead process does at once. A fragment
// is accepted at most once. Once permits lapsed in an iteration, an actor that has nothing to do also gets permits that
// another has had for `patience`: each fragment is then played by two at most, to the same bytes, and the first counts.
// Without that the last fragments wait for one worker after the other where workers die all the time. The same goes for
// fragments that are overdue against the others of their iteration, whether or not anything lapsed.
//
// Asking renews an actor, not its permits: these are renewed by progress. One whose steps have not grown for `progress`
// is taken back, if there is another actor to play it; for twice as long each time that this happens to the lane in a
// row, so that slow agents get done. Its actor then pauses, 1 s and twice as long each time, 5 min at most, and gets
// one permit at a time until it makes progress again.
//
// A lane whose snapshot two actors can't restore (or the only one, twice) is put back: to the beginning of the
// iteration if it has got further, so that what comes of the iteration is the same, else to its previous snapshot, else
// to a new game. Thread-safe.
class LaneLedger {
 public:
  struct Options {
    int lanes = 16;  // 1..
    absl::Duration lease = absl::Seconds(5);
    absl::Duration patience = absl::Seconds(1);
    absl::Duration comeback = absl::Seconds(2);  // at most `lease`
    absl::Duration progress = absl::Seconds(20);
    int resets = 0;  // lanes that were put back before, when they were loaded
  };
  enum class Verdict { kAccepted, kDuplicate, kExpired };
  struct Grant {
    std::vector<Permit> granted;
    std::vector<Permit> lost;  // of those renewed: lapsed and free again, or given to another
    bool finished = false;
    bool resting = false;  // play is paused or the actor is being drained: it gets nothing
  };
  struct ActorInfo {
    std::string name;
    std::string address;
    int permits = 0;
    int64_t fragments = 0;  // accepted
    absl::Duration idle;    // since its last word
    bool draining = false;
    bool stalled = false;  // permits were taken back from it, and it has made no progress since
  };

  LaneLedger(const Options& options, std::vector<LaneRecord> lanes, Clock* clock);

  // Makes `actor`, a name that no other worker ever had, known, or renews it.
  void Join(absl::string_view actor, absl::string_view address) ABSL_LOCKS_EXCLUDED(mu_);
  // Forgets `actor` and frees its permits.
  void Leave(absl::string_view actor) ABSL_LOCKS_EXCLUDED(mu_);
  // The connection on which `actor` asked broke: it has `comeback` to ask again.
  void LoseTouch(absl::string_view actor) ABSL_LOCKS_EXCLUDED(mu_);

  // Renews `active` and grants further permits up to `capacity` lanes in all; waits up to `wait` while there is nothing
  // to say. `steps`: of each of `active`, played so far; empty: none.
  //   Aborted: `actor` is not known, or left meanwhile: it must join (again).   Unavailable: Close was called.
  absl::StatusOr<Grant> GetPermits(absl::string_view actor, absl::Span<const Permit> active, int capacity,
                                   absl::Duration wait, absl::Span<const int64_t> steps = {}) ABSL_LOCKS_EXCLUDED(mu_);

  // `actor` gives `fragment` of `lane` back: no environment server restores the snapshot before it, for `reason`.
  // Without effect unless it has that permit.
  void Refuse(absl::string_view actor, int lane, int64_t fragment, absl::string_view reason) ABSL_LOCKS_EXCLUDED(mu_);

  // Decides on a fragment and, when it is accepted, takes its lane one fragment further. `snapshot` is copied then.
  // `digest` is of its content (FragmentDigest): a duplicate that differs from the one that counts is an error in the
  // log and counted.
  //   InvalidArgument: the weights' version is not the permit's.
  absl::StatusOr<Verdict> Accept(absl::string_view actor, const Permit& fragment, const LaneSnapshot& snapshot,
                                 uint64_t digest = 0) ABSL_LOCKS_EXCLUDED(mu_);

  // Takes the lane one fragment further on behalf of an earlier start of the learner, which had accepted it. Before
  // the first OpenIteration.
  //   False: the lane is at another fragment.
  bool Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest = 0) ABSL_LOCKS_EXCLUDED(mu_);

  // Whether that fragment of the iteration under way counts: it was accepted, and not put back since.
  bool Counts(int lane, int64_t fragment, uint64_t digest) const ABSL_LOCKS_EXCLUDED(mu_);

  // The state before `fragment` of `lane`.   Aborted: the lane is at another fragment.   InvalidArgument: no such lane.
  absl::StatusOr<LaneSnapshot> Snapshot(int lane, int64_t fragment) const ABSL_LOCKS_EXCLUDED(mu_);

  // Opens the next iteration: permits for fragments up to `last_fragment` (excluded) of each lane, under
  // `policy_version`.
  void OpenIteration(int64_t last_fragment, int64_t policy_version) ABSL_LOCKS_EXCLUDED(mu_);
  // Puts every lane back to where it was when the iteration was opened; nothing is granted until the next
  // OpenIteration.
  void RewindIteration() ABSL_LOCKS_EXCLUDED(mu_);
  // The run is over: actors are told to leave.
  void Finish() ABSL_LOCKS_EXCLUDED(mu_);
  // The learner stops within the run: grants nothing more and wakes every waiter. Actors wait for its next start.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);
  // While paused nothing is granted; what is out is played. Returns whether it was paused.
  bool SetPaused(bool paused) ABSL_LOCKS_EXCLUDED(mu_);
  bool paused() const ABSL_LOCKS_EXCLUDED(mu_);
  // From now on `actor` is granted nothing: others get its lanes as soon as it has played what it has.
  void Drain(absl::string_view actor) ABSL_LOCKS_EXCLUDED(mu_);
  // It is, or is gone, and has no permit.
  bool IsDrained(absl::string_view actor) const ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until every actor has left, at most `timeout`.
  void WaitUntilEmpty(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

  std::vector<LaneRecord> Records() const ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<ActorInfo> Actors() const ABSL_LOCKS_EXCLUDED(mu_);
  // Permits that are out.
  int permits() const ABSL_LOCKS_EXCLUDED(mu_);
  // Permits whose lease ran out, or without progress, since the start.
  int64_t lapsed() const ABSL_LOCKS_EXCLUDED(mu_);
  // Lanes put back since their snapshot was no game, since the start.
  int64_t resets() const ABSL_LOCKS_EXCLUDED(mu_);
  // Duplicates that differed from what counts, since the start.
  int64_t differing() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Actor {
    std::string address;
    absl::Time last_word;
    absl::Time gave_back = absl::InfinitePast();  // permits, the last time
    int capacity = 0;                             // lanes that it can play at once, as it last said
    int held = 0;                                 // lanes of which it is the holder
    int permits = 0;                              // of these, with a permit out
    int64_t fragments = 0;
    bool draining = false;
    absl::Duration pause;  // for lack of progress; 0: it makes some
    absl::Time pause_end = absl::InfinitePast();
  };
  // How a player gets on with its fragment.
  struct Pace {
    int64_t steps = 0;  // as it last said
    absl::Time grew;    // when it last said more than before
  };
  // An accepted fragment.
  struct Taken {
    int64_t fragment = 0;
    uint64_t digest = 0;
    std::string sender;
    bool differs = false;  // another sent it otherwise, which was said
  };
  struct Lane {
    LaneRecord record;
    LaneRecord start;              // where the iteration under way began
    Actor* holder = nullptr;       // the actor that has its game, if any
    std::optional<Permit> permit;  // out at `holder`
    Pace pace;                     // of it
    Actor* backup = nullptr;       // plays the same fragment too, if any
    Pace backup_pace;
    absl::Time since;          // it has its permit, or has none
    int stalls = 0;            // permits taken back for lack of progress since the last fragment
    Actor* avoided = nullptr;  // failed at it last: others have the first choice
    absl::Time avoided_until;
    std::string refuser;      // said that its snapshot is no game
    int refusals = 0;         // how often that was said
    std::deque<Taken> taken;  // in the iteration under way and the one before
    bool restored = false;    // since `start`, by Restore
  };
  // Each actor may hold `all` lanes, as far as it can play them, and `extra` of those that can one more.
  struct Shares {
    int all = 0;
    int extra = 0;
    int above = 0;  // actors that hold more than `all`
    int Most() const { return all + (extra > 0 ? 1 : 0); }
    bool IsOver(const Actor& actor) const { return actor.held > all + 1 || (actor.held > all && above > extra); }
    int Of(const Actor& actor) const { return all + (above - (actor.held > all ? 1 : 0) < extra ? 1 : 0); }
  };

  // Why an actor may have a lane, strongest first.
  enum class Claim { kOwn, kSpare, kLeftLying, kNone };

  // Notes what `actor` has played of `active`.
  void NoteProgress(Actor* actor, absl::Span<const Permit> active, absl::Span<const int64_t> steps)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // It makes progress: it may have what it can play.
  static void EndPause(Actor* actor);
  // Takes back permits without progress.
  void EndStalls() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // It loses `permits` for lack of progress.
  void Punish(absl::string_view name, Actor* actor, int permits) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Lanes that it may have at once as things are.
  static int CapacityOf(const Actor& actor);
  bool IsStalled(const Lane& lane, const Actor* player, const Pace& pace) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Whether anybody else could play.
  bool HasOthers(const Actor& actor) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // `actor` gives the lane back; others may have it at once, and `actor` again if none of them takes it.
  void GiveToOthers(Lane* lane, Actor* actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Puts back a lane whose snapshot is no game.
  void PutBack(Lane* lane, absl::string_view reason) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Forgets what was accepted of the iteration.
  static void Rewind(Lane* lane);
  // Compares a fragment that came again with the one that counts.
  void Compare(absl::string_view actor, const Permit& fragment, uint64_t digest) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The age at which a fragment is overdue.
  absl::Duration Overdue() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Forgets actors whose lease ran out, with their permits.
  void ExpireLeases() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Forget(std::map<std::string, Actor>::iterator actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Takes back the permits of `actor` that it does not name; returns those it names without holding them.
  std::vector<Permit> Renew(Actor* actor, absl::Span<const Permit> active) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsPausing(const Actor& actor) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::vector<Permit> GrantTo(Actor* actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Fragments of others for it to play too.
  std::vector<Permit> GrantBackup(Actor* actor, const Shares& shares) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Claim ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares, absl::Time now) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsAvoided(const Lane& lane, const Actor& actor, absl::Time now) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Shares FairShares() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  static bool IsPlayer(const Lane& lane, const Actor* actor) { return lane.holder == actor || lane.backup == actor; }
  static void SetHolder(Lane* lane, Actor* actor);
  // Nobody plays its fragment any more.
  void EndPermit(Lane* lane);
  // `actor`, if it plays the fragment whose permit is out, does not any more; who plays it too goes on.
  void TakeBack(Lane* lane, Actor* actor);

  const Options options_;
  Clock* const clock_;

  mutable Mutex mu_;
  CondVar changed_;
  std::vector<Lane> lanes_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, Actor> actors_ ABSL_GUARDED_BY(mu_);  // by name
  int64_t lapsed_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t lapsed_before_ ABSL_GUARDED_BY(mu_) = 0;  // the iteration
  int64_t resets_ ABSL_GUARDED_BY(mu_);
  int64_t differing_ ABSL_GUARDED_BY(mu_) = 0;
  std::vector<absl::Duration> times_ ABSL_GUARDED_BY(mu_);  // that the iteration's fragments took
  int64_t last_fragment_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t policy_version_ ABSL_GUARDED_BY(mu_) = 0;
  bool finished_ ABSL_GUARDED_BY(mu_) = false;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
  bool paused_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_LANE_LEDGER_H_
