// Sums of the ranks on one host, through memory that they share.

#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/types/span.h>

namespace craftfleet {

// A few numbers whose sum travels with a large one.
constexpr int kFew = 8;
using Few = std::array<double, kFew>;

// A term of a large sum, in pieces that follow each other.
using SumTerm = std::vector<absl::Span<const float>>;

// Sets `total` to the terms, at least one, added in this order. It may be in place of the first.
void AddInOrder(absl::Span<const float* const> terms, absl::Span<float> total);
void CopyPieces(const SumTerm& term, float* to);

// A sum takes one exchange: each rank puts its terms into the memory, waits for those of the others and adds all of
// them itself, in the order of ranks. So a rank copies its own terms once and reads each other's once; sockets would
// copy them four times, on the cores that are to learn. For one thread.
class SharedSum {
 public:
  // What the sums of a group are at most, the same for all ranks.
  struct Size {
    int ranks = 1;
    size_t floats = 0;  // of a term
    int terms = 1;      // of a rank, and Fews
  };

  // Rank 0's. Null: this host has not enough memory to share, for example in a container with a small /dev/shm.
  static std::unique_ptr<SharedSum> Create(const Size& size);
  // Another rank's, of rank 0's name(), which is nobody else's. Null: it is not there, as on another host.
  static std::unique_ptr<SharedSum> Open(const std::string& name, int rank, const Size& size);
  ~SharedSum();
  SharedSum(const SharedSum&) = delete;
  SharedSum& operator=(const SharedSum&) = delete;

  const std::string& name() const { return name_; }
  // Nobody can open it any more. Once all ranks have, no file is left behind, however the processes end.
  void Hide();

  // Whether a sum of this many floats fits.
  bool Fits(size_t floats) const { return floats <= size_.floats; }

  // As RankGroup::AgreeAndSum, whose return value `agreed` gets. While it waits, it asks `ended` now and then.
  //   Internal: another rank does something else instead.   Others: as `ended`.
  absl::Status Add(const absl::Status& own, absl::Status* agreed, absl::Span<const Few> few, Few* few_total,
                   absl::Span<const SumTerm> terms, absl::Span<float> total,
                   const std::function<absl::Status()>& ended);

  // This rank begins something else together with the others.
  void NoteOtherCall();

 private:
  struct Rank;  // in the memory, for each rank: what it has done
  struct Slot;  // likewise: what it adds

  SharedSum(std::string name, char* memory, int rank, const Size& size);
  static size_t SlotBytes(const Size& size);
  static size_t MemoryBytes(const Size& size);
  // Maps `file` and closes it. Null: that failed.
  static char* Map(int file, const Size& size);
  Rank* RankOf(int rank) const;
  // Where `rank` puts its part of the present round. It alternates between two, because others may still read the last.
  Slot* SlotOf(int rank) const;
  Few* FewOf(Slot* slot, int number) const;
  float* TermOf(Slot* slot, int number) const;
  // Puts this rank's part of the present round into its slot.
  void Publish(const absl::Status& own, absl::Span<const Few> few, absl::Span<const SumTerm> terms);
  // Waits until `rank` has published its part.   Errors as Add.
  absl::Status Await(int rank, const std::function<absl::Status()>& ended) const;

  const std::string name_;
  char* const memory_;
  const int rank_;
  const Size size_;
  uint32_t round_ = 0;
};

}  // namespace craftfleet
