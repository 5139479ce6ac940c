#include "learner/training/fragments/fragment_journal.h"

#include <cstdint>
#include <utility>

#include <absl/strings/string_view.h>

#include "common/base/crc32c.h"
#include "common/base/little_endian.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/wire/protocol.h"

namespace craftfleet {
namespace {

constexpr size_t kHeadBytes = 8;  // a record's size and checksum

// Removes the first record from `bytes` and returns it; nothing: no complete record is left.
std::optional<absl::string_view> NextRecord(absl::string_view* bytes) {
  if (bytes->size() < kHeadBytes) return std::nullopt;
  const auto size = FromLittleEndian<uint32_t>(bytes->substr(0, 4));
  if (size > wire::kMaxMessageBytes || bytes->size() - kHeadBytes < size) return std::nullopt;
  const absl::string_view record = bytes->substr(kHeadBytes, size);
  if (Crc32c(record) != FromLittleEndian<uint32_t>(bytes->substr(4, 4))) return std::nullopt;
  bytes->remove_prefix(kHeadBytes + size);
  return record;
}

}  // namespace

std::vector<Fragment> FragmentJournal::Read(const wire::FragmentShape& shape) {
  std::vector<Fragment> fragments;
  const std::string file = ReadFile(path_).value_or("");
  absl::string_view rest = file;
  sound_ = 0;
  if (NextRecord(&rest) == absl::string_view(run_id_)) {
    sound_ = file.size() - rest.size();
    while (const std::optional<absl::string_view> record = NextRecord(&rest)) {
      v1::FragmentMessage message;
      if (!message.ParseFromArray(record->data(), static_cast<int>(record->size()))) break;
      absl::StatusOr<Fragment> fragment = wire::FromProto(&message, shape);
      if (!fragment.ok()) break;
      fragments.push_back(*std::move(fragment));
      sound_ = file.size() - rest.size();
    }
  }
  return fragments;
}

absl::Status FragmentJournal::Open() {
  if (file_.has_value()) return absl::OkStatus();
  AppendFile::Options options;
  options.fence = fence_;
  options.durable = false;
  CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(path_, options));
  if (sound_.has_value()) CRAFTFLEET_RETURN_IF_ERROR(file.TruncateTo(*sound_));
  file_.emplace(std::move(file));
  return absl::OkStatus();
}

absl::Status FragmentJournal::Append(const Fragment& fragment) {
  if (failed_) return absl::OkStatus();
  absl::Status status = AppendAll(fragment);
  failed_ = !status.ok();
  return status;
}

absl::Status FragmentJournal::AppendAll(const Fragment& fragment) {
  CRAFTFLEET_RETURN_IF_ERROR(Open());
  if (file_->length() == 0) CRAFTFLEET_RETURN_IF_ERROR(AppendRecord(run_id_));
  return AppendRecord(wire::ToProto(fragment).SerializeAsString());
}

absl::Status FragmentJournal::Clear() {
  CRAFTFLEET_RETURN_IF_ERROR(Open());
  CRAFTFLEET_RETURN_IF_ERROR(file_->TruncateTo(0));
  failed_ = false;
  return absl::OkStatus();
}

absl::Status FragmentJournal::AppendRecord(absl::string_view bytes) {
  std::string head;
  AppendLittleEndian(static_cast<uint32_t>(bytes.size()), &head);
  AppendLittleEndian(Crc32c(bytes), &head);
  file_->Append(head);
  file_->Append(bytes);
  absl::Status status = file_->Flush();
  if (!status.ok()) file_->DropWaiting();
  return status;
}

}  // namespace craftfleet
