// What the learners of one run compute together: each rank's part, added in the order of ranks.

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "learner/ranks/rank_links.h"
#include "learner/ranks/shared_sum.h"

namespace craftfleet {

// The ranks form a chain: each talks to the one before and the one after it, so that no rank sends or receives more
// than the others. All ranks call the same functions in the same order. Each waits for the others, for as long as they
// live. The calls are for one thread, Leave and ended are thread-safe.
//
// Errors of every call but Agree end the group:
//   Unavailable: a rank is lost; the message names it.   Internal: the ranks did not call the same functions.
//   Others: as given to Leave.
class RankGroup {
 public:
  explicit RankGroup(std::unique_ptr<RankLinks> links) : links_(std::move(links)) {}

  int rank() const { return links_->rank(); }
  int size() const { return links_->size(); }

  // Gives rank 0's `bytes` or `flag` to all.
  absl::Status Broadcast(std::string* bytes);
  absl::StatusOr<bool> Share(bool flag);

  // Whether all ranks succeeded: the error of the first rank that has one, the same for all ranks. Each rank's `digest`
  // must be rank 0's.
  //   DataLoss: a rank has another digest; names it.   Others: the ranks' own, or ended().
  absl::Status Agree(const absl::Status& own, uint64_t digest = 0);

  // Adds the terms of all ranks to `total`, of the same size on all: those of rank 0 in their order, then those of rank
  // 1, and so on. Rank 0 has at least one term; each has as many numbers as `total`, which may be one of them. All
  // ranks get the same bits.
  absl::Status Sum(absl::Span<const SumTerm> terms, absl::Span<float> total);

  // Agree(own), Sum, and the sum of the ranks' `few` terms in the same order, in a single exchange. If a rank has an
  // error, the totals are unspecified.
  absl::Status AgreeAndSum(const absl::Status& own, absl::Span<const Few> few, Few* few_total,
                           absl::Span<const SumTerm> terms, absl::Span<float> total);

  // From now on, sums of up to `floats` numbers go through memory if all ranks are on one host that has enough of it.
  // No rank has more than `terms` terms, or Fews.
  absl::Status ShareMemory(int terms, size_t floats);

  // As those of RankLinks.
  void Leave(const absl::Status& reason) { links_->Leave(reason); }
  absl::Status ended() const { return links_->ended(); }

 private:
  enum class NoteKind : int32_t { kBroadcast, kShare, kAgree, kSum };
  struct Note;  // a message of fixed size
  using Transfers = std::vector<RankLinks::Transfer>;

  // Each call but sums through memory begins with it.
  void BeginCall();
  bool is_first() const { return rank() == 0; }
  bool is_last() const { return rank() + 1 == size(); }
  absl::Status SendNote(int rank, const Note& note);
  // `note` has the kind that is wanted.   Errors as AwaitNote.
  absl::Status ReceiveNote(int rank, Note* note);
  // Rank 0's note to all.
  absl::Status PassOn(Note* note);
  // Waits for `transfer`, which brings `note` from `rank`.
  //   Internal, after leaving: it is not of the kind `wanted`.
  absl::Status AwaitNote(const RankLinks::Transfer& transfer, int rank, NoteKind wanted, const Note& note);
  // Adds this rank's error to a note on its way to the last rank.
  static void AddError(const absl::Status& own, Note* note);
  static absl::Status StatusOf(const Note& note);
  // AgreeAndSum through memory.
  absl::Status SumShared(const absl::Status& own, absl::Span<const Few> few, Few* few_total,
                         absl::Span<const SumTerm> terms, absl::Span<float> total);
  // Starts to receive a note and the parts of `values`; the transfers are in this order.
  Transfers StartReceive(int rank, Note* note, absl::Span<float> values);
  // Adds this rank's terms to what `from_before` brings, and sends the sums on; from the last rank, back.
  absl::Status SumForward(const Transfers& from_before, Note* note, absl::Span<const Few> few, absl::Span<float> total,
                          Transfers* sent);
  // Passes the totals that `from_after` brings on to the rank before.
  absl::Status PassBack(const Transfers& from_after, const Note& agreed, absl::Span<float> total, Transfers* sent);

  const std::unique_ptr<RankLinks> links_;
  std::unique_ptr<SharedSum> shared_;    // null: sums go along the chain
  std::vector<std::vector<float>> own_;  // along the chain: this rank's terms, each in one piece
  std::vector<float> before_;            // and sums that came from the rank before
};

}  // namespace craftfleet
