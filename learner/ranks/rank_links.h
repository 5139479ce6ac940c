// How the learners of one run ("ranks") find each other, and the connections between them: c10d's TCPStore and Gloo.
// Nothing of them is encrypted or authenticated.

#ifndef CRAFTFLEET_LEARNER_RANKS_RANK_LINKS_H_
#define CRAFTFLEET_LEARNER_RANKS_RANK_LINKS_H_

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/mutex.h"

namespace craftfleet {

struct RankOptions {
  int rank = 0;                                              // of this process, 0..world_size-1
  int world_size = 1;                                        // ranks of the run
  std::string given = "--world_size=1";                      // what said so, for messages: a flag or a variable
  std::string master_addr = "127.0.0.1";                     // where rank 0 is, for all
  int master_port = 29500;                                   // where rank 0 listens, on every address of its host
  absl::Duration timeout = absl::Minutes(5);                 // for all ranks to come
  std::function<bool()> should_stop = [] { return false; };  // asked by rank 0 while it waits for the others
};

// What all ranks must have in common.
struct RankBuild {
  std::string canary;  // PolicyCanary
  std::string build;   // for messages
  // Why this rank can't be part of what rank 0 offers. OK: it can.
  absl::Status objection = absl::OkStatus();
};

// Connections of a rank to those before and after it. A rank that says nothing for 7 s is lost; that ends the links.
// Transfers are for one thread, the rest is thread-safe.
class RankLinks {
 public:
  ~RankLinks();
  RankLinks(const RankLinks&) = delete;
  RankLinks& operator=(const RankLinks&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }

  struct Operation;
  // A transfer that has been started. Its bytes must stay where they are until Wait returns, or the transfer is
  // destroyed.
  using Transfer = std::shared_ptr<Operation>;

  // Start to send `bytes`, at least one, to `rank`, or to receive as many from it. `rank` is a neighbour: this rank's
  // number plus or minus 1. The bytes travel once both sides have started.
  Transfer StartSend(int rank, absl::Span<const char> bytes);
  Transfer StartReceive(int rank, absl::Span<char> bytes);
  // Waits for a transfer for as long as the neighbour lives.
  //   As ended().
  absl::Status Wait(const Transfer& transfer);
  absl::Status Send(int rank, absl::Span<const char> bytes) { return Wait(StartSend(rank, bytes)); }
  absl::Status Receive(int rank, absl::Span<char> bytes) { return Wait(StartReceive(rank, bytes)); }

  // Ends the links, and so the calls that wait; the neighbours notice. The first reason stays.
  void Leave(const absl::Status& reason) ABSL_LOCKS_EXCLUDED(mutex_);

  // OK until the links end.
  //   Unavailable: a neighbour is lost; the message names it.   Others: as given to Leave.
  absl::Status ended() const ABSL_LOCKS_EXCLUDED(mutex_);

 private:
  friend class RankMeeting;
  struct Groups;  // of c10d

  RankLinks(int rank, int size, std::unique_ptr<Groups> groups);
  // Waits for at most `limit`.
  absl::Status Finish(const Transfer& transfer, absl::Duration limit) ABSL_LOCKS_EXCLUDED(mutex_);
  // Ends the links because `neighbour` is lost.
  absl::Status Lose(int neighbour, const std::string& why) ABSL_LOCKS_EXCLUDED(mutex_);
  // Tells the neighbours once a second that this rank lives, and notices when one of them does not.
  void Beat();
  bool BeatOnce(const std::vector<int>& neighbours);

  const int rank_;
  const int size_;
  const std::unique_ptr<Groups> groups_;
  mutable Mutex mutex_;
  CondVar changed_;
  absl::Status ended_ ABSL_GUARDED_BY(mutex_);
  std::vector<Operation*> running_ ABSL_GUARDED_BY(mutex_);
  std::thread beats_;
};

// Where the ranks meet before they are a group.
class RankMeeting {
 public:
  // Rank 0 listens and offers `offer` to the others, which connect and get it. Returns when this rank is there.
  //   Unavailable: rank 0 can't listen, or has not come in time; the message has address and port.
  //   FailedPrecondition: this rank and rank 0 have different world sizes.   Unimplemented: this build has no ranks.
  static absl::StatusOr<std::unique_ptr<RankMeeting>> Open(const RankOptions& options, const std::string& offer);
  ~RankMeeting();
  RankMeeting(const RankMeeting&) = delete;
  RankMeeting& operator=(const RankMeeting&) = delete;

  // Rank 0's.
  const std::string& offer() const { return offer_; }

  // Waits for all ranks, compares their builds and connects them. To be called once.
  //   Unavailable: some have not come in time; names them.   FailedPrecondition: a rank computes other numbers than
  //   rank 0, or objects; names it.   AlreadyExists: another process has this rank. All ranks that came get the first
  //   two.
  //   Cancelled: rank 0's should_stop said so.
  absl::StatusOr<std::unique_ptr<RankLinks>> Connect(const RankBuild& build);

 private:
  struct Store;

  RankMeeting(const RankOptions& options, std::unique_ptr<Store> store);
  // Rank 0: waits for the others. What is wrong with them; OK: nothing.
  absl::Status CheckOthers(const RankBuild& build);
  // The others: tell rank 0 that they are here and what they are, and learn what it found.
  absl::Status Report(const RankBuild& build);
  std::string address() const;

  const RankOptions options_;
  const absl::Time deadline_;
  const std::unique_ptr<Store> store_;
  std::string offer_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RANKS_RANK_LINKS_H_
