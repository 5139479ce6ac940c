#include "learner/ranks/rank_group.h"

#include <algorithm>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// Of one transfer: the next rank works on a part while this one prepares the next.
constexpr size_t kPartBytes = size_t{1} << 20;

template <typename T>
absl::Span<char> BytesOf(absl::Span<T> values) {
  return absl::MakeSpan(reinterpret_cast<char*>(values.data()), values.size() * sizeof(T));
}

}  // namespace

struct RankGroup::Note {
  enum class Kind : int32_t { kBroadcast, kShare, kAgree };

  Kind kind;
  int32_t code = 0;     // kAgree: of the status
  uint64_t number = 0;  // kBroadcast: bytes that follow; kShare: the flag; kAgree: rank 0's digest
  char message[496] = {};
};

absl::Status RankGroup::SendNote(int rank, const Note& note) {
  return links_->Send(rank, absl::MakeConstSpan(reinterpret_cast<const char*>(&note), sizeof(note)));
}

absl::Status RankGroup::ReceiveNote(int rank, Note* note) {
  const Note::Kind wanted = note->kind;
  CRAFTFLEET_RETURN_IF_ERROR(links_->Receive(rank, BytesOf(absl::MakeSpan(note, 1))));
  if (note->kind == wanted) return absl::OkStatus();
  Leave(
      absl::InternalError(absl::StrFormat("ranks %d and %d are out of step: one of them failed in the middle of an "
                                          "update",
                                          this->rank(), rank)));
  return ended();
}

absl::Status RankGroup::PassOn(Note* note) {
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() - 1, note));
  return is_last() ? absl::OkStatus() : SendNote(rank() + 1, *note);
}

absl::Status RankGroup::Broadcast(std::string* bytes) {
  Note note{Note::Kind::kBroadcast};
  note.number = bytes->size();
  CRAFTFLEET_RETURN_IF_ERROR(PassOn(&note));
  bytes->resize(note.number);
  const absl::Span<char> all = absl::MakeSpan(bytes->data(), bytes->size());
  for (size_t offset = 0; offset < all.size(); offset += kPartBytes) {
    const absl::Span<char> part = all.subspan(offset, kPartBytes);
    if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(links_->Receive(rank() - 1, part));
    if (!is_last()) CRAFTFLEET_RETURN_IF_ERROR(links_->Send(rank() + 1, part));
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> RankGroup::Share(bool flag) {
  Note note{Note::Kind::kShare};
  note.number = flag ? 1 : 0;
  CRAFTFLEET_RETURN_IF_ERROR(PassOn(&note));
  return note.number == 1;
}

absl::Status RankGroup::Agree(const absl::Status& own, uint64_t digest) {
  Note note{Note::Kind::kAgree};
  note.number = digest;
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() - 1, &note));
  absl::Status mine = own;
  if (mine.ok() && note.number != digest) {
    mine = absl::DataLossError(absl::StrFormat("rank %d has other weights than rank 0 after the same update", rank()));
  }
  if (note.code == 0 && !mine.ok()) {
    note.code = mine.raw_code();
    absl::SNPrintF(note.message, sizeof(note.message), "%s", mine.message());
  }
  if (!is_last()) {
    CRAFTFLEET_RETURN_IF_ERROR(SendNote(rank() + 1, note));
    CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() + 1, &note));
  }
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(SendNote(rank() - 1, note));
  note.message[sizeof(note.message) - 1] = '\0';
  return absl::Status(static_cast<absl::StatusCode>(note.code), note.message);
}

template <typename T>
absl::Status RankGroup::SumInOrder(absl::Span<const absl::Span<const T>> terms, absl::Span<T> total) {
  constexpr size_t kPart = kPartBytes / sizeof(T);
  std::vector<T> received;
  for (size_t offset = 0; offset < total.size(); offset += kPart) {
    const absl::Span<T> part = total.subspan(offset, kPart);
    if (is_first()) {
      if (terms[0].data() != total.data()) std::copy_n(terms[0].begin() + offset, part.size(), part.begin());
    } else {
      received.resize(part.size());
      CRAFTFLEET_RETURN_IF_ERROR(links_->Receive(rank() - 1, BytesOf(absl::MakeSpan(received))));
      const T* const first = terms.empty() ? nullptr : terms[0].data() + offset;
      for (size_t i = 0; i < part.size(); ++i) part[i] = first == nullptr ? received[i] : received[i] + first[i];
    }
    for (size_t k = 1; k < terms.size(); ++k) {
      for (size_t i = 0; i < part.size(); ++i) part[i] += terms[k][offset + i];
    }
    if (!is_last()) CRAFTFLEET_RETURN_IF_ERROR(links_->Send(rank() + 1, BytesOf(part)));
  }
  // The last rank has the total.
  for (size_t offset = 0; offset < total.size(); offset += kPart) {
    const absl::Span<char> part = BytesOf(total.subspan(offset, kPart));
    if (!is_last()) CRAFTFLEET_RETURN_IF_ERROR(links_->Receive(rank() + 1, part));
    if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(links_->Send(rank() - 1, part));
  }
  return absl::OkStatus();
}

absl::Status RankGroup::Sum(absl::Span<const absl::Span<const float>> terms, absl::Span<float> total) {
  return SumInOrder(terms, total);
}

absl::Status RankGroup::Sum(absl::Span<const absl::Span<const double>> terms, absl::Span<double> total) {
  return SumInOrder(terms, total);
}

}  // namespace craftfleet
