// Connections between the learners of one run ("ranks"), by Gloo. They are neither encrypted nor authenticated.

#pragma once

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/mutex.h"
#include "learner/ranks/rank_options.h"
#include "learner/ranks/rank_store.h"

namespace craftfleet {

// Connections of a rank to those before and after it. A rank that says nothing for 7 s is lost; that ends the links.
// Transfers are for one thread, the rest is thread-safe.
class RankLinks {
 public:
  // Whether this build can connect ranks.
  //   Unimplemented: it was built without Gloo's headers.
  static absl::Status Available();
  // Connects all ranks, which call it together. The store stays as long as the links.
  //   Unavailable: they can't; the message says why.
  static absl::StatusOr<std::unique_ptr<RankLinks>> Connect(const RankOptions& options,
                                                            const std::shared_ptr<RankStore>& store);
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

}  // namespace craftfleet
