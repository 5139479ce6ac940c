#include "learner/ranks/shared_sum.h"

#include <fcntl.h>
#include <linux/futex.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <climits>
#include <cstring>
#include <random>
#include <utility>
#include <vector>

#include <absl/strings/str_format.h>
#include <absl/time/time.h>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr size_t kLine = 64;  // bytes
constexpr mode_t kOwnerOnly = 0600;
// The others are about to publish: a wait in the kernel costs more than this.
constexpr absl::Duration kSpin = absl::Microseconds(100);
// How often a rank that waits asks whether the group has ended.
constexpr absl::Duration kAsk = absl::Milliseconds(5);
constexpr size_t kBlock = 4096;  // floats that are added at a time, of all terms

std::string NewName() {
  std::random_device random;
  return absl::StrFormat("/craftfleet-%08x%08x%08x%08x", random(), random(), random(), random());
}

size_t Aligned(size_t bytes) { return (bytes + kLine - 1) / kLine * kLine; }

}  // namespace

void AddInOrder(absl::Span<const float* const> terms, absl::Span<float> total) {
  for (size_t begin = 0; begin < total.size(); begin += kBlock) {
    const absl::Span<float> block = total.subspan(begin, kBlock);
    if (terms[0] != total.data()) std::copy_n(terms[0] + begin, block.size(), block.begin());
    for (size_t k = 1; k < terms.size(); ++k) {
      const float* const term = terms[k] + begin;
      for (size_t i = 0; i < block.size(); ++i) block[i] += term[i];
    }
  }
}

void CopyPieces(const SumTerm& term, float* to) {
  for (const absl::Span<const float> piece : term) to = std::copy(piece.begin(), piece.end(), to);
}

// Zero in the beginning.
struct SharedSum::Rank {
  alignas(kLine) std::atomic<uint32_t> rounds;  // published
  std::atomic<uint32_t> waiting;                // ranks that may wait in the kernel for the next
  std::atomic<uint32_t> other_calls;
};

// Followed by a Few for each term, and the terms.
struct SharedSum::Slot {
  int32_t code;  // of the rank's status
  int32_t fews;
  int32_t terms;
  char message[420];
};

SharedSum::SharedSum(std::string name, char* memory, int rank, const Size& size)
    : name_(std::move(name)), memory_(memory), rank_(rank), size_(size) {}

SharedSum::~SharedSum() { munmap(memory_, MemoryBytes(size_)); }

size_t SharedSum::SlotBytes(const Size& size) {
  return Aligned(sizeof(Slot)) + size.terms * (Aligned(sizeof(Few)) + Aligned(size.floats * sizeof(float)));
}

size_t SharedSum::MemoryBytes(const Size& size) { return size.ranks * (sizeof(Rank) + 2 * SlotBytes(size)); }

SharedSum::Rank* SharedSum::RankOf(int rank) const { return reinterpret_cast<Rank*>(memory_) + rank; }

SharedSum::Slot* SharedSum::SlotOf(int rank) const {
  const size_t number = 2 * rank + round_ % 2;
  return reinterpret_cast<Slot*>(memory_ + size_.ranks * sizeof(Rank) + number * SlotBytes(size_));
}

Few* SharedSum::FewOf(Slot* slot, int number) const {
  return reinterpret_cast<Few*>(reinterpret_cast<char*>(slot) + Aligned(sizeof(Slot)) + number * Aligned(sizeof(Few)));
}

float* SharedSum::TermOf(Slot* slot, int number) const {
  char* const first = reinterpret_cast<char*>(FewOf(slot, size_.terms));
  return reinterpret_cast<float*>(first + number * Aligned(size_.floats * sizeof(float)));
}

char* SharedSum::Map(int file, const Size& size) {
  void* const memory = mmap(nullptr, MemoryBytes(size), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, file, 0);
  close(file);
  return memory == MAP_FAILED ? nullptr : static_cast<char*>(memory);
}

std::unique_ptr<SharedSum> SharedSum::Create(const Size& size) {
  const std::string name = NewName();
  const int file = shm_open(name.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, kOwnerOnly);
  if (file < 0) return nullptr;
  // Whether there is memory is found out now, not by a signal when it is used.
  const bool is_there = posix_fallocate(file, 0, static_cast<off_t>(MemoryBytes(size))) == 0;
  char* const memory = is_there ? Map(file, size) : nullptr;
  if (!is_there) close(file);
  if (memory == nullptr) shm_unlink(name.c_str());
  return memory == nullptr ? nullptr : std::unique_ptr<SharedSum>(new SharedSum(name, memory, 0, size));
}

std::unique_ptr<SharedSum> SharedSum::Open(const std::string& name, int rank, const Size& size) {
  const int file = shm_open(name.c_str(), O_RDWR | O_CLOEXEC, 0);
  char* const memory = file < 0 ? nullptr : Map(file, size);
  return memory == nullptr ? nullptr : std::unique_ptr<SharedSum>(new SharedSum(name, memory, rank, size));
}

void SharedSum::Hide() { shm_unlink(name_.c_str()); }

void SharedSum::NoteOtherCall() { ++RankOf(rank_)->other_calls; }

absl::Status SharedSum::Add(const absl::Status& own, absl::Status* agreed, absl::Span<const Few> few, Few* few_total,
                            absl::Span<const SumTerm> terms, absl::Span<float> total,
                            const std::function<absl::Status()>& ended) {
  ++round_;
  Publish(own, few, terms);
  *agreed = absl::OkStatus();
  *few_total = {};
  std::vector<const float*> all_terms;
  for (int rank = 0; rank < size_.ranks; ++rank) {
    CRAFTFLEET_RETURN_IF_ERROR(Await(rank, ended));
    Slot* const slot = SlotOf(rank);
    if (agreed->ok() && slot->code != 0) {
      *agreed = absl::Status(static_cast<absl::StatusCode>(slot->code), slot->message);
    }
    for (int i = 0; i < slot->fews; ++i) {
      for (int k = 0; k < kFew; ++k) (*few_total)[k] += (*FewOf(slot, i))[k];
    }
    for (int i = 0; i < slot->terms; ++i) all_terms.push_back(TermOf(slot, i));
  }
  AddInOrder(all_terms, total);
  return absl::OkStatus();
}

void SharedSum::Publish(const absl::Status& own, absl::Span<const Few> few, absl::Span<const SumTerm> terms) {
  CRAFTFLEET_CHECK(terms.size() <= static_cast<size_t>(size_.terms) && few.size() <= static_cast<size_t>(size_.terms));
  Slot* const slot = SlotOf(rank_);
  slot->code = own.raw_code();
  absl::SNPrintF(slot->message, sizeof(slot->message), "%s", own.message());
  slot->fews = static_cast<int32_t>(few.size());
  for (int i = 0; i < slot->fews; ++i) *FewOf(slot, i) = few[i];
  if (rank_ == 0) {  // which begins: its terms can be added now
    slot->terms = 1;
    float* end = TermOf(slot, 0);
    for (size_t piece = 0; piece < terms[0].size(); ++piece) {
      std::vector<const float*> pieces;
      for (const SumTerm& term : terms) pieces.push_back(term[piece].data());
      AddInOrder(pieces, {end, terms[0][piece].size()});
      end += terms[0][piece].size();
    }
  } else {
    slot->terms = static_cast<int32_t>(terms.size());
    for (int i = 0; i < slot->terms; ++i) CopyPieces(terms[i], TermOf(slot, i));
  }
  Rank* const rank = RankOf(rank_);
  rank->rounds = round_;
  if (rank->waiting.exchange(0) != 0) syscall(SYS_futex, &rank->rounds, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

absl::Status SharedSum::Await(int rank, const std::function<absl::Status()>& ended) const {
  Rank* const other = RankOf(rank);
  const timespec limit = absl::ToTimespec(kAsk);
  const absl::Time begin = SteadyNow();
  while (other->rounds + 1 == round_) {
    if (SteadyNow() - begin < kSpin) continue;
    // In this order: it may have published meanwhile, and gone on.
    const auto ahead = static_cast<int32_t>(other->other_calls - RankOf(rank_)->other_calls);
    const uint32_t rounds = other->rounds;
    if (rounds + 1 != round_) continue;
    if (ahead > 0) {
      return absl::InternalError(absl::StrFormat(
          "ranks %d and %d are out of step: one of them failed in the middle of an update", rank_, rank));
    }
    CRAFTFLEET_RETURN_IF_ERROR(ended());
    other->waiting = 1;
    syscall(SYS_futex, &other->rounds, FUTEX_WAIT, rounds, &limit, nullptr, 0);
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
