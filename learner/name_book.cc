#include "learner/name_book.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

std::string KeyOf(absl::string_view kind, absl::string_view name) { return absl::StrCat(kind, " ", name); }

}  // namespace

absl::Status NameBook::Use(absl::string_view kind, absl::string_view name, absl::string_view identity) {
  const MutexLock lock(&mu_);
  const std::string key = KeyOf(kind, name);
  auto entry = owners_.find(key);
  if (entry != owners_.end() && entry->second.identity != identity) {
    if (clock_->Now() - entry->second.last_word < lapse_) {
      return absl::PermissionDeniedError(absl::StrFormat(
          "%s \"%s\" is somebody else, by certificate or token: the name is free %s after his last word", kind, name,
          absl::FormatDuration(lapse_)));
    }
    Release(entry);
    entry = owners_.end();
  }
  if (entry == owners_.end()) {
    Forget();
    size_t& names = names_of_[std::string(identity)];
    if (names >= kMaxNames) {
      return absl::ResourceExhaustedError(absl::StrFormat(
          "%s \"%s\": there are %d names from the same certificate or token, all that it may have", kind, name, names));
    }
    ++names;
    entry = owners_.emplace(key, Owner{std::string(identity), {}}).first;
  }
  entry->second.last_word = clock_->Now();
  return absl::OkStatus();
}

void NameBook::Leave(absl::string_view kind, absl::string_view name) {
  const MutexLock lock(&mu_);
  const auto entry = owners_.find(KeyOf(kind, name));
  if (entry != owners_.end()) Release(entry);
}

void NameBook::Release(Owners::iterator entry) {
  const auto names = names_of_.find(entry->second.identity);
  if (--names->second == 0) names_of_.erase(names);
  owners_.erase(entry);
}

// Looks at all, but only when a new name comes: without those the book does not grow.
void NameBook::Forget() {
  for (auto entry = owners_.begin(); entry != owners_.end();) {
    const auto next = std::next(entry);
    if (clock_->Now() - entry->second.last_word >= lapse_) Release(entry);
    entry = next;
  }
}

}  // namespace craftfleet
