#include "learner/ranks/rank_group.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// Of one transfer: the next rank works on a part while this one prepares the next.
constexpr size_t kPartBytes = size_t{1} << 20;
constexpr size_t kPart = kPartBytes / sizeof(float);

template <typename T>
absl::Span<char> BytesOf(absl::Span<T> values) {
  return absl::MakeSpan(reinterpret_cast<char*>(values.data()), values.size() * sizeof(T));
}
template <typename T>
absl::Span<const char> BytesOf(absl::Span<const T> values) {
  return absl::MakeConstSpan(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

}  // namespace

struct RankGroup::Note {
  NoteKind kind;
  int32_t code = 0;     // kAgree, kSum: of the status
  uint64_t number = 0;  // kBroadcast: bytes that follow; kShare: the flag; kAgree: rank 0's digest
  Few few = {};         // kSum
  char message[432] = {};
};

void RankGroup::BeginCall() {
  if (shared_ != nullptr) shared_->NoteOtherCall();
}

absl::Status RankGroup::ShareMemory(int terms, size_t floats) {
  const SharedSum::Size most = {size(), floats, terms};
  std::unique_ptr<SharedSum> shared = is_first() ? SharedSum::Create(most) : nullptr;
  std::string name = shared == nullptr ? "" : shared->name();
  CRAFTFLEET_RETURN_IF_ERROR(Broadcast(&name));
  if (!is_first() && !name.empty()) shared = SharedSum::Open(name, rank(), most);
  const absl::Status found = Agree(shared == nullptr ? absl::NotFoundError("no memory to share") : absl::OkStatus());
  if (is_first() && shared != nullptr) shared->Hide();
  CRAFTFLEET_RETURN_IF_ERROR(ended());
  if (found.ok()) shared_ = std::move(shared);
  return absl::OkStatus();
}

absl::Status RankGroup::SendNote(int rank, const Note& note) {
  return links_->Send(rank, BytesOf(absl::MakeConstSpan(&note, 1)));
}

absl::Status RankGroup::ReceiveNote(int rank, Note* note) {
  const NoteKind wanted = note->kind;
  return AwaitNote(links_->StartReceive(rank, BytesOf(absl::MakeSpan(note, 1))), rank, wanted, *note);
}

absl::Status RankGroup::AwaitNote(const RankLinks::Transfer& transfer, int rank, NoteKind wanted, const Note& note) {
  CRAFTFLEET_RETURN_IF_ERROR(links_->Wait(transfer));
  if (note.kind == wanted) return absl::OkStatus();
  Leave(
      absl::InternalError(absl::StrFormat("ranks %d and %d are out of step: one of them failed in the middle of an "
                                          "update",
                                          this->rank(), rank)));
  return ended();
}

void RankGroup::AddError(const absl::Status& own, Note* note) {
  if (note->code != 0 || own.ok()) return;
  note->code = own.raw_code();
  absl::SNPrintF(note->message, sizeof(note->message), "%s", own.message());
}

absl::Status RankGroup::StatusOf(const Note& note) {
  const absl::string_view message(note.message, strnlen(note.message, sizeof(note.message)));
  return absl::Status(static_cast<absl::StatusCode>(note.code), message);
}

absl::Status RankGroup::PassOn(Note* note) {
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() - 1, note));
  return is_last() ? absl::OkStatus() : SendNote(rank() + 1, *note);
}

absl::Status RankGroup::Broadcast(std::string* bytes) {
  BeginCall();
  Note note{NoteKind::kBroadcast};
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
  BeginCall();
  Note note{NoteKind::kShare};
  note.number = flag ? 1 : 0;
  CRAFTFLEET_RETURN_IF_ERROR(PassOn(&note));
  return note.number == 1;
}

absl::Status RankGroup::Agree(const absl::Status& own, uint64_t digest) {
  BeginCall();
  Note note{NoteKind::kAgree};
  note.number = digest;
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() - 1, &note));
  absl::Status mine = own;
  if (mine.ok() && note.number != digest) {
    mine = absl::DataLossError(absl::StrFormat("rank %d has other weights than rank 0 after the same update", rank()));
  }
  AddError(mine, &note);
  if (!is_last()) {
    CRAFTFLEET_RETURN_IF_ERROR(SendNote(rank() + 1, note));
    CRAFTFLEET_RETURN_IF_ERROR(ReceiveNote(rank() + 1, &note));
  }
  if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(SendNote(rank() - 1, note));
  return StatusOf(note);
}

absl::Status RankGroup::Sum(absl::Span<const SumTerm> terms, absl::Span<float> total) {
  Few none;
  return AgreeAndSum(absl::OkStatus(), {}, &none, terms, total);
}

absl::Status RankGroup::AgreeAndSum(const absl::Status& own, absl::Span<const Few> few, Few* few_total,
                                    absl::Span<const SumTerm> terms, absl::Span<float> total) {
  if (shared_ != nullptr && shared_->Fits(total.size())) return SumShared(own, few, few_total, terms, total);
  BeginCall();
  own_.resize(terms.size());
  for (size_t i = 0; i < terms.size(); ++i) {
    own_[i].resize(total.size());
    CopyPieces(terms[i], own_[i].data());
  }
  Note note{NoteKind::kSum};
  Note agreed{NoteKind::kSum};
  Transfers from_before;
  Transfers from_after;
  Transfers sent;
  // A part of the total comes only once the next rank has this rank's sum of that part, so it may overwrite it.
  if (!is_last()) from_after = StartReceive(rank() + 1, &agreed, total);
  if (!is_first()) {
    before_.resize(total.size());
    from_before = StartReceive(rank() - 1, &note, absl::MakeSpan(before_));
    CRAFTFLEET_RETURN_IF_ERROR(AwaitNote(from_before.front(), rank() - 1, NoteKind::kSum, note));
  }
  AddError(own, &note);
  CRAFTFLEET_RETURN_IF_ERROR(SumForward(from_before, &note, few, total, &sent));
  if (is_last()) {
    agreed = note;
  } else {
    CRAFTFLEET_RETURN_IF_ERROR(AwaitNote(from_after.front(), rank() + 1, NoteKind::kSum, agreed));
    CRAFTFLEET_RETURN_IF_ERROR(PassBack(from_after, agreed, total, &sent));
  }
  for (const RankLinks::Transfer& transfer : sent) CRAFTFLEET_RETURN_IF_ERROR(links_->Wait(transfer));
  *few_total = agreed.few;
  return StatusOf(agreed);
}

absl::Status RankGroup::SumShared(const absl::Status& own, absl::Span<const Few> few, Few* few_total,
                                  absl::Span<const SumTerm> terms, absl::Span<float> total) {
  absl::Status agreed;
  const absl::Status added =
      shared_->Add(own, &agreed, few, few_total, terms, total, [this] { return links_->ended(); });
  if (added.ok()) return agreed;
  Leave(added);
  return ended();
}

RankGroup::Transfers RankGroup::StartReceive(int rank, Note* note, absl::Span<float> values) {
  Transfers transfers = {links_->StartReceive(rank, BytesOf(absl::MakeSpan(note, 1)))};
  for (size_t offset = 0; offset < values.size(); offset += kPart) {
    transfers.push_back(links_->StartReceive(rank, BytesOf(values.subspan(offset, kPart))));
  }
  return transfers;
}

absl::Status RankGroup::SumForward(const Transfers& from_before, Note* note, absl::Span<const Few> few,
                                   absl::Span<float> total, Transfers* sent) {
  for (const Few& term : few) {
    for (int i = 0; i < kFew; ++i) note->few[i] += term[i];
  }
  const int next = is_last() ? rank() - 1 : rank() + 1;
  sent->push_back(links_->StartSend(next, BytesOf(absl::MakeConstSpan(note, 1))));
  for (size_t offset = 0; offset < total.size(); offset += kPart) {
    const absl::Span<float> part = total.subspan(offset, kPart);
    if (!is_first()) CRAFTFLEET_RETURN_IF_ERROR(links_->Wait(from_before[1 + offset / kPart]));
    std::vector<const float*> terms;
    if (!is_first()) terms.push_back(before_.data() + offset);
    for (const std::vector<float>& own : own_) terms.push_back(own.data() + offset);
    AddInOrder(terms, part);
    sent->push_back(links_->StartSend(next, BytesOf(part)));
  }
  return absl::OkStatus();
}

absl::Status RankGroup::PassBack(const Transfers& from_after, const Note& agreed, absl::Span<float> total,
                                 Transfers* sent) {
  if (!is_first()) sent->push_back(links_->StartSend(rank() - 1, BytesOf(absl::MakeConstSpan(&agreed, 1))));
  for (size_t offset = 0; offset < total.size(); offset += kPart) {
    CRAFTFLEET_RETURN_IF_ERROR(links_->Wait(from_after[1 + offset / kPart]));
    if (is_first()) continue;
    sent->push_back(links_->StartSend(rank() - 1, BytesOf(total.subspan(offset, kPart))));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
